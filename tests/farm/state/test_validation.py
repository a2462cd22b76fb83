"""Validation of the books: each contradiction is described, and consistent books have none."""

import pytest

from books.make_books import apply_events, make_end_event, make_planned_books
from farm.model import Bed, JobState, Outage, PrintState, Reel, Verdict
from farm.state import events as ev
from farm.state.books import put, replace_fields
from farm.state.storage.store import Store
from farm.state.validation import validate_books
from farms.recorded_state import unpack_state

ASSIGNMENT = ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x")


def make_done_books():
    return apply_events(make_planned_books(), ASSIGNMENT, make_end_event("x"))[0]


def add_entries(books, *entries):
    return put(books, *entries)


BROKEN_BOOKS = {
    "a plate is missing": (
        lambda b: add_entries(b, replace_fields(b.jobs[1], plates=("1/01", "1/09"))),
        "job 1: its plate 1/09 does not exist",
    ),
    "a part is missing": (
        lambda b: add_entries(b, replace_fields(b.plates["1/01"], parts=("1/p07",))),
        "plate 1/01: its part 1/p07 does not exist",
    ),
    "a print is missing": (
        lambda b: add_entries(b, replace_fields(b.plates["1/02"], prints=("lost",))),
        "plate 1/02: its print lost does not exist",
    ),
    "a printer is missing": (
        lambda b: add_entries(b, replace_fields(b.prints["x"], printer="z")),
        "print x: its printer z does not exist",
    ),
    "a replaced plate is in the job": (
        lambda b: add_entries(b, replace_fields(b.plates["1/02"], replaced_by=("1/01",))),
        "job 1: its plate 1/02 is replaced by 1/01",
    ),
    "a job is further than its plates": (
        lambda b: add_entries(b, replace_fields(b.jobs[1], state=JobState.DONE, ended_s=9.0)),
        "job 1: it is done, but according to its plates it is printing",
    ),
    "an ended job has no end": (
        lambda b: add_entries(b, replace_fields(b.jobs[1], state=JobState.CANCELLED)),
        "job 1: it is cancelled and has no end time",
    ),
    "a queued job has plates": (
        lambda b: add_entries(b, replace_fields(b.jobs[1], state=JobState.QUEUED)),
        "job 1: it is queued and has plates",
    ),
    "a failed print is good": (
        lambda b: add_entries(
            b, replace_fields(b.prints["x"], state=PrintState.FAILED, verdict=Verdict.GOOD)
        ),
        "print x: it is failed and good",
    ),
    "a reel is less than empty": (
        lambda b: add_entries(
            b, replace_fields(b.printers["b"], reel=Reel(material="generic_pla", grams=-1.0, nozzle_mm=0.4))
        ),
        "printer b: its reel has -1 g",
    ),
    "a bed is clear with a part on it": (
        lambda b: add_entries(b, replace_fields(b.printers["a"], bed=Bed.CLEAR)),
        "printer a: its bed is clear, and print x on it is not judged",
    ),
    "a printer is booked twice": (
        lambda b: add_entries(
            b,
            *(
                replace_fields(
                    b.prints["x"], id=name, plate=plate, state=PrintState.HEATING, verdict=None, ended_s=None
                )
                for name, plate in (("y", "1/01"), ("z", "1/02"))
            ),
            replace_fields(b.plates["1/01"], prints=("x", "y")),
            replace_fields(b.plates["1/02"], prints=("z",)),
        ),
        "printer a: it has 2 open prints",
    ),
    "a plate is printed twice at once": (
        lambda b: add_entries(
            b,
            *(
                replace_fields(
                    b.prints["x"], id=name, printer=printer, state=PrintState.HEATING, ended_s=None
                )
                for name, printer in (("y", "b"), ("z", "c"))
            ),
            replace_fields(b.plates["1/01"], prints=("x", "y", "z")),
        ),
        "plate 1/01: it is printed on b and c at once",
    ),
    "two outages wait": (
        lambda b: add_entries(b, *(Outage(id=n, at_s=1.0, printers=("a", "b")) for n in (1, 2))),
        "the farm: outages 1 and 2 are open; at most one may be",
    ),
}


@pytest.mark.parametrize(("damage", "problem"), BROKEN_BOOKS.values(), ids=BROKEN_BOOKS)
def test_contradiction_is_named(damage, problem):
    assert problem in validate_books(damage(make_done_books()))


def test_consistent_books_have_no_contradiction():
    books = make_done_books()
    assert validate_books(books) == []
    books, _ = apply_events(
        books, ev.BedCleared(at_s=300.0, printer="a", by="ann"), ev.JobCancelled(at_s=301.0, job=1)
    )
    assert validate_books(books) == []


def test_books_of_the_first_release_are_consistent(tmp_path):
    with Store(unpack_state(tmp_path) / "farm.db") as store:
        assert validate_books(store.load()) == []
