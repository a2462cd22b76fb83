"""Views of jobs, with their parts, plates and prints. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from farm import api
from farm.errors import EXIT_CODES, ExitCode
from farm.model import HoldCode, Job, JobState, Plate, Print, PrintState, Verdict
from farm.state import Books, PlateState
from farm.views.accounting import duration_s, summarise_job
from farm.views.context import ViewContext

_TEMPORARY_HOLDS = {
    HoldCode.NOT_FIRST, HoldCode.PRINTER_BUSY, HoldCode.JOB_PRINTER_LIMIT, HoldCode.PRINTER_CONNECTING,
    HoldCode.START_TIME, HoldCode.QUIET_HOURS, HoldCode.UNATTENDED, HoldCode.HEATING_LIMIT,
    HoldCode.KEPT_AS_SPARE, HoldCode.JUST_LOST, HoldCode.BEING_RECUT,
}  # fmt: skip


def describe_job(context: ViewContext, job: Job) -> api.JobView:
    """Describe a job with its parts, plates and prints."""
    books = context.books
    plates = list(books.plates_of(job))
    prints = books.prints_of_job(job)
    summary = summarise_job(books, job)
    times = _measure_times(context, job, plates, prints)
    return api.JobView(
        id=job.id,
        name=job.name,
        state=job.state,
        error=job.error,
        reason=job.reason,
        paused=job.paused,
        exit_code=int(_exit_code(job)),
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
        eta=context.format_time(times.end_s),
        elapsed_s=times.elapsed_s,
        serial_s=job.serial_s,
        speedup=times.speedup,
        utilisation=times.utilisation,
        printed=summary.printed,
        good=summary.good,
        current_s=times.makespan_s,
        wasted_s=summary.wasted_s,
        wasted_grams=summary.wasted_grams,
        grams=sum(plate.grams for plate in plates) if plates else None,
        filament_mm=sum(plate.filament_mm for plate in plates) if plates else None,
        price=sum_prices(plates),
        currency=context.fleet.fleet.currency,
        starved_share=times.starved_share,
        folder=str(context.state.job(job.id)) if job.plates else None,
        waits_for_person=_waits_for_person(context, job, plates),
    )


@dataclass(frozen=True, slots=True)
class _JobTimes:
    """Times of a job, in seconds; None if they are not known.

    Attributes
    ----------
    elapsed_s
        Parallel printing time so far, or actual.
    makespan_s
        Parallel printing time: actual, or expected from present data.
    end_s
        Time at which it ended, or is expected to.
    speedup
        Ratio of the time on a single large printer to the makespan.
    utilisation
        Share of the makespan that the used printers print.
    starved_share
        Share of the printing time that simulated printers waited for the host.
    """

    elapsed_s: float | None
    makespan_s: float | None
    end_s: float | None
    speedup: float | None
    utilisation: float | None
    starved_share: float | None


def _measure_times(context: ViewContext, job: Job, plates: list[Plate], prints: list[Print]) -> _JobTimes:
    printed = job.state in (JobState.PRINTED, JobState.DONE)
    elapsed_s = _elapsed_s(job, prints, context.now_s)
    remaining_s = None if job.state is not JobState.PRINTING else _remaining_s(context, plates)
    makespan_s, end_s = None, job.ended_s if printed else None
    if printed:
        makespan_s = elapsed_s or job.expected_s
    elif not job.state.ended:  # the time of a failed or cancelled job is meaningless
        makespan_s = job.expected_s if elapsed_s is None else elapsed_s + (remaining_s or 0.0)
        makespan_s = makespan_s or job.expected_s
        end_s = None if remaining_s is None else context.now_s + remaining_s
    busy_s = sum(_busy_s(context, plate) for plate in plates)
    reached_s = sum(map(duration_s, prints))
    used = {attempt.printer for attempt in prints} | {p.printer for p in plates if not p.prints}
    return _JobTimes(
        elapsed_s=elapsed_s,
        makespan_s=makespan_s,
        end_s=end_s,
        speedup=job.serial_s / makespan_s if job.serial_s and makespan_s else None,
        utilisation=busy_s / (len(used) * makespan_s) if used and makespan_s else None,
        starved_share=sum(p.starved_s for p in prints) / reached_s if reached_s else None,
    )


def _exit_code(job: Job) -> ExitCode:
    if job.state is JobState.FAILED and job.planned_s is not None:
        return ExitCode.JOB_FAILED
    return EXIT_CODES[job.error] if job.error else ExitCode.DONE


def _elapsed_s(job: Job, prints: list[Print], now_s: float) -> float | None:
    """Return the time from the first print command to the end of the last part, or to now."""
    started = [p.started_s for p in prints if p.started_s is not None]
    if not started:
        return None
    return (job.ended_s if job.ended_s is not None else now_s) - min(started)


def _remaining_s(context: ViewContext, plates: list[Plate]) -> float:
    """Estimate the time to the end of the last plate, at least 0.

    A waiting plate ends according to the forecast, or as if it started now if there is no forecast.
    """
    return max((_plate_remaining_s(context, plate) for plate in plates), default=0.0)


def _plate_remaining_s(context: ViewContext, plate: Plate) -> float:
    state = context.books.plate_state(plate)
    if state is PlateState.WAITING:
        return max(0.0, context.ends_s.get(plate.id, context.now_s + plate.expected_s) - context.now_s)
    if state is not PlateState.PRINTING:
        return 0.0
    attempt = _last_print(context.books, plate)
    return plate.expected_s if attempt.started_s is None else context.remaining_s(attempt)


def _busy_s(context: ViewContext, plate: Plate) -> float:
    """Return the printing time of a plate: actual if it is done, expected otherwise."""
    if plate.prints:
        attempt = _last_print(context.books, plate)
        if attempt.state is PrintState.DONE and attempt.started_s is not None and attempt.ended_s is not None:
            return attempt.ended_s - attempt.started_s
    return plate.expected_s


def sum_prices(plates: Iterable[Plate]) -> float | None:
    """Add up the prices of plates; None if one of them has none."""
    prices = [plate.price for plate in plates]
    known = [price for price in prices if price is not None]
    return sum(known) if prices and len(known) == len(prices) else None


def _last_print(books: Books, plate: Plate) -> Print:
    return books.prints[plate.prints[-1]]


def _waits_for_person(context: ViewContext, job: Job, plates: list[Plate]) -> bool:
    """Return whether a job cannot continue without action by a person."""
    if job.state is JobState.HELD:
        return True
    if job.state is JobState.QUEUED:
        waiting = [job.hold]
        printing = any(True for _ in context.books.open_prints())
    elif job.state is JobState.PRINTING:
        waiting = [context.plate_hold(plate) for plate in plates]
        printing = any(True for _ in context.books.open_prints(job.id))
    else:
        return False
    return not printing and any(hold is not None and hold.code not in _TEMPORARY_HOLDS for hold in waiting)


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
    )


def _verdict(books: Books, plate: Plate) -> Verdict | None:
    """Return a person's verdict on the last print that was done."""
    done = [attempt for attempt in books.prints_of(plate) if attempt.state is PrintState.DONE]
    return done[-1].verdict if done else None


def _plate_view(context: ViewContext, plate: Plate) -> api.PlateStatus:
    own = [
        p for p in context.books.prints_of(plate) if p.plate == plate.id
    ]  # not of the part it was cut from
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
