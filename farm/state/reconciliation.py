"""Reconciliation of the books with what an agent reports: its snapshots, and its journal. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from farm.model import AgentPrint, AgentSnapshot, Bed, FilamentState, Link, Plate, Print, Printer, PrintState
from farm.state import events as ev
from farm.state.books import Books
from farm.state.faults import OwnFault
from farm.state.plate_state import PlateState
from farm.state.transitions import apply

CLOCKS_APART_S = 60.0
"""Moments on the clocks of two hosts that are no further apart are the same."""


def reconcile_print(attempt: Print, snapshot: AgentSnapshot, now_s: float) -> Iterator[ev.AnyEvent]:
    """Derive what has happened to an open print from its agent's snapshot.

    Parameters
    ----------
    attempt
        An open print of the books, on the printer of the snapshot.
    snapshot
        The agent's latest. An agent that has just been started has read its journal before it reports.
    now_s
        Farm time, for what has no time of its own.
    """
    said = snapshot.print
    if said is None or said.print_id != attempt.id:
        yield from _reconcile_unknown(attempt, snapshot, now_s)
    elif said.state.ended:
        yield ev.PrintEnded(
            at_s=now_s,
            print_id=attempt.id,
            state=said.state,
            fault=said.fault,
            reason=said.reason,
            started_s=said.started_s,
            ended_s=said.ended_s if said.ended_s is not None else now_s,
            extruded=said.extruded,
            filament=snapshot.filament,
            starved_s=said.starved_s,
            printed_share=said.progress_s / said.print_time_s if said.print_time_s else None,
        )
    elif said.state is not attempt.state or said.extruded != attempt.extruded or attempt.restored:
        yield ev.PrintProgressed(
            at_s=now_s,
            print_id=attempt.id,
            state=said.state,
            started_s=said.started_s,
            extruded=said.extruded,
        )


def _reconcile_unknown(attempt: Print, snapshot: AgentSnapshot, now_s: float) -> Iterator[ev.AnyEvent]:
    """Derive what has happened to an open print of which its agent says nothing."""
    if snapshot.link is Link.STARTING:
        return
    begun = attempt.state is not PrintState.ASSIGNED
    reason = attempt.cancel_reason or snapshot.reason or f"its printer is {snapshot.link}"
    # What it was told may be on its way: it is done with the print when it has heard of the end too.
    if not begun and not (
        _is_gone(snapshot) or attempt.restored or snapshot.acknowledged_cancel == attempt.id
    ):
        if attempt.cancel_reason is None and snapshot.link in (Link.FAULT, Link.ABSENT):
            yield ev.PrintWithdrawn(at_s=now_s, print_id=attempt.id, reason=reason)
        return
    unknown = "its agent has no record of this print"
    if attempt.restored:
        unknown += " any more, and the database is a backup: check what became of it"
    yield ev.PrintEnded(
        at_s=now_s,
        print_id=attempt.id,
        state=PrintState.FAILED if begun else PrintState.CANCELLED,
        fault=OwnFault.PRINT_LOST if begun else None,
        reason=unknown if begun or attempt.restored else f"never begun: {reason}",
        started_s=None,
        ended_s=now_s,
        extruded=False,
        filament=snapshot.filament,
    )


def refused_print_end(
    attempt: Print, printer: Printer, reason: str, late: bool, now_s: float
) -> ev.PrintEnded:
    """Return the end of a print that its agent did not start: failed, or never begun where it came `late`."""
    return ev.PrintEnded(
        at_s=now_s,
        print_id=attempt.id,
        state=PrintState.CANCELLED if late else PrintState.FAILED,
        fault=None if late else OwnFault.REFUSED,
        reason=f"not started: {reason}" if late else f"its agent refused to start it: {reason}",
        started_s=None,
        ended_s=now_s,
        extruded=False,
        filament=printer.filament,
        printed_share=0.0,  # its reel is as it was
    )


def _is_gone(snapshot: AgentSnapshot) -> bool:
    """Return whether there is no agent any more that could begin anything."""
    return snapshot.link is Link.ABSENT and snapshot.agent_pid is None


def pending_instructions(
    attempt: Print, snapshot: AgentSnapshot, ends_by_s: float | None = None
) -> Iterator[ev.AnyInstruction]:
    """Derive what the agent of an open print has to be told (again).

    Every message is idempotent by print id.

    Parameters
    ----------
    attempt
        An open print of the books.
    snapshot
        Its agent's latest.
    ends_by_s
        Farm time at which the print has to be ended; None where it may take as long as it takes.
    """
    said = snapshot.print if snapshot.print is not None and snapshot.print.print_id == attempt.id else None
    if snapshot.link is Link.STARTING:
        return  # nobody hears it
    if said is not None and not said.state.ended and not _is_same_moment(said.ends_by_s, ends_by_s):
        yield ev.SendEndBy(print_id=attempt.id, printer=attempt.printer, ends_by_s=ends_by_s)
    if attempt.cancel_reason is not None:
        if said is None or not said.state.ended:
            reason = attempt.cancel_reason
            yield ev.SendCancel(print_id=attempt.id, printer=attempt.printer, reason=reason)
    elif said is not None:
        if said.state is (PrintState.PRINTING if attempt.pause_requested else PrintState.PAUSED):
            wanted = attempt.pause_requested
            yield ev.SendPause(print_id=attempt.id, printer=attempt.printer, wanted=wanted)
    elif attempt.state is PrintState.ASSIGNED and not attempt.restored and snapshot.link is Link.READY:
        yield ev.SendStart(print_id=attempt.id, printer=attempt.printer)


def _is_same_moment(one_s: float | None, other_s: float | None) -> bool:
    """Return whether two moments are the same, as far as clocks of two hosts can tell."""
    if one_s is None or other_s is None:
        return one_s is other_s
    return abs(one_s - other_s) <= CLOCKS_APART_S


def observe_idle_printer(printer: Printer, snapshot: AgentSnapshot, now_s: float) -> Iterator[ev.AnyEvent]:
    """Derive bed and filament of an idle printer from its snapshot.

    An agent that saw something happen which it did not cause (a reset, a lost port, a heater that somebody
    switched on) says so until a person has cleared the bed. An emulator, and nothing else, is asked where the
    books do not know.
    """
    if snapshot.bed_unknown_reason is not None:
        if printer.bed is not Bed.UNKNOWN or printer.attention_reason is None:
            yield ev.BedBecameUnknown(at_s=now_s, printer=printer.name, reason=snapshot.bed_unknown_reason)
    elif snapshot.link is Link.READY and snapshot.bed_clear is not None:
        unknown = printer.bed is Bed.UNKNOWN or printer.filament is FilamentState.UNKNOWN
        if unknown and printer.attention_reason is None:
            bed = Bed.CLEAR if snapshot.bed_clear else Bed.NOT_CLEAR
            yield ev.BedReported(at_s=now_s, printer=printer.name, bed=bed, filament=snapshot.filament)


def detect_alarm(printer: Printer, snapshot: AgentSnapshot, now_s: float) -> Iterator[ev.AnyEvent]:
    """Derive a new alarm of a heater that cannot be switched off, whatever the printer is doing."""
    if snapshot.alarm is not None and snapshot.alarm != printer.alarm:
        yield ev.PrinterAlarmed(at_s=now_s, printer=printer.name, reason=snapshot.alarm)


def handle_unknown_print(
    printer: Printer, known: Print | None, snapshot: AgentSnapshot, now_s: float
) -> Iterator[ev.AnyEvent | ev.AnyInstruction]:
    """Derive what to do about a print that an agent has and the books do not have open.

    Parameters
    ----------
    known
        That print in the books, where it has ended; None where they never had it (they were put back from a
        backup, say).
    """
    said = snapshot.print
    if said is None:
        return
    name = printer.name
    if known is not None and said.extruded and not known.extruded and printer.bed is Bed.CLEAR:
        reason = "it started a print that the farm had withdrawn: check whether its bed is clear"
        yield ev.BedBecameUnknown(at_s=now_s, printer=name, reason=reason)
    if known is not None and not said.state.ended:
        reason = "the farm has recorded this print as ended"
        yield ev.SendCancel(print_id=said.print_id, printer=name, reason=reason)
        return
    if known is None and printer.bed is not Bed.UNKNOWN:
        reason = "it made a print that is not in the database: check whether its bed is clear"
        yield ev.BedBecameUnknown(at_s=now_s, printer=name, reason=reason)
    if said.state.ended:
        yield ev.SendForget(print_id=said.print_id, printer=name)


def import_agent_journal(
    books: Books, snapshot: AgentSnapshot, prints: Sequence[AgentPrint], now_s: float
) -> Iterator[ev.AnyEvent]:
    """Derive what has happened on a printer since its books were copied.

    Parameters
    ----------
    snapshot
        Its agent's latest word.
    prints
        All that had not ended when the books were copied, in order. Only the last can be open, and none is
        another printer's: what is said otherwise is held for a person.
    now_s
        Farm time.
    """
    name, unknown = snapshot.printer, 0

    def applied(events: Iterable[ev.AnyEvent]) -> Iterator[ev.AnyEvent]:
        nonlocal books
        for event in events:
            books, _ = apply(event, books)
            yield event

    left = books.open_print_on(name)
    if left is not None and left.id not in {said.print_id for said in prints}:
        yield from applied(reconcile_print(left, snapshot.model_copy(update={"print": None}), now_s))
    for said in prints:
        attempt = books.prints.get(said.print_id)
        if attempt is None or attempt.printer != name:
            free = attempt is None and books.open_print_on(name) is None
            plate = find_plate(books, name, said) if free else None
            if plate is None:
                unknown += said.state is PrintState.DONE or not said.state.ended
                continue
            found = ev.PrintFound(
                at_s=said.started_s or now_s, plate=plate.id, printer=name, print_id=said.print_id
            )
            yield from applied([found])
            attempt = books.prints[said.print_id]
        if not attempt.state.ended:
            yield from applied(reconcile_print(attempt, snapshot.model_copy(update={"print": said}), now_s))
    yield ev.AgentJournalImported(at_s=now_s, printer=name, unknown=unknown)


def find_plate(books: Books, printer: str, said: AgentPrint) -> Plate | None:
    """Find the plate of a print that the books do not know: one of its very file that is not printed.

    Plates of one file are alike: one that waits is taken first, or one that was planned for this printer. A
    print that began before a job was planned is none of its.
    """
    if said.sha256 is None or said.started_s is None:
        return None
    alike = [
        plate
        for job in books.jobs.values()
        if job.planned_s is not None and job.planned_s <= said.started_s + CLOCKS_APART_S
        for plate in books.plates_of(job)
        if plate.sha256 == said.sha256 and (_waits(books, plate) or _waited(books, plate))
    ]
    return min(alike, key=lambda p: (not _waits(books, p), p.printer != printer), default=None)


def _waits(books: Books, plate: Plate) -> bool:
    return books.plate_state(plate) is PlateState.WAITING


def _waited(books: Books, plate: Plate) -> bool:
    """Return whether a plate may wait again: no agent has confirmed yet that its open prints still are."""
    still = [attempt.restored for attempt in books.prints_of(plate) if not attempt.state.ended]
    return books.plate_state(plate) is PlateState.PRINTING and all(still)
