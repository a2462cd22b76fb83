"""Views of jobs, with their parts, plates and prints. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from farm import api
from farm.errors import EXIT_CODES, ExitCode
from farm.model import (
    Hold,
    HoldCode,
    Job,
    JobState,
    Plate,
    Print,
    PrintState,
    Still,
    Verdict,
    compute_assembly_ratio,
    share_field_set,
)
from farm.state import Books
from farm.views.accounting import compute_job_totals
from farm.views.context import ViewContext
from farm.views.job_cache import PartsAndPlates
from farm.views.jobs.times import Run, compute_assembly_times, compute_job_times

_TEMPORARY_HOLDS = {
    HoldCode.NOT_FIRST, HoldCode.PRINTER_BUSY, HoldCode.JOB_PRINTER_LIMIT, HoldCode.PRINTER_CONNECTING,
    HoldCode.START_TIME, HoldCode.QUIET_HOURS, HoldCode.UNATTENDED, HoldCode.HEATING_LIMIT,
    HoldCode.KEPT_AS_SPARE, HoldCode.JUST_LOST, HoldCode.BEING_RECUT, HoldCode.BEING_REPLANNED,
}  # fmt: skip
"""Codes of the holds that end without the help of a person."""

_PLANNABLE_STATES = (JobState.PLANNING, JobState.PRINTING)
"""States in which a job may be planned, for the first time or again."""


def describe_jobs(context: ViewContext, jobs: Iterable[Job]) -> list[api.JobView]:
    """Describe jobs with their parts, plates and prints."""
    ratio = compute_assembly_ratio(context.books.jobs.values())  # computed once, because it reads all jobs
    return [_describe_job(context, job, ratio) for job in jobs]


def summarise_jobs(context: ViewContext, jobs: Iterable[Job]) -> list[api.JobSummary]:
    """Describe jobs without their parts and plates."""
    ratio = compute_assembly_ratio(context.books.jobs.values())
    return [
        api.JobSummary(
            **dict(_describe_figures(context, job, list(context.books.list_plates(job)), ratio)),
            plate_count=len(job.plates),
        )
        for job in jobs
    ]


def group_waits(context: ViewContext, jobs: Iterable[Job]) -> list[api.Wait]:
    """Group the waiting plates of jobs by the text of their hold, as `farm.wording.group_holds` does."""
    waits: dict[str, api.Wait] = {}
    for name in (name for job in jobs for name in job.plates):
        hold = context.plate_holds.get(name)
        if hold is None:
            continue
        wait = waits.get(hold.text)
        if wait is None:
            waits[hold.text] = wait = api.Wait(hold=hold, plates=[], names=[])
        wait.plates.append(name)
        wait.names.append(context.books.plates[name].name)
    return list(waits.values())


def describe_job(context: ViewContext, job: Job) -> api.JobView:
    """Describe a job with its parts, plates and prints."""
    return describe_jobs(context, [job])[0]


def _describe_job(context: ViewContext, job: Job, assembly_ratio: float) -> api.JobView:
    books = context.books
    plates = list(books.list_plates(job))
    contents = context.job_cache.contents.find(books, job.id, lambda: _make_contents(context, job, plates))
    contents.plates = _update_holds(context, contents.plates)
    figures = _describe_figures(context, job, plates, assembly_ratio)
    return api.JobView(**dict(figures), parts=contents.parts, plates=contents.plates)


def _describe_figures(
    context: ViewContext, job: Job, plates: Sequence[Plate], assembly_ratio: float
) -> api.JobOverview:
    """Describe a job as a whole, without its parts and plates."""
    books = context.books
    totals = context.job_cache.totals.find(books, job.id, lambda: compute_job_totals(books, job))
    times = compute_job_times(context, job)
    assembly = compute_assembly_times(job, times.end_s, assembly_ratio)
    return api.JobOverview(
        id=job.id,
        name=job.name,
        state=job.state,
        error=job.error,
        reason=job.reason,
        paused=job.paused,
        exit_code=int(_find_exit_code(job)),
        hold=context.find_job_hold(job),
        progress=context.progress.get(job.id) if job.state in _PLANNABLE_STATES else None,
        now=context.format_time(context.now_s) or "",
        submitted=context.format_time(job.submitted_s) or "",
        submitted_by=job.submitted_by,
        options=job.options,
        repairs=list(job.repairs),
        scale=job.scale,
        plan=job.plan,
        starts=context.format_time(job.not_before_s),
        expected_s=job.expected_s,
        lower_bound_s=job.lower_bound_s,
        eta=context.format_time(times.end_s),
        elapsed_s=times.elapsed_s,
        runs=[_make_run_view(context, run) for run in times.runs],
        serial_s=job.serial_s,
        speedup=times.speedup,
        utilisation=times.utilisation,
        printed=totals.printed_count,
        good=totals.good_count,
        printed_copies=totals.printed_copy_count,
        current_s=times.makespan_s,
        wasted_s=totals.wasted_s,
        wasted_grams=totals.wasted_grams,
        grams=sum(plate.grams for plate in plates) if plates else None,
        filament_mm=sum(plate.filament_mm for plate in plates) if plates else None,
        price=sum_prices(plates),
        currency=context.fleet.fleet.currency,
        starved_share=times.starved_share,
        folder=str(context.state.find_job_folder(job.id)) if job.plates else None,
        pruned=context.format_time(job.pruned_s),
        waits_for_person=_waits_for_person(context, job, plates),
        assembly_s=assembly.work_s,
        assembled=context.format_time(assembly.end_s),
        glued=job.gluing is not None,
        submitted_to_assembled_s=None if assembly.end_s is None else assembly.end_s - job.submitted_s,
    )


def _make_contents(context: ViewContext, job: Job, plates: Iterable[Plate]) -> PartsAndPlates:
    files_folder = None if job.pruned_s is not None else str(context.state.files)
    return PartsAndPlates(
        parts=[share_field_set(_make_part_view(context, name, files_folder)) for name in job.parts],
        plates=[share_field_set(_make_plate_view(context, plate, files_folder)) for plate in plates],
    )


def _update_holds(context: ViewContext, views: Iterable[api.PlateStatus]) -> list[api.PlateStatus]:
    """Return the views of plates with their current holds; copy only views whose hold has changed."""
    updated_views: list[api.PlateStatus] = []
    # The last pair of equal holds. Most plates of a job have the same pair, so few holds are compared.
    old_hold: Hold | None = None
    new_hold: Hold | None = None
    for view in views:
        hold = context.plate_holds.get(view.id)
        if (view.hold is old_hold and hold is new_hold) or view.hold == hold:
            old_hold, new_hold = view.hold, hold
            updated_views.append(view)
        else:
            updated_views.append(view.model_copy(update={"hold": hold}))
    return updated_views


def _make_run_view(context: ViewContext, run: Run) -> api.RunView:
    return api.RunView(
        started=context.format_time(run.started_s) or "",
        ended=None if run.is_open else context.format_time(run.ended_s),
    )


def _find_exit_code(job: Job) -> ExitCode:
    if job.state is JobState.FAILED and job.planned_s is not None:
        return ExitCode.JOB_FAILED
    return EXIT_CODES[job.error] if job.error else ExitCode.DONE


def sum_prices(plates: Iterable[Plate]) -> float | None:
    """Add up the prices of plates; return None if any price is unknown, or if there are no plates."""
    prices = [plate.price for plate in plates]
    known_prices = [price for price in prices if price is not None]
    return sum(known_prices) if prices and len(known_prices) == len(prices) else None


def _waits_for_person(context: ViewContext, job: Job, plates: Iterable[Plate]) -> bool:
    """Return whether a job cannot continue until a person acts."""
    if job.state is JobState.HELD:
        return True
    if job.state is JobState.QUEUED:
        holds = [job.hold]
        has_open_prints = any(True for _ in context.books.list_open_prints())
    elif job.state is JobState.PRINTING:
        holds = [context.find_plate_hold(plate) for plate in plates]
        has_open_prints = any(True for _ in context.books.list_open_prints(job.id))
    else:
        return False
    return not has_open_prints and any(
        hold is not None and hold.code not in _TEMPORARY_HOLDS for hold in holds
    )


def _make_part_view(context: ViewContext, name: str, files_folder: str | None) -> api.PartView:
    part = context.books.parts[name]
    plate, job = context.books.plates[part.plate], context.books.jobs[part.job]
    picture = job.part_pictures.get(part.id)
    return api.PartView(
        id=part.id,
        cut_from=part.cut_from,
        copy_number=part.copy_number,
        glue_rank=part.glue_rank,
        verdict=_find_verdict(context.books, plate),
        plate=part.plate,
        file=_make_file_path(files_folder, part.file),
        picture=str(context.state.files / picture) if picture is not None else None,
        prints=[describe_print(context, attempt) for attempt in context.books.list_prints(plate)],
    )


def describe_print(context: ViewContext, attempt: Print) -> api.PrintView:
    """Describe one attempt to print a plate."""
    return api.PrintView(
        part=context.books.plates[attempt.plate].parts[0],
        printer=attempt.printer,
        state=attempt.shown_state,
        fault=attempt.fault,
        reason=attempt.reason,
        verdict=attempt.verdict,
        why=attempt.verdict_why,
        started=context.format_time(attempt.started_s),
        ended=context.format_time(attempt.ended_s),
        stills=[_make_still_view(context, attempt, still) for still in attempt.stills],
    )


def _make_still_view(context: ViewContext, attempt: Print, still: Still) -> api.StillView:
    is_pruned = context.books.jobs[attempt.job].pruned_s is not None
    return api.StillView(
        moment=still.moment,
        taken=context.format_time(still.at_s) or "",
        file=_make_file_path(None if is_pruned else str(context.state.files), still.file),
    )


def _find_verdict(books: Books, plate: Plate) -> Verdict | None:
    """Return a person's verdict on the last done print of a plate; None if there is none."""
    successes = [attempt for attempt in books.list_prints(plate) if attempt.state is PrintState.DONE]
    return successes[-1].verdict if successes else None


def _make_plate_view(context: ViewContext, plate: Plate, files_folder: str | None) -> api.PlateStatus:
    # Without the prints of the part from which the part of this plate was cut.
    own_prints = [p for p in context.books.list_prints(plate) if p.plate == plate.id]
    return api.PlateStatus(
        id=plate.id,
        parts=list(plate.parts),
        printer=own_prints[-1].printer if own_prints else plate.printer,
        gcode=_make_file_path(files_folder, plate.gcode),
        expected_s=plate.expected_s,
        grams=plate.grams,
        filament_mm=plate.filament_mm,
        price=plate.price,
        cached=plate.cached,
        warnings=list(plate.warnings),
        printing=any(not attempt.state.ended for attempt in context.books.list_prints(plate)),
        hold=None,
    )


def _make_file_path(files_folder: str | None, name: str) -> str | None:
    """Return the path of a file in a folder; None if there is no folder, because the files were pruned."""
    # A string, because thousands of `Path` objects are slow.
    return None if files_folder is None else f"{files_folder}/{name}"
