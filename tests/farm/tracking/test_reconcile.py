"""Bringing the books in line with the agents' words."""

from farm.model import AgentPrint, AgentSnapshot, Bed, FilamentState, Link, PrintState
from farm.tracking import events as ev
from farm.tracking.books import Books
from farm.tracking.reconcile import LOST_FAULT, observe, owed, reconcile
from make_books import fleet, printing, run


def test_a_board_reset_makes_bed_and_filament_unknown():
    before = AgentSnapshot(printer="a", link=Link.READY, agent_pid=7, board_resets=0)
    after = before.model_copy(update={"board_resets": 1})
    books, _ = run(printing(), *observe(printing().printers["a"], before, after, 5.0))
    assert books.printers["a"].bed is Bed.UNKNOWN
    assert books.printers["a"].filament is FilamentState.UNKNOWN


def test_an_emulator_is_asked_only_where_the_books_do_not_know():
    said = AgentSnapshot(printer="a", link=Link.READY, bed_clear=True, filament=FilamentState.PARKED)
    books, _ = run(Books(), *fleet(Bed.UNKNOWN))
    books, _ = run(books, *observe(books.printers["a"], None, said, 5.0))
    assert books.printers["a"].bed is Bed.CLEAR
    assert list(observe(books.printers["a"], said, said, 6.0)) == []


def word(print_id="x", state=PrintState.PRINTING, link=Link.BUSY, **changes):
    facts = {
        "fault": None,
        "reason": None,
        "progress_s": 5.0,
        "print_time_s": 90.0,
        "extruded": True,
        "started_s": 2.0,
        "ended_s": None,
    }
    said = AgentPrint(print_id=print_id, state=state, **{**facts, **changes})
    return AgentSnapshot(printer="a", link=link, filament=FilamentState.PARKED, print=said)


def assigned():
    return run(printing(), ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"))[0]


def test_reconciling_follows_an_agent_and_is_quiet_when_nothing_is_new():
    books = assigned()
    books, _ = run(books, *reconcile(books.prints["x"], word(), 3.0))
    assert books.prints["x"].state is PrintState.PRINTING
    assert books.prints["x"].started_s == 2.0
    assert books.printers["a"].bed is Bed.NOT_CLEAR
    assert list(reconcile(books.prints["x"], word(), 4.0)) == []
    last = word(state=PrintState.DONE, link=Link.READY, ended_s=90.0)
    books, _ = run(books, *reconcile(books.prints["x"], last, 100.0))
    assert (books.prints["x"].state, books.prints["x"].ended_s) == (PrintState.DONE, 90.0)


def test_an_agent_that_was_not_told_is_told_again_and_one_that_forgot_has_lost_the_print():
    books = assigned()
    empty = AgentSnapshot(printer="a", link=Link.READY)
    assert list(reconcile(books.prints["x"], empty, 3.0)) == []
    assert list(owed(books.prints["x"], empty)) == [ev.SendStart(print_id="x", printer="a")]
    books, _ = run(books, *reconcile(books.prints["x"], word(), 3.0))
    assert list(owed(books.prints["x"], empty)) == []
    books, _ = run(books, *reconcile(books.prints["x"], empty, 9.0))
    assert books.prints["x"].state is PrintState.FAILED
    assert books.prints["x"].fault == LOST_FAULT


def test_a_print_that_was_cancelled_before_its_agent_heard_of_it_never_starts():
    books, _ = run(assigned(), ev.JobCancelled(at_s=3.0, job=1))
    empty = AgentSnapshot(printer="a", link=Link.READY)
    assert list(owed(books.prints["x"], empty)) == []
    books, _ = run(books, *reconcile(books.prints["x"], empty, 4.0))
    assert books.prints["x"].state is PrintState.CANCELLED
    assert books.printers["a"].bed is Bed.CLEAR
