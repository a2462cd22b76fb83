"""Consequences of an event for other entities: a job's state, a bed, an outage. Pure."""

from __future__ import annotations

from farm.errors import ErrorCode
from farm.model import Bed, Job, JobState, Outage, Plate, Print, Reopening
from farm.state import events as ev
from farm.state.books import Books, put, replace_fields
from farm.state.outage import find_printers_lost_together
from farm.state.plate_state import PlateState, derive_job_state, find_successful_print, list_counted_failures
from farm.text import format_count

CANCELLATION_REASON = "cancelled by a person"

Result = tuple[Books, tuple[ev.AnyInstruction, ...]]
"""The changed books, and the instructions that follow from the change."""


def update_job_state(books: Books, job_id: int, at_s: float, reopen: bool = False) -> Books:
    """Update a job's state from those of its plates; a cancelled job changes only if `reopen` is true."""
    job = books.jobs[job_id]
    if not job.plates or (job.state is JobState.CANCELLED and not reopen):
        return books
    if job.pruned_s is not None:  # its files are deleted, so nothing can be printed again
        return books
    if job.state is JobState.HELD:  # it stays held until a person approves its plan
        return books
    state = derive_job_state([books.find_plate_state(plate) for plate in books.list_plates(job)])
    ends_s = [
        p.ended_s or 0.0
        for plate in books.list_plates(job)
        if (p := find_successful_print(books.list_prints(plate)))
    ]
    error, reason, ended_s = None, None, None
    match state:
        case JobState.PRINTED | JobState.DONE:
            ended_s = max(ends_s)
        case JobState.CANCELLED:
            error, reason, ended_s = ErrorCode.CANCELLED, CANCELLATION_REASON, at_s
        case JobState.FAILED:
            error, reason, ended_s = ErrorCode.ATTEMPTS, _describe_failures(books, job), at_s
    if state is job.state and state is not JobState.PRINTED:
        return books
    reopenings = job.reopenings
    if job.state.ended and not state.ended and job.ended_s is not None:
        reopenings = (*reopenings, Reopening(ended_s=job.ended_s, reopened_s=at_s))
    changes = {"error": error, "reason": reason, "ended_s": ended_s, "reopenings": reopenings}
    return put(books, replace_fields(job, state=state, **changes))


def _describe_failures(books: Books, job: Job) -> str:
    out_of_attempts = [
        p for p in books.list_plates(job) if books.find_plate_state(p) is PlateState.OUT_OF_ATTEMPTS
    ]
    failures = list_counted_failures(out_of_attempts[0], books.list_prints(out_of_attempts[0]))
    other_count = len(out_of_attempts) - 1
    more_plates = f" (and {format_count(other_count, 'more plate')})" if other_count else ""
    return (
        f"{out_of_attempts[0].name} failed {len(failures)} times, last on {failures[-1].printer}: "
        f"{failures[-1].reason or failures[-1].fault}{more_plates}"
    )


def add_print(books: Books, event: ev.PlateAssigned | ev.PrintFound) -> Books:
    """Add a print of a plate: one that is assigned now, or one that an agent reported after a restore."""
    plate = books.plates[event.plate]
    attempt = Print(
        id=event.print_id,
        plate=plate.id,
        job=plate.job,
        printer=event.printer,
        number=books.next_print_number,
        assigned_s=event.at_s,
        restored=isinstance(event, ev.PrintFound),
    )
    return put(books, replace_fields(plate, prints=(*plate.prints, attempt.id)), attempt)


def request_cancel(attempt: Print, reason: str) -> tuple[Print, ev.SendCancel]:
    """Return an open print with the reason to cancel it, and the instruction to its agent."""
    cancelled_print = replace_fields(attempt, cancel_reason=attempt.cancel_reason or reason)
    return cancelled_print, ev.SendCancel(print_id=attempt.id, printer=attempt.printer, reason=reason)


def request_pause(attempt: Print, is_requested: bool) -> tuple[Print, ev.SendPause]:
    """Return an open print that is to pause or to resume, and the instruction to its agent."""
    instruction = ev.SendPause(print_id=attempt.id, printer=attempt.printer, pause=is_requested)
    return replace_fields(attempt, pause_requested=is_requested), instruction


def cancel_plate(books: Books, plate: Plate, reason: str) -> Result:
    """Cancel a plate and its open prints; the plate is printed again only if a person requests it.

    A printed plate stays printed; if its part is then judged bad, it is not printed again. If the part is
    already judged good, only open prints of it are cancelled.
    """
    state = books.find_plate_state(plate)
    if state is PlateState.CANCELLED:
        return books, ()
    cancellations = [request_cancel(p, reason) for p in books.list_prints(plate) if not p.state.ended]
    if state is PlateState.GOOD:
        return put(books, *(attempt for attempt, _ in cancellations)), tuple(
            instruction for _, instruction in cancellations
        )
    books = put(books, replace_fields(plate, cancelled=True), *(attempt for attempt, _ in cancellations))
    return books, tuple(instruction for _, instruction in cancellations)


def end_job(books: Books, job_id: int, state: JobState, at_s: float, error: ErrorCode, reason: str) -> Result:
    """End a job and cancel all of its plates, so that none of them is printed any more."""
    job = books.get_job(job_id)
    instructions: list[ev.AnyInstruction] = []
    for plate in books.list_plates(job):
        books, cancellations = cancel_plate(books, plate, reason)
        instructions += cancellations
    job = replace_fields(job, state=state, ended_s=at_s, error=error, reason=reason, hold=None)
    return put(books, job), tuple(instructions)


def mark_printer_lost(books: Books, name: str, disconnected_at_s: float, at_s: float) -> Books:
    """Record the loss of a printer; several printers lost together are an outage.

    Failures that an outage causes do not count as attempts.
    """
    books = put(books, replace_fields(books.get_printer(name), disconnected_at_s=disconnected_at_s))
    lost_names = find_printers_lost_together(name, books.printers.values(), books.outage_window_s)
    if len(lost_names) < 2:
        return books
    outage = books.outage or Outage(id=len(books.outages) + 1, at_s=disconnected_at_s, printers=())
    books = put(books, replace_fields(outage, printers=tuple(sorted({*outage.printers, *lost_names}))))
    jobs = set()
    for attempt in list(books.prints.values()):
        printer = books.printers.get(attempt.printer)
        if (
            attempt.printer in lost_names
            and printer is not None
            and attempt.ended_s == printer.disconnected_at_s
        ):
            books = put(books, replace_fields(attempt, charged=False))
            jobs.add(attempt.job)
    for job_id in sorted(jobs):
        books = update_job_state(books, job_id, at_s)
    return books


def mark_bed_not_clear(books: Books, printer: str) -> Books:
    """Record that something may lie on a bed; an unknown bed stays unknown."""
    entry = books.printers[printer]
    return put(books, replace_fields(entry, bed=Bed.NOT_CLEAR)) if entry.bed is Bed.CLEAR else books


def shift_print_times(books: Books, step_s: float) -> Books:
    """Shift the times of open prints after the clock was set; times that a person entered stay the same."""
    return put(
        books,
        *(
            replace_fields(
                attempt,
                assigned_s=attempt.assigned_s + step_s,
                started_s=None if attempt.started_s is None else attempt.started_s + step_s,
            )
            for attempt in books.list_open_prints()
        ),
    )
