"""Jobs, their parts, plates and prints as people see them. Pure."""

from __future__ import annotations

from farm import api
from farm.errors import EXIT_CODES, ExitCode
from farm.model import HoldCode, Job, JobState, Plate, Print, PrintState, Verdict
from farm.state.books import Books
from farm.state.plate_state import PlateState
from farm.views.accounting import duration_s, summarise_job
from farm.views.context import ViewContext

_PASSING_HOLDS = {
    HoldCode.NOT_FRONT, HoldCode.PRINTER_BUSY, HoldCode.ALL_ITS_PRINTERS_BUSY, HoldCode.PRINTER_CONNECTING,
    HoldCode.START_TIME, HoldCode.QUIET_HOURS, HoldCode.UNATTENDED, HoldCode.HEATING_LIMIT,
    HoldCode.KEPT_AS_SPARE, HoldCode.JUST_LOST, HoldCode.CUT_AGAIN,
}  # fmt: skip


def describe_job(context: ViewContext, job: Job) -> api.JobView:
    """Everything about a job."""
    books = context.books
    plates = list(books.plates_of(job))
    prints = books.prints_of_job(job)
    account = summarise_job(books, job)
    elapsed_s = _elapsed_s(job, prints, context.now_s)
    remaining_s = None if job.state is not JobState.PRINTING else _remaining_s(context, plates)
    ended = job.state in (JobState.PRINTED, JobState.DONE)
    makespan_s = None
    if ended or not job.state.ended:  # a job that failed or was cancelled was no quicker for it
        makespan_s = elapsed_s if ended or elapsed_s is None else elapsed_s + (remaining_s or 0.0)
        makespan_s = makespan_s or job.expected_s
    busy_s = sum(_busy_s(context, plate) for plate in plates)
    reached_s = sum(map(duration_s, prints))
    used = {attempt.printer for attempt in prints} | {p.printer for p in plates if not p.prints}
    exit_code = EXIT_CODES[job.error] if job.error else ExitCode.DONE
    if job.state is JobState.FAILED and job.planned_s is not None:
        exit_code = ExitCode.JOB_FAILED
    return api.JobView(
        id=job.id,
        name=job.name,
        state=job.state,
        error=job.error,
        reason=job.reason,
        paused=job.paused,
        exit_code=int(exit_code),
        hold=context.job_hold(job),
        progress=context.progress.get(job.id) if job.state is JobState.PLANNING else None,
        submitted=context.format_time(job.submitted_s) or "",
        submitted_by=job.submitted_by,
        options=job.options,
        parts=[_part_view(context, name) for name in job.parts],
        plates=[_plate_view(context, plate) for plate in plates],
        repairs=list(job.repairs),
        scale=job.scale,
        plan=job.plan,
        starts=context.format_time(job.not_before_s),
        estimated_s=job.expected_s,
        lower_bound_s=job.lower_bound_s,
        eta=context.format_time(job.ended_s if ended else _eta_s(context, job, remaining_s)),
        elapsed_s=elapsed_s,
        serial_s=job.serial_s,
        speedup=job.serial_s / makespan_s if job.serial_s and makespan_s else None,
        utilisation=busy_s / (len(used) * makespan_s) if used and makespan_s else None,
        printed=account.printed,
        good=account.good,
        current_s=makespan_s,
        wasted_s=account.wasted_s,
        wasted_grams=account.wasted_grams,
        grams=sum(plate.grams for plate in plates) if plates else None,
        filament_mm=sum(plate.filament_mm for plate in plates) if plates else None,
        price=_price(plates),
        currency=context.fleet.fleet.currency,
        starved_share=sum(p.starved_s for p in prints) / reached_s if reached_s else None,
        folder=str(context.state.job(job.id)) if job.plates else None,
        waits_for_person=_waits_for_person(books, job, plates),
    )


def _elapsed_s(job: Job, prints: list[Print], now_s: float) -> float | None:
    """Parallel printing time: from the first print command to the end of the last part."""
    started = [p.started_s for p in prints if p.started_s is not None]
    if not started:
        return None
    return (job.ended_s if job.ended_s is not None else now_s) - min(started)


def _remaining_s(context: ViewContext, plates: list[Plate]) -> float:
    """Until the last plate ends; of what waits as it is foreseen, else as if it started now. At least 0."""
    return max((_plate_remaining_s(context, plate) for plate in plates), default=0.0)


def _plate_remaining_s(context: ViewContext, plate: Plate) -> float:
    stands = context.books.plate_state(plate)
    if stands is PlateState.WAITING:
        return max(0.0, context.ends_s.get(plate.id, context.now_s + plate.expected_s) - context.now_s)
    if stands is not PlateState.PRINTING:
        return 0.0
    attempt = _last(context.books, plate)
    return plate.expected_s if attempt.started_s is None else context.remaining_s(attempt)


def _eta_s(context: ViewContext, job: Job, remaining_s: float | None) -> float | None:
    return None if remaining_s is None or job.state is not JobState.PRINTING else context.now_s + remaining_s


def _busy_s(context: ViewContext, plate: Plate) -> float:
    """Printing time of a plate: reached where it is done, as estimated otherwise."""
    if plate.prints:
        attempt = _last(context.books, plate)
        if attempt.state is PrintState.DONE and attempt.started_s is not None and attempt.ended_s is not None:
            return attempt.ended_s - attempt.started_s
    return plate.expected_s


def _price(plates: list[Plate]) -> float | None:
    """Of all plates; None where one of them has none."""
    prices = [plate.price for plate in plates if plate.price is not None]
    return sum(prices) if plates and len(prices) == len(plates) else None


def _last(books: Books, plate: Plate) -> Print:
    return books.prints[plate.prints[-1]]


def _waits_for_person(books: Books, job: Job, plates: list[Plate]) -> bool:
    """Whether nothing will go on with this job before a person does something."""
    if job.state is JobState.HELD:
        return True
    if job.state is JobState.QUEUED:
        waiting = [job.hold]
        printing = any(True for _ in books.open_prints())
    elif job.state is JobState.PRINTING:
        waiting = [plate.hold for plate in plates]
        printing = any(True for _ in books.open_prints(job.id))
    else:
        return False
    return not printing and any(hold is not None and hold.code not in _PASSING_HOLDS for hold in waiting)


def _part_view(context: ViewContext, name: str) -> api.PartView:
    part = context.books.parts[name]
    plate = context.books.plates[part.plate]
    return api.PartView(
        id=part.id,
        cut_from=part.cut_from,
        verdict=_verdict(context.books, plate),
        plate=part.plate,
        file=str(context.state.files / part.file),
        prints=[describe_print(context, attempt) for attempt in context.books.prints_of(plate)],
    )


def describe_print(context: ViewContext, attempt: Print) -> api.PrintView:
    """One attempt, its moments in the fleet's zone."""
    return api.PrintView(
        part=context.books.plates[attempt.plate].parts[0],
        printer=attempt.printer,
        state=attempt.state,
        fault=attempt.fault,
        reason=attempt.reason,
        verdict=attempt.verdict,
        why=attempt.verdict_why,
        started=context.format_time(attempt.started_s),
        ended=context.format_time(attempt.ended_s),
    )


def _verdict(books: Books, plate: Plate) -> Verdict | None:
    """A person's word on the last print that was done."""
    done = [attempt for attempt in books.prints_of(plate) if attempt.state is PrintState.DONE]
    return done[-1].verdict if done else None


def _plate_view(context: ViewContext, plate: Plate) -> api.PlateStatus:
    own = [p for p in context.books.prints_of(plate) if p.plate == plate.id]  # not of what it was made of
    return api.PlateStatus(
        id=plate.id,
        parts=list(plate.parts),
        printer=own[-1].printer if own else plate.printer,
        gcode=str(context.state.files / plate.gcode),
        estimated_s=plate.expected_s,
        grams=plate.grams,
        filament_mm=plate.filament_mm,
        price=plate.price,
        cached=plate.cached,
        warnings=list(plate.warnings),
        printing=any(not attempt.state.ended for attempt in context.books.prints_of(plate)),
        hold=context.plate_hold(plate),
    )
