"""Invalid events: an error with the entity's state and history, and unchanged books."""

import pytest

from books.make_books import (
    apply_events,
    make_end_event,
    make_fleet_events,
    make_job,
    make_plan_event,
    make_planned_books,
)
from farm.errors import ErrorCode, NotFoundError
from farm.model import Bed, PrintState
from farm.state import events as ev
from farm.state.books import Books
from farm.state.lifecycles import InvalidTransition
from farm.state.storage.store import Store
from farm.state.transitions import apply

ASSIGNMENT = ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")
HEATING_EVENT = ev.PrintProgressed(
    at_s=3.0, print_id="x", state=PrintState.HEATING, started_s=3.0, extruded=False
)
CANCELLATION = ev.JobCancelled(at_s=5.0, job=1)
INVALID_EVENTS = {
    "a print ends twice": ([ASSIGNMENT, make_end_event("x")], make_end_event("x"), "print x is done"),
    "a print continues after its end": ([ASSIGNMENT, make_end_event("x")], HEATING_EVENT, "print x is done"),
    "a print that has begun is withdrawn": (
        [ASSIGNMENT, HEATING_EVENT],
        ev.PrintWithdrawn(at_s=4.0, print_id="x", reason="test"),
        "print x is heating",
    ),
    "a print is failed after its end": (
        [ASSIGNMENT, make_end_event("x")],
        ev.PrintFailRequested(at_s=9.0, print_id="x", why="a blob", by="ann"),
        "print x is done",
    ),
    "a job is cancelled twice": ([CANCELLATION], CANCELLATION, "job 1 is cancelled"),
    "a cancelled job is planned": ([CANCELLATION], make_plan_event(), "job 1 is cancelled"),
    "a job is approved that is not held": (
        [],
        ev.JobApproved(at_s=5.0, job=1, by="ann"),
        "job 1 is printing",
    ),
    "a printing job fails": (
        [],
        ev.JobFailed(at_s=5.0, job=1, error=ErrorCode.ENGINE, reason="test"),
        "job 1 is printing",
    ),
    "a plate that prints is paused": (
        [ASSIGNMENT],
        ev.PlatePaused(at_s=4.0, plate="1/01", wanted=True, by="ann"),
        "plate 1/01 is printing",
    ),
    "a printer is added twice": ([], make_fleet_events()[0], "printer a is clear"),
    "a bed is cleared under a print": (
        [ASSIGNMENT],
        ev.BedCleared(at_s=4.0, printer="a", by="ann"),
        "printer a is printing",
    ),
    "an outage is confirmed without one": ([], ev.OutageConfirmed(at_s=4.0, by="ann"), "not in an outage"),
    "a print ends in an open state": (
        [ASSIGNMENT],
        make_end_event("x", PrintState.HEATING),
        "print x is assigned, and would be heating",
    ),
}


@pytest.mark.parametrize(("earlier_events", "event", "message"), INVALID_EVENTS.values(), ids=INVALID_EVENTS)
def test_invalid_transition_names_its_cause(earlier_events, event, message):
    books, _ = apply_events(make_planned_books(), *earlier_events)
    with pytest.raises(InvalidTransition, match=message) as error:
        apply(event, books)
    assert type(event).__name__ in str(error.value)


@pytest.mark.parametrize(
    "event",
    [
        ev.JobCancelled(at_s=5.0, job=7),
        ev.PlateCancelled(at_s=5.0, plate="7/01", by="ann"),
        make_end_event("nobody"),
        ev.MaintenanceEnded(at_s=5.0, printer="z", by="ann"),
    ],
    ids=lambda event: type(event).__name__,
)
def test_unknown_entity_is_named(event):
    with pytest.raises(NotFoundError, match="there is no"):
        apply(event, make_planned_books())


def test_state_outside_the_transition_table_is_an_error():
    books, _ = apply_events(Books(), *make_fleet_events(Bed.UNKNOWN))
    started_job = make_job().model_copy(update={"state": "printing"})
    with pytest.raises(InvalidTransition, match="would be printing"):
        apply(ev.JobSubmitted(at_s=1.0, job=started_job), books)


def test_error_has_only_the_history_of_its_entity(tmp_path):
    events = [
        *make_fleet_events(),
        ev.JobSubmitted(at_s=0.0, job=make_job()),
        ev.PlanningStarted(at_s=1.0, job=1),
        make_plan_event(),
        ASSIGNMENT,
        ev.PlateAssigned(at_s=2.0, plate="1/02", printer="b", print_id="y"),
        HEATING_EVENT,
        make_end_event("x"),
    ]
    with Store(tmp_path / "farm.db") as store:
        books = Books()
        for event in events:
            new_books, _ = apply(event, books)
            store.commit(event, books, new_books)
            books = new_books
        with pytest.raises(InvalidTransition) as error:
            apply(HEATING_EVENT, books)
        error_with_print_history = store.add_history(error.value)
        with pytest.raises(InvalidTransition) as error:
            apply(ev.PlanningStarted(at_s=9.0, job=1), books)
        error_with_job_history = store.add_history(error.value)
    assert [line.partition(" ")[2].partition(" ")[2] for line in error_with_print_history.history] == [
        "PlateAssigned",
        "PrintProgressed heating",
        "PrintEnded done",
    ]
    assert "print x is done; before that: 1970-01-01 00:00:02 PlateAssigned, " in str(
        error_with_print_history
    )
    assert [line.split()[2] for line in error_with_job_history.history] == [
        "JobSubmitted",
        "PlanningStarted",
        "JobPlanned",
    ]
