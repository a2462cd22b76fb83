"""Lifecycles of jobs, plates, prints and printers: tables of events and the states that they connect. Pure.

`farm.state.transitions.apply_event` rejects all other transitions. The state diagrams of the documentation
are generated from these tables.
"""

from __future__ import annotations

from collections.abc import Iterable

from farm.model import Bed, JobState, PrintState
from farm.state import events as ev
from farm.state.books import Books
from farm.state.lifecycles.lifecycle import NO_STATE, EventKind, Lifecycle, PrinterState, State, Transition
from farm.state.plate_state import PlateState


def find_printer_state(books: Books, name: str) -> PrinterState | None:
    """Return the state of a printer; NO_STATE if it does not exist."""
    printer = books.printers.get(name)
    if printer is None:
        return NO_STATE
    if books.find_open_print(name) is not None:
        return PrinterState.PRINTING
    return _STATE_BY_BED[printer.bed]


_STATE_BY_BED = {
    Bed.CLEAR: PrinterState.CLEAR,
    Bed.NOT_CLEAR: PrinterState.NOT_CLEAR,
    Bed.UNKNOWN: PrinterState.UNKNOWN,
}


def _find_job_state(books: Books, key: object) -> State | None:
    job = books.jobs.get(key)  # type: ignore[call-overload]
    return NO_STATE if job is None else job.state


def _find_plate_state(books: Books, key: object) -> State | None:
    plate = books.plates.get(str(key))
    return NO_STATE if plate is None else books.find_plate_state(plate)


def _find_print_state(books: Books, key: object) -> State | None:
    attempt = books.prints.get(str(key))
    return NO_STATE if attempt is None else attempt.state


def _make_row(
    event_kind: EventKind, start_states: Iterable[State | None], end_states: Iterable[State] | None
) -> Transition:
    return Transition(
        event_kind, frozenset(start_states), None if end_states is None else frozenset(end_states)
    )


_OPEN_JOB_STATES = (JobState.QUEUED, JobState.PLANNING, JobState.HELD, JobState.PRINTING)
_DERIVED_STATES = (JobState.PRINTING, JobState.PRINTED, JobState.DONE, JobState.FAILED, JobState.CANCELLED)
"""States that are derived from a job's plates."""
JOB_LIFECYCLE = Lifecycle(
    entity_name="job",
    key_field="job",
    states=JobState,
    find_state=_find_job_state,
    transitions=(
        _make_row(ev.JobSubmitted, [NO_STATE], [JobState.QUEUED]),
        _make_row(ev.JobHeld, [JobState.QUEUED], None),
        _make_row(ev.PlanningStarted, [JobState.QUEUED], [JobState.PLANNING]),
        _make_row(ev.PlanningAbandoned, [JobState.PLANNING], [JobState.QUEUED]),
        _make_row(ev.JobPlanned, [JobState.PLANNING], [JobState.HELD, JobState.PRINTING]),
        _make_row(ev.PlanRevised, [JobState.PRINTING], None),
        _make_row(ev.JobApproved, [JobState.HELD], _DERIVED_STATES),
        _make_row(ev.JobReleased, [JobState.QUEUED, JobState.PLANNING, JobState.HELD], None),
        _make_row(ev.JobFailed, [JobState.PLANNING], [JobState.FAILED]),
        _make_row(ev.JobPaused, _OPEN_JOB_STATES, None),
        _make_row(ev.JobMoved, _OPEN_JOB_STATES, None),
        _make_row(ev.JobRescheduled, _OPEN_JOB_STATES, None),
        _make_row(ev.JobAssembled, [JobState.PRINTED, JobState.DONE], None),
        _make_row(ev.JobCancelled, _OPEN_JOB_STATES, [JobState.CANCELLED]),
        _make_row(ev.JobPruned, [JobState.DONE, JobState.FAILED, JobState.CANCELLED], None),
    ),
    consequences=(
        _make_row(ev.PrintEnded, [JobState.PRINTING], _DERIVED_STATES),
        # If a loss turns out to be part of an outage, the failures caused by it no longer count as attempts.
        _make_row(ev.PrintEnded, [JobState.FAILED], [JobState.PRINTING]),
        _make_row(ev.PrinterLost, [JobState.FAILED], [JobState.PRINTING]),
        _make_row(ev.BedCleared, [JobState.PRINTING, JobState.PRINTED, JobState.FAILED], _DERIVED_STATES),
        _make_row(ev.PlateCancelled, [JobState.PRINTING, JobState.PRINTED, JobState.FAILED], _DERIVED_STATES),
        _make_row(
            ev.ReprintRequested,
            [JobState.PRINTED, JobState.DONE, JobState.FAILED, JobState.CANCELLED],
            [JobState.PRINTING],
        ),
        _make_row(ev.BooksRestored, [JobState.PRINTING], [JobState.HELD]),
    ),
)

_UNPRINTED_STATES = (PlateState.WAITING, PlateState.PRINTING, PlateState.OUT_OF_ATTEMPTS)
PLATE_LIFECYCLE = Lifecycle(
    entity_name="plate",
    key_field="plate",
    states=PlateState,
    find_state=_find_plate_state,
    transitions=(
        _make_row(ev.PlateAssigned, [PlateState.WAITING], [PlateState.PRINTING]),
        _make_row(ev.PlateReplaced, [PlateState.WAITING], [PlateState.REPLACED]),
        _make_row(ev.PlatePaused, [PlateState.WAITING], None),
        _make_row(ev.PlateCancelled, _UNPRINTED_STATES, [PlateState.CANCELLED]),
        _make_row(ev.PlateCancelled, [PlateState.PRINTED, PlateState.GOOD], None),
        # WAITING: `farm estop` leaves a plate waiting, paused. A reprint request does not end open prints.
        _make_row(
            ev.ReprintRequested,
            [
                PlateState.WAITING,
                PlateState.PRINTED,
                PlateState.GOOD,
                PlateState.OUT_OF_ATTEMPTS,
                PlateState.CANCELLED,
            ],
            [PlateState.WAITING, PlateState.PRINTING, PlateState.PRINTED, PlateState.GOOD],
        ),
        _make_row(ev.PrintFound, [PlateState.WAITING, PlateState.PRINTING], [PlateState.PRINTING]),
    ),
    consequences=(
        _make_row(ev.JobPlanned, [NO_STATE], [PlateState.WAITING]),
        _make_row(ev.PlanRevised, [NO_STATE, PlateState.REPLACED], [PlateState.WAITING]),
        _make_row(ev.PlanRevised, [PlateState.WAITING], [PlateState.REPLACED]),
        _make_row(ev.PlateReplaced, [NO_STATE], [PlateState.WAITING]),
        _make_row(ev.JobCancelled, _UNPRINTED_STATES, [PlateState.CANCELLED]),
        _make_row(ev.JobFailed, _UNPRINTED_STATES, [PlateState.CANCELLED]),
        _make_row(
            ev.PrintEnded,
            [PlateState.PRINTING],
            [PlateState.PRINTED, PlateState.WAITING, PlateState.OUT_OF_ATTEMPTS],
        ),
        _make_row(ev.PrintEnded, [PlateState.CANCELLED], [PlateState.PRINTED]),
        _make_row(ev.PrintEnded, [PlateState.OUT_OF_ATTEMPTS], [PlateState.WAITING]),
        _make_row(ev.PrinterLost, [PlateState.OUT_OF_ATTEMPTS], [PlateState.WAITING]),
        _make_row(
            ev.BedCleared,
            [PlateState.PRINTED],
            [PlateState.GOOD, PlateState.WAITING, PlateState.PRINTING, PlateState.CANCELLED],
        ),
        _make_row(ev.BedCleared, [*_UNPRINTED_STATES, PlateState.CANCELLED], [PlateState.GOOD]),
    ),
)

_OPEN_PRINT_STATES = tuple(state for state in PrintState if not state.ended)
PRINT_LIFECYCLE = Lifecycle(
    entity_name="print",
    key_field="print_id",
    states=PrintState,
    find_state=_find_print_state,
    transitions=(
        _make_row(ev.PlateAssigned, [NO_STATE], [PrintState.ASSIGNED]),
        _make_row(ev.PrintFound, [NO_STATE], [PrintState.ASSIGNED]),
        _make_row(ev.PrintProgressed, _OPEN_PRINT_STATES, _OPEN_PRINT_STATES),
        _make_row(ev.PauseRequested, _OPEN_PRINT_STATES, None),
        _make_row(ev.PrintFailRequested, _OPEN_PRINT_STATES, None),
        _make_row(ev.PrintWithdrawn, [PrintState.ASSIGNED], None),
        _make_row(
            ev.PrintEnded, _OPEN_PRINT_STATES, [PrintState.DONE, PrintState.FAILED, PrintState.CANCELLED]
        ),
        _make_row(ev.StillKept, PrintState, None),
    ),
    consequences=(_make_row(ev.BedCleared, [PrintState.FAILED, PrintState.CANCELLED], [PrintState.DONE]),),
)

_IDLE_STATES = (PrinterState.CLEAR, PrinterState.NOT_CLEAR, PrinterState.UNKNOWN)
PRINTER_LIFECYCLE = Lifecycle(
    entity_name="printer",
    key_field="printer",
    states=PrinterState,
    find_state=lambda books, key: find_printer_state(books, str(key)),
    transitions=(
        _make_row(ev.PrinterAdded, [NO_STATE], _IDLE_STATES),
        _make_row(ev.PlateAssigned, [PrinterState.CLEAR], [PrinterState.PRINTING]),
        _make_row(ev.PrintFound, _IDLE_STATES, [PrinterState.PRINTING]),
        _make_row(ev.BedCleared, _IDLE_STATES, [PrinterState.CLEAR]),
        _make_row(
            ev.BedReported,
            [PrinterState.UNKNOWN],
            [PrinterState.CLEAR, PrinterState.NOT_CLEAR, PrinterState.UNKNOWN],
        ),
        _make_row(ev.BedReported, [PrinterState.CLEAR, PrinterState.NOT_CLEAR], None),
        _make_row(ev.BedBecameUnknown, _IDLE_STATES, [PrinterState.UNKNOWN]),
        _make_row(ev.BedBecameUnknown, [PrinterState.PRINTING], None),
        _make_row(ev.PrinterAlarmed, PrinterState, None),
        _make_row(ev.PrinterLost, _IDLE_STATES, None),
        _make_row(ev.ReelLoaded, PrinterState, None),
        _make_row(ev.MaintenanceStarted, PrinterState, None),
        _make_row(ev.MaintenanceEnded, PrinterState, None),
        _make_row(ev.AgentJournalImported, PrinterState, None),
        _make_row(ev.AgentJournalImported, _IDLE_STATES, [PrinterState.UNKNOWN]),
    ),
    consequences=(
        _make_row(ev.PrintEnded, [PrinterState.PRINTING], _IDLE_STATES),
        _make_row(ev.BooksRestored, [PrinterState.CLEAR, PrinterState.UNKNOWN], [PrinterState.NOT_CLEAR]),
    ),
)

LIFECYCLES = (JOB_LIFECYCLE, PLATE_LIFECYCLE, PRINT_LIFECYCLE, PRINTER_LIFECYCLE)
FARM_WIDE_EVENTS: frozenset[EventKind] = frozenset(
    {
        *(ev.ClockSet, ev.BooksRestored, ev.EventsCompacted, ev.OutageConfirmed),
        *(ev.HostLost, ev.HostConnected),
        *(ev.KeyAdded, ev.KeyRevoked, ev.SessionOpened, ev.SessionExtended),
    }
)
"""Events about the farm as a whole, its hosts, keys, or sessions; allowed at any time."""
