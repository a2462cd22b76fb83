"""What a change of one entry of the books does to others: a job's state, a bed, an outage. Pure."""

from __future__ import annotations

from farm.errors import ErrorCode
from farm.model import Bed, Job, JobState, Outage, Plate, Print
from farm.state import events as ev
from farm.state.books import Books, edited, put
from farm.state.outage import lost_together
from farm.state.plate_state import PlateState, charged_failures, derive_job_state, successful_print

BY_A_PERSON = "cancelled by a person"

Result = tuple[Books, tuple[ev.AnyInstruction, ...]]


def update_job_state(books: Books, number: int, at_s: float, again: bool = False) -> Books:
    """The state that a job's plates give it; `again` also one that was cancelled."""
    job = books.jobs[number]
    if not job.plates or (job.state is JobState.CANCELLED and not again):
        return books
    if job.state is JobState.HELD:  # what is left of its plan is still frozen
        return books
    state = derive_job_state([books.plate_state(plate) for plate in books.plates_of(job)])
    ends_s = [
        p.ended_s or 0.0 for plate in books.plates_of(job) if (p := successful_print(books.prints_of(plate)))
    ]
    error, reason, ended_s = None, None, None
    match state:
        case JobState.PRINTED | JobState.DONE:
            ended_s = max(ends_s)
        case JobState.CANCELLED:
            error, reason, ended_s = ErrorCode.CANCELLED, BY_A_PERSON, at_s
        case JobState.FAILED:
            error, reason, ended_s = ErrorCode.ATTEMPTS, _why_failed(books, job), at_s
    if state is job.state and state is not JobState.PRINTED:
        return books
    return put(books, edited(job, state=state, error=error, reason=reason, ended_s=ended_s))


def _why_failed(books: Books, job: Job) -> str:
    lost = [p for p in books.plates_of(job) if books.plate_state(p) is PlateState.OUT_OF_ATTEMPTS]
    failed = charged_failures(lost[0], books.prints_of(lost[0]))
    more = f" (and {len(lost) - 1} more plates)" if len(lost) > 1 else ""
    return (
        f"plate {lost[0].id} failed {len(failed)} times, last on {failed[-1].printer}: "
        f"{failed[-1].reason or failed[-1].fault}{more}"
    )


def request_cancel(attempt: Print, reason: str) -> tuple[Print, ev.SendCancel]:
    """An open print that is to be ended, and who has to be told."""
    stopped = edited(attempt, cancel_reason=attempt.cancel_reason or reason)
    return stopped, ev.SendCancel(print_id=attempt.id, printer=attempt.printer, reason=reason)


def cancel_plate(books: Books, plate: Plate, reason: str) -> Result:
    """Never try a plate again, unless a person asks; end its print where it is being printed.

    One that is printed stays printed; it is not tried again if it turns out bad. One that is good loses only
    a print that makes it once more.
    """
    standing = books.plate_state(plate)
    if standing is PlateState.CANCELLED:
        return books, ()
    stopped = [request_cancel(p, reason) for p in books.prints_of(plate) if not p.state.ended]
    if standing is PlateState.GOOD:
        return put(books, *(attempt for attempt, _ in stopped)), tuple(stop for _, stop in stopped)
    books = put(books, edited(plate, cancelled=True, hold=None), *(attempt for attempt, _ in stopped))
    return books, tuple(instruction for _, instruction in stopped)


def end_job(books: Books, number: int, state: JobState, at_s: float, error: ErrorCode, reason: str) -> Result:
    """End a job as a whole, unless it has ended: nothing of it that is not printed is tried again."""
    job = books.job(number)
    if job.state.ended:
        return books, ()
    instructions: list[ev.AnyInstruction] = []
    for plate in books.plates_of(job):
        books, stops = cancel_plate(books, plate, reason)
        instructions += stops
    job = edited(job, state=state, ended_s=at_s, error=error, reason=reason, hold=None)
    return put(books, job), tuple(instructions)


def mark_printer_lost(books: Books, name: str, disconnected_at_s: float, at_s: float) -> Books:
    """A printer is gone; where others went with it, it is an outage, and no plate's fault."""
    books = put(books, edited(books.printer(name), disconnected_at_s=disconnected_at_s))
    together = lost_together(name, books.printers.values(), books.outage_window_s)
    if len(together) < 2:
        return books
    outage = books.outage or Outage(id=len(books.outages) + 1, at_s=disconnected_at_s, printers=())
    books = put(books, edited(outage, printers=tuple(sorted({*outage.printers, *together}))))
    jobs = set()
    for attempt in list(books.prints.values()):
        printer = books.printers.get(attempt.printer)
        if (
            attempt.printer in together
            and printer is not None
            and attempt.ended_s == printer.disconnected_at_s
        ):
            books = put(books, edited(attempt, charged=False))
            jobs.add(attempt.job)
    for number in sorted(jobs):
        books = update_job_state(books, number, at_s)
    return books


def mark_bed_not_clear(books: Books, printer: str) -> Books:
    """Something may lie on the bed; what is unknown stays unknown."""
    entry = books.printers[printer]
    return put(books, edited(entry, bed=Bed.NOT_CLEAR)) if entry.bed is Bed.CLEAR else books


def shift_print_times(books: Books, by_s: float) -> Books:
    """Open prints last as long as they did where the clock was set; what a person wished for stays."""

    def moved(at_s: float | None) -> float | None:
        return None if at_s is None else at_s + by_s

    going_on = books.open_prints()
    moments = ((p, moved(p.assigned_s), moved(p.started_s)) for p in going_on)
    return put(books, *(edited(p, assigned_s=given, started_s=begun) for p, given, begun in moments))
