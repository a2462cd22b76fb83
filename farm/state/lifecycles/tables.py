"""Lifecycles of jobs, plates, prints and printers: tables of events and the states they connect. Pure.

`farm.state.transitions.apply_event` rejects all other transitions. The state diagrams of the documentation
are generated from these tables.
"""

from __future__ import annotations

from collections.abc import Iterable

from farm.model import Bed, JobState, PrintState
from farm.state import events as ev
from farm.state.books import Books
from farm.state.lifecycles.lifecycle import NEW, Kind, Lifecycle, PrinterState, State, Transition
from farm.state.plate_state import PlateState


def printer_state(books: Books, name: str) -> PrinterState | None:
    """Return the state of a printer; NEW if it does not exist."""
    printer = books.printers.get(name)
    if printer is None:
        return NEW
    if books.open_print_on(name) is not None:
        return PrinterState.PRINTING
    return _BY_BED[printer.bed]


_BY_BED = {
    Bed.CLEAR: PrinterState.CLEAR,
    Bed.NOT_CLEAR: PrinterState.NOT_CLEAR,
    Bed.UNKNOWN: PrinterState.UNKNOWN,
}


def _find_job_state(books: Books, key: object) -> State | None:
    job = books.jobs.get(key)  # type: ignore[call-overload]
    return NEW if job is None else job.state


def _find_plate_state(books: Books, key: object) -> State | None:
    plate = books.plates.get(str(key))
    return NEW if plate is None else books.plate_state(plate)


def _find_print_state(books: Books, key: object) -> State | None:
    attempt = books.prints.get(str(key))
    return NEW if attempt is None else attempt.state


def _make_row(event: Kind, starts: Iterable[State | None], ends: Iterable[State] | None) -> Transition:
    return Transition(event, frozenset(starts), None if ends is None else frozenset(ends))


_J, _P, _A, _B = JobState, PlateState, PrintState, PrinterState
_LIVE = (_J.QUEUED, _J.PLANNING, _J.HELD, _J.PRINTING)
_DERIVED = (_J.PRINTING, _J.PRINTED, _J.DONE, _J.FAILED, _J.CANCELLED)
"""States that are derived from a job's plates."""
JOB = Lifecycle(
    entity="job",
    key="job",
    states=JobState,
    find_state=_find_job_state,
    transitions=(
        _make_row(ev.JobSubmitted, [NEW], [_J.QUEUED]),
        _make_row(ev.JobHeld, [_J.QUEUED], None),
        _make_row(ev.PlanningStarted, [_J.QUEUED], [_J.PLANNING]),
        _make_row(ev.PlanningAbandoned, [_J.PLANNING], [_J.QUEUED]),
        _make_row(ev.JobPlanned, [_J.PLANNING], [_J.HELD, _J.PRINTING]),
        _make_row(ev.PlanRevised, [_J.PRINTING], None),
        _make_row(ev.JobApproved, [_J.HELD], _DERIVED),
        _make_row(ev.JobReleased, [_J.QUEUED, _J.PLANNING, _J.HELD], None),
        _make_row(ev.JobFailed, [_J.PLANNING], [_J.FAILED]),
        _make_row(ev.JobPaused, _LIVE, None),
        _make_row(ev.JobMoved, _LIVE, None),
        _make_row(ev.JobRescheduled, _LIVE, None),
        _make_row(ev.JobAssembled, [_J.PRINTED, _J.DONE], None),
        _make_row(ev.JobCancelled, _LIVE, [_J.CANCELLED]),
        _make_row(ev.JobPruned, [_J.DONE, _J.FAILED, _J.CANCELLED], None),
    ),
    consequences=(
        _make_row(ev.PrintEnded, [_J.PRINTING], _DERIVED),
        # Losses that prove to be an outage: the failures of their prints no longer count as attempts.
        _make_row(ev.PrintEnded, [_J.FAILED], [_J.PRINTING]),
        _make_row(ev.PrinterLost, [_J.FAILED], [_J.PRINTING]),
        _make_row(ev.BedCleared, [_J.PRINTING, _J.PRINTED, _J.FAILED], _DERIVED),
        _make_row(ev.PlateCancelled, [_J.PRINTING, _J.PRINTED, _J.FAILED], _DERIVED),
        _make_row(ev.ReprintRequested, [_J.PRINTED, _J.DONE, _J.FAILED, _J.CANCELLED], [_J.PRINTING]),
        _make_row(ev.BooksRestored, [_J.PRINTING], [_J.HELD]),
    ),
)

_UNPRINTED = (_P.WAITING, _P.PRINTING, _P.OUT_OF_ATTEMPTS)
PLATE = Lifecycle(
    entity="plate",
    key="plate",
    states=PlateState,
    find_state=_find_plate_state,
    transitions=(
        _make_row(ev.PlateAssigned, [_P.WAITING], [_P.PRINTING]),
        _make_row(ev.PlateReplaced, [_P.WAITING], [_P.REPLACED]),
        _make_row(ev.PlatePaused, [_P.WAITING], None),
        _make_row(ev.PlateCancelled, _UNPRINTED, [_P.CANCELLED]),
        _make_row(ev.PlateCancelled, [_P.PRINTED, _P.GOOD], None),
        # After `farm estop` the plate already waits; open prints are not ended.
        _make_row(
            ev.ReprintRequested,
            [_P.WAITING, _P.PRINTED, _P.GOOD, _P.OUT_OF_ATTEMPTS, _P.CANCELLED],
            [_P.WAITING, _P.PRINTING, _P.PRINTED, _P.GOOD],
        ),
        _make_row(ev.PrintFound, [_P.WAITING, _P.PRINTING], [_P.PRINTING]),
    ),
    consequences=(
        _make_row(ev.JobPlanned, [NEW], [_P.WAITING]),
        _make_row(ev.PlanRevised, [NEW, _P.REPLACED], [_P.WAITING]),
        _make_row(ev.PlanRevised, [_P.WAITING], [_P.REPLACED]),
        _make_row(ev.PlateReplaced, [NEW], [_P.WAITING]),
        _make_row(ev.JobCancelled, _UNPRINTED, [_P.CANCELLED]),
        _make_row(ev.JobFailed, _UNPRINTED, [_P.CANCELLED]),
        _make_row(ev.PrintEnded, [_P.PRINTING], [_P.PRINTED, _P.WAITING, _P.OUT_OF_ATTEMPTS]),
        _make_row(ev.PrintEnded, [_P.CANCELLED], [_P.PRINTED]),
        _make_row(ev.PrintEnded, [_P.OUT_OF_ATTEMPTS], [_P.WAITING]),
        _make_row(ev.PrinterLost, [_P.OUT_OF_ATTEMPTS], [_P.WAITING]),
        _make_row(ev.BedCleared, [_P.PRINTED], [_P.GOOD, _P.WAITING, _P.PRINTING, _P.CANCELLED]),
        _make_row(ev.BedCleared, [*_UNPRINTED, _P.CANCELLED], [_P.GOOD]),
    ),
)

_OPEN = tuple(state for state in PrintState if not state.ended)
PRINT = Lifecycle(
    entity="print",
    key="print_id",
    states=PrintState,
    find_state=_find_print_state,
    transitions=(
        _make_row(ev.PlateAssigned, [NEW], [_A.ASSIGNED]),
        _make_row(ev.PrintFound, [NEW], [_A.ASSIGNED]),
        _make_row(ev.PrintProgressed, _OPEN, _OPEN),
        _make_row(ev.PauseRequested, _OPEN, None),
        _make_row(ev.PrintFailRequested, _OPEN, None),
        _make_row(ev.PrintWithdrawn, [_A.ASSIGNED], None),
        _make_row(ev.PrintEnded, _OPEN, [_A.DONE, _A.FAILED, _A.CANCELLED]),
        _make_row(ev.StillKept, PrintState, None),
    ),
    consequences=(_make_row(ev.BedCleared, [_A.FAILED, _A.CANCELLED], [_A.DONE]),),
)

_IDLE = (_B.CLEAR, _B.NOT_CLEAR, _B.UNKNOWN)
PRINTER = Lifecycle(
    entity="printer",
    key="printer",
    states=PrinterState,
    find_state=lambda books, key: printer_state(books, str(key)),
    transitions=(
        _make_row(ev.PrinterAdded, [NEW], _IDLE),
        _make_row(ev.PlateAssigned, [_B.CLEAR], [_B.PRINTING]),
        _make_row(ev.PrintFound, _IDLE, [_B.PRINTING]),
        _make_row(ev.BedCleared, _IDLE, [_B.CLEAR]),
        _make_row(ev.BedReported, [_B.UNKNOWN], [_B.CLEAR, _B.NOT_CLEAR, _B.UNKNOWN]),
        _make_row(ev.BedReported, [_B.CLEAR, _B.NOT_CLEAR], None),
        _make_row(ev.BedBecameUnknown, _IDLE, [_B.UNKNOWN]),
        _make_row(ev.BedBecameUnknown, [_B.PRINTING], None),
        _make_row(ev.PrinterAlarmed, PrinterState, None),
        _make_row(ev.PrinterLost, _IDLE, None),
        _make_row(ev.ReelLoaded, PrinterState, None),
        _make_row(ev.MaintenanceStarted, PrinterState, None),
        _make_row(ev.MaintenanceEnded, PrinterState, None),
        _make_row(ev.AgentJournalImported, PrinterState, None),
        _make_row(ev.AgentJournalImported, _IDLE, [_B.UNKNOWN]),
    ),
    consequences=(
        _make_row(ev.PrintEnded, [_B.PRINTING], _IDLE),
        _make_row(ev.BooksRestored, [_B.CLEAR, _B.UNKNOWN], [_B.NOT_CLEAR]),
    ),
)

LIFECYCLES = (JOB, PLATE, PRINT, PRINTER)
FARM_WIDE: frozenset[Kind] = frozenset(
    {
        *(ev.ClockSet, ev.BooksRestored, ev.EventsCompacted, ev.OutageConfirmed),
        *(ev.HostLost, ev.HostConnected),
        *(ev.KeyAdded, ev.KeyRevoked, ev.SessionOpened, ev.SessionExtended),
    }
)
"""Events about the farm as a whole, its hosts, keys, or sessions; allowed at any time."""
