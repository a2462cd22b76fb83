"""How events change the books. Pure.

``apply(event, books)`` gives new books and the instructions that follow; a refused event leaves no trace.
"""

from __future__ import annotations

from functools import singledispatch

from farm.errors import ErrorCode
from farm.model import Bed, FilamentState, JobState, Print, Printer, PrintState
from farm.tracking import events as ev
from farm.tracking.books import Books, edited, put
from farm.tracking.factor import learned

ATTEMPTS = 3
"""How often a plate may fail before its job does."""

Result = tuple[Books, tuple[ev.AnyInstruction, ...]]


@singledispatch
def apply(event: ev.Event, books: Books) -> Result:
    """New books and what is to be done, after an event.

    Raises
    ------
    NoSuchThing
        Where the event names a job or printer that the books do not have.
    """
    raise TypeError(f"no rule for {type(event).__name__}")


@apply.register
def _(event: ev.PrinterAdded, books: Books) -> Result:
    if event.name in books.printers:
        return books, ()
    return put(books, Printer(name=event.name, bed=event.bed)), ()


@apply.register
def _(event: ev.JobSubmitted, books: Books) -> Result:
    return put(books, event.job), ()


@apply.register
def _(event: ev.JobHeld, books: Books) -> Result:
    return put(books, edited(books.job(event.job), hold=event.hold)), ()


@apply.register
def _(event: ev.PlanningStarted, books: Books) -> Result:
    return put(books, edited(books.job(event.job), state=JobState.PLANNING, hold=None)), ()


@apply.register
def _(event: ev.PlanningAbandoned, books: Books) -> Result:
    job = books.job(event.job)
    if job.state is not JobState.PLANNING:
        return books, ()
    return put(books, edited(job, state=JobState.QUEUED, hold=event.hold)), ()


@apply.register
def _(event: ev.JobPlanned, books: Books) -> Result:
    job = books.job(event.job)
    if job.state is not JobState.PLANNING:  # cancelled meanwhile
        return books, ()
    job = edited(
        job,
        state=JobState.PRINTING,
        parts=tuple(part.id for part in event.parts),
        plates=tuple(plate.id for plate in event.plates),
        repairs=event.repairs,
        scale=event.scale,
        serial_s=event.serial_s,
        estimated_s=event.estimated_s,
        picture=event.picture,
        planned_s=event.at_s,
        hold=None,
    )
    return put(books, job, *event.parts, *event.plates), (ev.NameFiles(job=job.id),)


@apply.register
def _(event: ev.JobFailed, books: Books) -> Result:
    return _end_job(books, event.job, JobState.FAILED, event.at_s, event.error, event.reason)


@apply.register
def _(event: ev.JobCancelled, books: Books) -> Result:
    planning = books.job(event.job).state is JobState.PLANNING
    books, instructions = _end_job(
        books, event.job, JobState.CANCELLED, event.at_s, ErrorCode.CANCELLED, "cancelled by a person"
    )
    return books, (ev.StopPlanning(job=event.job), *instructions) if planning else instructions


@apply.register
def _(event: ev.PlateAssigned, books: Books) -> Result:
    plate = books.plates[event.plate]
    printer = books.printer(event.printer)
    if books.open_print_on(printer.name) is not None:
        raise ValueError(f"{printer.name} is booked already")
    if printer.bed is not Bed.CLEAR:
        raise ValueError(f"the bed of {printer.name} is not known to be clear")
    attempt = Print(
        id=event.print_id, plate=plate.id, job=plate.job, printer=printer.name, assigned_s=event.at_s
    )
    plate = edited(plate, prints=(*plate.prints, attempt.id), hold=None)
    return put(books, plate, attempt), (ev.SendStart(print_id=attempt.id, printer=printer.name),)


@apply.register
def _(event: ev.PlatesHeld, books: Books) -> Result:
    held = (edited(books.plates[name], hold=hold) for name, hold in event.holds.items())
    return put(books, *held), ()


@apply.register
def _(event: ev.PrintProgressed, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    if attempt.state.ended:
        return books, ()
    started_s = attempt.started_s if attempt.started_s is not None else event.started_s
    extruded = attempt.extruded or event.extruded
    paused = attempt.paused or event.state is PrintState.PAUSED
    attempt = edited(attempt, state=event.state, started_s=started_s, extruded=extruded, paused=paused)
    books = put(books, attempt)
    return (_soil(books, attempt.printer) if extruded else books), ()


@apply.register
def _(event: ev.PauseAsked, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    if attempt.state.ended or attempt.cancel_asked is not None:
        return books, ()
    send = ev.SendPause(print_id=attempt.id, printer=attempt.printer, wanted=event.wanted)
    return put(books, edited(attempt, pause_asked=event.wanted)), (send,)


@apply.register
def _(event: ev.PrintEnded, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    forget = ev.SendForget(print_id=attempt.id, printer=attempt.printer)
    if attempt.state.ended:
        return books, (forget,)
    state = event.state
    begun = attempt.state is not PrintState.ASSIGNED or event.started_s is not None
    if state is PrintState.CANCELLED and attempt.cancel_asked is None and begun:
        state = PrintState.FAILED  # nobody here asked for it
    attempt = edited(
        attempt,
        state=state,
        fault=event.fault,
        reason=event.reason,
        started_s=attempt.started_s if attempt.started_s is not None else event.started_s,
        ended_s=event.ended_s,
        extruded=attempt.extruded or event.extruded,
        starved_s=event.starved_s,
    )
    printer = edited(books.printer(attempt.printer), filament=event.filament)
    if state is PrintState.DONE and attempt.started_s is not None and not attempt.paused:
        plate = books.plates[attempt.plate]
        reached_s = event.ended_s - attempt.started_s - plate.prelude_s
        factor = learned(printer.time_factor, plate.print_time_s, reached_s, event.starved_s)
        printer = edited(printer, time_factor=factor)
    if state is PrintState.FAILED:
        printer = edited(printer, look=event.reason or event.fault or "its print failed")
    books = put(books, attempt, printer)
    # A print that failed may have extruded without anybody having seen it.
    if attempt.extruded or state is PrintState.FAILED:
        books = _soil(books, attempt.printer)
    books, more = _settle(books, attempt, event.at_s)
    return books, (forget, *more)


@apply.register
def _(event: ev.BedCleared, books: Books) -> Result:
    printer = books.printer(event.printer)
    if books.open_print_on(printer.name) is not None:
        raise ValueError(f"{printer.name} is printing")
    filament = event.filament or printer.filament
    books = put(books, edited(printer, bed=Bed.CLEAR, look=None, filament=filament))
    return books, (ev.SendCleared(printer=printer.name, filament=event.filament),)


@apply.register
def _(event: ev.PrinterSeen, books: Books) -> Result:
    printer = books.printer(event.printer)
    bed = event.bed if printer.bed is Bed.UNKNOWN else printer.bed
    filament = event.filament if printer.filament is FilamentState.UNKNOWN else printer.filament
    return put(books, edited(printer, bed=bed, filament=filament)), ()


@apply.register
def _(event: ev.PrinterDoubted, books: Books) -> Result:
    printer = books.printer(event.printer)
    doubted = edited(printer, bed=Bed.UNKNOWN, filament=FilamentState.UNKNOWN, look=event.reason)
    return put(books, doubted), ()


def _settle(books: Books, attempt: Print, at_s: float) -> Result:
    """Whether the end of a print ends its job."""
    job = books.jobs[attempt.job]
    if job.state is not JobState.PRINTING:
        return books, ()
    plate = books.plates[attempt.plate]
    failures = [p for p in books.prints_of(plate) if p.state is PrintState.FAILED]
    if len(failures) >= ATTEMPTS:
        reason = f"plate {plate.id} failed {len(failures)} times, last on {attempt.printer}: {attempt.reason}"
        return _end_job(books, job.id, JobState.FAILED, at_s, ErrorCode.ATTEMPTS, reason)
    done = [
        next((p for p in books.prints_of(plate) if p.state is PrintState.DONE), None)
        for plate in books.plates_of(job)
    ]
    if all(p is not None for p in done):
        ended_s = max(p.ended_s or 0.0 for p in done if p is not None)
        return put(books, edited(job, state=JobState.PRINTED, ended_s=ended_s)), ()
    return books, ()


def _end_job(
    books: Books, number: int, state: JobState, at_s: float, error: ErrorCode, reason: str
) -> Result:
    job = books.job(number)
    if job.state.ended:
        return books, ()
    instructions: list[ev.AnyInstruction] = []
    stopped = []
    for attempt in books.open_prints(job.id):
        stopped.append(edited(attempt, cancel_asked=reason))
        instructions.append(ev.SendCancel(print_id=attempt.id, printer=attempt.printer, reason=reason))
    job = edited(job, state=state, ended_s=at_s, error=error, reason=reason, hold=None)
    return put(books, job, *stopped), tuple(instructions)


def _soil(books: Books, printer: str) -> Books:
    """Something may lie on the bed; what is unknown stays unknown."""
    entry = books.printers[printer]
    return put(books, edited(entry, bed=Bed.NOT_CLEAR)) if entry.bed is Bed.CLEAR else books
