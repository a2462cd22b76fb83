"""Steps of the host's clock: durations and the order of prints are kept."""

from books.make_books import apply_events, make_end_event, make_planned_books
from farm.model import HoldCode, PrintState, Verdict
from farm.scheduling.holds import find_held_back_plates
from farm.state import events as ev
from farm.state.books import Books, put
from farm.state.plate_state import PlateState
from farm.state.storage.store import Store
from farm.state.transitions import apply
from farm.views import list_due_notices


def test_verdict_applies_to_the_last_print_despite_a_clock_step(tmp_path):
    path = tmp_path / "farm.db"
    earlier_events = (
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        make_end_event("x", at_s=5000.0),
        ev.BedCleared(at_s=5001.0, printer="a", by="ann"),
        ev.ClockSet(at_s=1000.0, by_s=-4001.0),
        ev.PlateAssigned(at_s=1100.0, plate="1/02", printer="a", print_id="y"),
        make_end_event("y", at_s=1500.0, started_s=1100.0),
    )
    with Store(path) as store:
        books = make_planned_books()
        store.commit(earlier_events[0], Books(), books)
        for event in earlier_events:
            old_books = books
            books, _ = apply(event, books)
            store.commit(event, old_books, books)
        assert books.find_print_to_judge("a").id == "y"
        first_print = books.prints["x"].model_copy(update={"verdict_why": "as it should be"})
        store.commit(earlier_events[0], books, put(books, first_print))  # the first print is written last
        assert store.load().find_print_to_judge("a").id == "y"
    books, _ = apply_events(books, ev.BedCleared(at_s=1600.0, printer="a", by="ann", verdict=Verdict.BAD))
    assert books.find_plate_state(books.plates["1/02"]) is PlateState.WAITING


def test_loss_before_a_backward_clock_step_is_notified_and_repeated():
    lost_events = (
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        make_end_event("x", PrintState.FAILED, 5000.0, fault="port_lost", reason="it went"),
    )
    books, _ = apply_events(
        make_planned_books(plates=1), *lost_events, ev.ClockSet(at_s=1000.0, by_s=-4000.0)
    )
    assert find_held_back_plates(books, books.jobs.values(), [], 5005.0)["1/01"].code is HoldCode.JUST_LOST
    assert find_held_back_plates(books, books.jobs.values(), [], 1000.0) == {}
    assert [item.key for item in list_due_notices(books, 1000.0, 0.0, ())] == ["print x"]


def test_clock_step_shifts_only_open_prints():
    books, _ = apply_events(
        make_planned_books(),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        make_end_event("x"),
        ev.PlateAssigned(at_s=300.0, plate="1/02", printer="b", print_id="y"),
        ev.PrintProgressed(
            at_s=310.0, print_id="y", state=PrintState.PRINTING, started_s=305.0, extruded=True
        ),
        ev.ClockSet(at_s=1000.0, by_s=500.0),
    )
    assert (books.prints["y"].assigned_s, books.prints["y"].started_s) == (800.0, 805.0)
    assert (books.prints["x"].started_s, books.prints["x"].ended_s) == (2.0, 200.0)
