"""The books: every job, part, plate, print and printer, and how events change them. Pure.

``apply(event, books)`` gives new books and the instructions that follow. Nothing is changed in place, so the
store can tell what to write by identity, and a refused event leaves no trace.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import singledispatch
from typing import TypeVar

from farm.errors import ErrorCode, NoSuchThing
from farm.model import (
    Bed,
    Entity,
    FilamentState,
    Job,
    JobState,
    Part,
    Plate,
    Print,
    Printer,
    PrintState,
)
from farm.tracking import events as ev
from farm.tracking.factor import learned

ATTEMPTS = 3
"""How often a plate may fail before its job does."""

E = TypeVar("E", bound=Entity)


@dataclass(frozen=True, slots=True)
class Books:
    jobs: Mapping[int, Job] = field(default_factory=dict)
    parts: Mapping[str, Part] = field(default_factory=dict)
    plates: Mapping[str, Plate] = field(default_factory=dict)
    prints: Mapping[str, Print] = field(default_factory=dict)
    printers: Mapping[str, Printer] = field(default_factory=dict)

    def job(self, number: int) -> Job:
        try:
            return self.jobs[number]
        except KeyError:
            raise NoSuchThing(f"there is no job {number}; `farm status` lists them") from None

    def printer(self, name: str) -> Printer:
        try:
            return self.printers[name]
        except KeyError:
            known = ", ".join(sorted(self.printers)) or "none"
            raise NoSuchThing(f"there is no printer {name}; the fleet has {known}") from None

    def prints_of(self, plate: Plate) -> Iterator[Print]:
        """The attempts at a plate, oldest first."""
        return (self.prints[name] for name in plate.prints)

    def plates_of(self, job: Job) -> Iterator[Plate]:
        return (self.plates[name] for name in job.plates)

    def open_prints(self, job: int | None = None) -> Iterator[Print]:
        """Prints that have not ended, of one job or of all."""
        return (p for p in self.prints.values() if not p.state.ended and job in (None, p.job))

    def open_print_on(self, printer: str) -> Print | None:
        return next((p for p in self.open_prints() if p.printer == printer), None)

    def waiting_plates(self) -> Iterator[Plate]:
        """Plates of printing jobs that are neither printed nor being printed, in order of submission."""
        for job in sorted(self.jobs.values(), key=lambda j: j.id):
            if job.state is JobState.PRINTING:
                for plate in self.plates_of(job):
                    if not any(
                        p.state is PrintState.DONE or not p.state.ended for p in self.prints_of(plate)
                    ):
                        yield plate

    def queue(self) -> list[Job]:
        """The job that is being planned, and those that are to be, in order of submission."""
        waiting = (j for j in self.jobs.values() if j.state in (JobState.QUEUED, JobState.PLANNING))
        return sorted(waiting, key=lambda job: (job.state is not JobState.PLANNING, job.id))


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
    return _with(books, Printer(name=event.name, bed=event.bed)), ()


@apply.register
def _(event: ev.JobSubmitted, books: Books) -> Result:
    return _with(books, event.job), ()


@apply.register
def _(event: ev.JobHeld, books: Books) -> Result:
    return _with(books, _set(books.job(event.job), hold=event.hold)), ()


@apply.register
def _(event: ev.PlanningStarted, books: Books) -> Result:
    return _with(books, _set(books.job(event.job), state=JobState.PLANNING, hold=None)), ()


@apply.register
def _(event: ev.PlanningAbandoned, books: Books) -> Result:
    job = books.job(event.job)
    if job.state is not JobState.PLANNING:
        return books, ()
    return _with(books, _set(job, state=JobState.QUEUED, hold=event.hold)), ()


@apply.register
def _(event: ev.JobPlanned, books: Books) -> Result:
    job = books.job(event.job)
    if job.state is not JobState.PLANNING:  # cancelled meanwhile
        return books, ()
    job = _set(
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
    return _with(books, job, *event.parts, *event.plates), (ev.NameFiles(job=job.id),)


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
    plate = _set(plate, prints=(*plate.prints, attempt.id), hold=None)
    return _with(books, plate, attempt), (ev.SendStart(print_id=attempt.id, printer=printer.name),)


@apply.register
def _(event: ev.PlatesHeld, books: Books) -> Result:
    held = (_set(books.plates[name], hold=hold) for name, hold in event.holds.items())
    return _with(books, *held), ()


@apply.register
def _(event: ev.PrintProgressed, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    if attempt.state.ended:
        return books, ()
    started_s = attempt.started_s if attempt.started_s is not None else event.started_s
    extruded = attempt.extruded or event.extruded
    paused = attempt.paused or event.state is PrintState.PAUSED
    attempt = _set(attempt, state=event.state, started_s=started_s, extruded=extruded, paused=paused)
    books = _with(books, attempt)
    return (_soil(books, attempt.printer) if extruded else books), ()


@apply.register
def _(event: ev.PauseAsked, books: Books) -> Result:
    attempt = books.prints[event.print_id]
    if attempt.state.ended or attempt.cancel_asked is not None:
        return books, ()
    send = ev.SendPause(print_id=attempt.id, printer=attempt.printer, wanted=event.wanted)
    return _with(books, _set(attempt, pause_asked=event.wanted)), (send,)


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
    attempt = _set(
        attempt,
        state=state,
        fault=event.fault,
        reason=event.reason,
        started_s=attempt.started_s if attempt.started_s is not None else event.started_s,
        ended_s=event.ended_s,
        extruded=attempt.extruded or event.extruded,
        starved_s=event.starved_s,
    )
    printer = _set(books.printer(attempt.printer), filament=event.filament)
    if state is PrintState.DONE and attempt.started_s is not None and not attempt.paused:
        plate = books.plates[attempt.plate]
        reached_s = event.ended_s - attempt.started_s - plate.prelude_s
        factor = learned(printer.time_factor, plate.print_time_s, reached_s, event.starved_s)
        printer = _set(printer, time_factor=factor)
    if state is PrintState.FAILED:
        printer = _set(printer, look=event.reason or event.fault or "its print failed")
    books = _with(books, attempt, printer)
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
    books = _with(books, _set(printer, bed=Bed.CLEAR, look=None, filament=filament))
    return books, (ev.SendCleared(printer=printer.name, filament=event.filament),)


@apply.register
def _(event: ev.PrinterSeen, books: Books) -> Result:
    printer = books.printer(event.printer)
    bed = event.bed if printer.bed is Bed.UNKNOWN else printer.bed
    filament = event.filament if printer.filament is FilamentState.UNKNOWN else printer.filament
    return _with(books, _set(printer, bed=bed, filament=filament)), ()


@apply.register
def _(event: ev.PrinterDoubted, books: Books) -> Result:
    printer = books.printer(event.printer)
    doubted = _set(printer, bed=Bed.UNKNOWN, filament=FilamentState.UNKNOWN, look=event.reason)
    return _with(books, doubted), ()


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
        return _with(books, _set(job, state=JobState.PRINTED, ended_s=ended_s)), ()
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
        stopped.append(_set(attempt, cancel_asked=reason))
        instructions.append(ev.SendCancel(print_id=attempt.id, printer=attempt.printer, reason=reason))
    job = _set(job, state=state, ended_s=at_s, error=error, reason=reason, hold=None)
    return _with(books, job, *stopped), tuple(instructions)


def _soil(books: Books, printer: str) -> Books:
    """Something may lie on the bed; what is unknown stays unknown."""
    entry = books.printers[printer]
    return _with(books, _set(entry, bed=Bed.NOT_CLEAR)) if entry.bed is Bed.CLEAR else books


def _set(entity: E, **changes: object) -> E:
    """The entity with some fields replaced; itself where nothing changes."""
    if all(getattr(entity, name) == value for name, value in changes.items()):
        return entity
    return entity.model_copy(update=changes)


def _with(books: Books, *entities: Entity) -> Books:
    """The books with these entities in place of those of the same id."""
    changed: dict[str, dict[object, Entity]] = {}
    for entity in entities:
        kind, key = _place(entity)
        current = changed.get(kind, getattr(books, kind))
        if current.get(key) is not entity:
            changed[kind] = {**current, key: entity}
    return replace(books, **changed) if changed else books  # type: ignore[arg-type]


def _place(entity: Entity) -> tuple[str, object]:
    match entity:
        case Job():
            return "jobs", entity.id
        case Part():
            return "parts", entity.id
        case Plate():
            return "plates", entity.id
        case Print():
            return "prints", entity.id
        case Printer():
            return "printers", entity.name
    raise TypeError(f"the books keep no {type(entity).__name__}")


def changed(before: Books, after: Books) -> Iterable[Entity]:
    """The entities of `after` that `before` has not, or has otherwise."""
    for kind in ("jobs", "parts", "plates", "prints", "printers"):
        old, new = getattr(before, kind), getattr(after, kind)
        if new is not old:
            yield from (entity for key, entity in new.items() if old.get(key) is not entity)
