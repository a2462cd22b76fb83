"""Reconciliation of the books with an agent's reports: its snapshots and its journal. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from farm.model import AgentPrint, AgentSnapshot, Bed, FilamentState, Link, Plate, Print, Printer, PrintState
from farm.state import events as ev
from farm.state.books import Books
from farm.state.faults import FarmFault
from farm.state.plate_state import PlateState
from farm.state.transitions import apply

MAX_CLOCK_DIFFERENCE_S = 60.0
"""Maximum difference between two hosts' clocks, in seconds."""


def reconcile_print(attempt: Print, snapshot: AgentSnapshot, now_s: float) -> Iterator[ev.AnyEvent]:
    """Derive the events of an open print from its agent's snapshot.

    Parameters
    ----------
    attempt
        An open print of the books, on the printer of the snapshot.
    snapshot
        The agent's latest snapshot. A new agent reads its journal before it sends its first snapshot.
    now_s
        Farm time, in seconds; used for events whose time the agent does not report.
    """
    report = snapshot.print
    if report is None or report.print_id != attempt.id:
        yield from _reconcile_unreported_print(attempt, snapshot, now_s)
    elif report.state.ended:
        yield ev.PrintEnded(
            at_s=now_s,
            print_id=attempt.id,
            state=report.state,
            fault=report.fault,
            reason=report.reason,
            started_s=report.started_s,
            ended_s=report.ended_s if report.ended_s is not None else now_s,
            extruded=report.extruded,
            filament=snapshot.filament,
            starved_s=report.starved_s,
            printed_share=report.progress_s / report.print_time_s if report.print_time_s else None,
        )
    elif report.state is not attempt.state or report.extruded != attempt.extruded or attempt.restored:
        yield ev.PrintProgressed(
            at_s=now_s,
            print_id=attempt.id,
            state=report.state,
            started_s=report.started_s,
            extruded=report.extruded,
        )


def _reconcile_unreported_print(
    attempt: Print, snapshot: AgentSnapshot, now_s: float
) -> Iterator[ev.AnyEvent]:
    """Derive the events of an open print that its agent does not report."""
    if snapshot.link is Link.STARTING:
        return
    has_started = attempt.state is not PrintState.ASSIGNED
    reason = attempt.cancel_reason or snapshot.reason or f"its printer is {snapshot.link}"
    # The start request may still be on its way: wait until the agent has received the cancel request.
    if not has_started and not (
        _has_no_agent(snapshot) or attempt.restored or snapshot.acknowledged_cancel == attempt.id
    ):
        if attempt.cancel_reason is None and snapshot.link in (Link.FAULT, Link.ABSENT):
            yield ev.PrintWithdrawn(at_s=now_s, print_id=attempt.id, reason=reason)
        return
    unknown_reason = "its agent has no record of this print"
    if attempt.restored:
        unknown_reason += " any more, and the database is a backup: check what happened to it"
    yield ev.PrintEnded(
        at_s=now_s,
        print_id=attempt.id,
        state=PrintState.FAILED if has_started else PrintState.CANCELLED,
        fault=FarmFault.PRINT_LOST if has_started else None,
        reason=unknown_reason if has_started or attempt.restored else f"not started: {reason}",
        started_s=None,
        ended_s=now_s,
        extruded=False,
        filament=snapshot.filament,
    )


def make_refused_print_end(
    attempt: Print, printer: Printer, reason: str, is_late: bool, now_s: float
) -> ev.PrintEnded:
    """Return the end of a refused print: cancelled if the start request came too late, else failed."""
    return ev.PrintEnded(
        at_s=now_s,
        print_id=attempt.id,
        state=PrintState.CANCELLED if is_late else PrintState.FAILED,
        fault=None if is_late else FarmFault.REFUSED,
        reason=f"not started: {reason}" if is_late else f"its agent refused to start it: {reason}",
        started_s=None,
        ended_s=now_s,
        extruded=False,
        filament=printer.filament,
        printed_share=0.0,  # it used no filament
    )


def _has_no_agent(snapshot: AgentSnapshot) -> bool:
    """Return whether the printer has no running agent, which could still start a print."""
    return snapshot.link is Link.ABSENT and snapshot.agent_pid is None


def list_pending_instructions(
    attempt: Print, snapshot: AgentSnapshot, ends_by_s: float | None = None
) -> Iterator[ev.AnyInstruction]:
    """Derive the instructions that the agent of an open print has not carried out yet.

    The instructions may be repeated: each is idempotent by its print id.

    Parameters
    ----------
    attempt
        An open print of the books.
    snapshot
        Its agent's latest snapshot.
    ends_by_s
        Farm time by which the print has to end; None for no limit.
    """
    report = snapshot.print if snapshot.print is not None and snapshot.print.print_id == attempt.id else None
    if snapshot.link is Link.STARTING:
        return  # there is no agent to receive instructions
    if report is not None and not report.state.ended and not _is_same_time(report.ends_by_s, ends_by_s):
        yield ev.SendEndBy(print_id=attempt.id, printer=attempt.printer, ends_by_s=ends_by_s)
    if attempt.cancel_reason is not None:
        if report is None or not report.state.ended:
            reason = attempt.cancel_reason
            yield ev.SendCancel(print_id=attempt.id, printer=attempt.printer, reason=reason)
    elif report is not None:
        if report.state is (PrintState.PRINTING if attempt.pause_requested else PrintState.PAUSED):
            pause_requested = attempt.pause_requested
            yield ev.SendPause(print_id=attempt.id, printer=attempt.printer, pause=pause_requested)
    elif attempt.state is PrintState.ASSIGNED and not attempt.restored and snapshot.link is Link.READY:
        yield ev.SendStart(print_id=attempt.id, printer=attempt.printer)


def _is_same_time(first_s: float | None, second_s: float | None) -> bool:
    """Return whether two times are equal, except for the difference of two hosts' clocks."""
    if first_s is None or second_s is None:
        return first_s is second_s
    return abs(first_s - second_s) <= MAX_CLOCK_DIFFERENCE_S


def reconcile_idle_printer(printer: Printer, snapshot: AgentSnapshot, now_s: float) -> Iterator[ev.AnyEvent]:
    """Derive the events about the bed and filament of an idle printer from its agent's snapshot.

    An agent reports an external event (a reset, a lost port, a heater switched on by hand) until a person
    has cleared the bed. After a restart of the board without any movement, the agent still knows the state of
    the filament. An emulator reports the state of its bed, which is used if the books do not know it.
    """
    if snapshot.bed_unknown_reason is not None:
        if printer.bed is not Bed.UNKNOWN or printer.attention_reason is None:
            yield ev.BedBecameUnknown(at_s=now_s, printer=printer.name, reason=snapshot.bed_unknown_reason)
        elif printer.filament is FilamentState.UNKNOWN is not snapshot.filament:
            yield ev.BedReported(
                at_s=now_s, printer=printer.name, bed=Bed.UNKNOWN, filament=snapshot.filament
            )
    elif snapshot.link is Link.READY and snapshot.bed_clear is not None:
        is_unknown = printer.bed is Bed.UNKNOWN or printer.filament is FilamentState.UNKNOWN
        if is_unknown and printer.attention_reason is None:
            bed = Bed.CLEAR if snapshot.bed_clear else Bed.NOT_CLEAR
            yield ev.BedReported(at_s=now_s, printer=printer.name, bed=bed, filament=snapshot.filament)


def detect_alarm(printer: Printer, snapshot: AgentSnapshot, now_s: float) -> Iterator[ev.AnyEvent]:
    """Derive the event of a new alarm (a heater that cannot be switched off) from a snapshot."""
    if snapshot.alarm is not None and snapshot.alarm != printer.alarm:
        yield ev.PrinterAlarmed(at_s=now_s, printer=printer.name, reason=snapshot.alarm)


def handle_unknown_print(
    printer: Printer, recorded_print: Print | None, snapshot: AgentSnapshot, now_s: float
) -> Iterator[ev.AnyEvent | ev.AnyInstruction]:
    """Derive the events and instructions for a reported print that is not open in the books.

    Parameters
    ----------
    recorded_print
        The print in the books, if it has ended; None if it is missing, as after a restore.
    """
    report = snapshot.print
    if report is None:
        return
    name = printer.name
    if (
        recorded_print is not None
        and report.extruded
        and not recorded_print.extruded
        and printer.bed is Bed.CLEAR
    ):
        reason = "it started a print that the farm had withdrawn: check whether its bed is clear"
        yield ev.BedBecameUnknown(at_s=now_s, printer=name, reason=reason)
    if recorded_print is not None and not report.state.ended:
        reason = "the farm has recorded this print as ended"
        yield ev.SendCancel(print_id=report.print_id, printer=name, reason=reason)
        return
    if recorded_print is None and printer.bed is not Bed.UNKNOWN:
        reason = "it printed something that is not in the database: check whether its bed is clear"
        yield ev.BedBecameUnknown(at_s=now_s, printer=name, reason=reason)
    if report.state.ended:
        yield ev.SendForget(print_id=report.print_id, printer=name)


def import_agent_journal(
    books: Books, snapshot: AgentSnapshot, prints: Sequence[AgentPrint], now_s: float
) -> Iterator[ev.AnyEvent]:
    """Derive the events since the backup at one printer, from the journal of the printer's agent.

    Parameters
    ----------
    snapshot
        The agent's latest snapshot.
    prints
        Prints in the journal that had not ended at the time of the backup, oldest first. Only the last can be
        open. Prints that match no plate of the books are counted as unknown.
    now_s
        Farm time.
    """
    name, unknown_count = snapshot.printer, 0

    def apply_events(events: Iterable[ev.AnyEvent]) -> Iterator[ev.AnyEvent]:
        nonlocal books
        for event in events:
            books, _ = apply(event, books)
            yield event

    open_print = books.find_open_print(name)
    if open_print is not None and open_print.id not in {report.print_id for report in prints}:
        yield from apply_events(
            reconcile_print(open_print, snapshot.model_copy(update={"print": None}), now_s)
        )
    for report in prints:
        attempt = books.prints.get(report.print_id)
        if attempt is None or attempt.printer != name:
            can_be_added = attempt is None and books.find_open_print(name) is None
            plate = find_plate(books, name, report) if can_be_added else None
            if plate is None:
                unknown_count += report.state is PrintState.DONE or not report.state.ended
                continue
            print_found = ev.PrintFound(
                at_s=report.started_s or now_s, plate=plate.id, printer=name, print_id=report.print_id
            )
            yield from apply_events([print_found])
            attempt = books.prints[report.print_id]
        if not attempt.state.ended:
            yield from apply_events(
                reconcile_print(attempt, snapshot.model_copy(update={"print": report}), now_s)
            )
    yield ev.AgentJournalImported(at_s=now_s, printer=name, unknown=unknown_count)


def find_plate(books: Books, printer: str, report: AgentPrint) -> Plate | None:
    """Find the plate of a print that is not in the books: an unprinted plate with the same file.

    Plates with the same file are equivalent: waiting ones are preferred, then those for this printer.
    Jobs that were planned after the start of the print are ignored.
    """
    if report.sha256 is None or report.started_s is None:
        return None
    candidates = [
        plate
        for job in books.jobs.values()
        if job.planned_s is not None and job.planned_s <= report.started_s + MAX_CLOCK_DIFFERENCE_S
        for plate in books.list_plates(job)
        if plate.sha256 == report.sha256 and (_is_waiting(books, plate) or _may_be_waiting(books, plate))
    ]
    return min(candidates, key=lambda p: (not _is_waiting(books, p), p.printer != printer), default=None)


def _is_waiting(books: Books, plate: Plate) -> bool:
    return books.find_plate_state(plate) is PlateState.WAITING


def _may_be_waiting(books: Books, plate: Plate) -> bool:
    """Return whether a plate may in fact wait: no agent has confirmed its open prints since the restore."""
    restored_flags = [attempt.restored for attempt in books.list_prints(plate) if not attempt.state.ended]
    return books.find_plate_state(plate) is PlateState.PRINTING and all(restored_flags)
