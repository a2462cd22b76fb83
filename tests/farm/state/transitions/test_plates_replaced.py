"""Replaced plates: the new ones keep the prints and attempts of the old one."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.example_night import make_view_context
from books.make_books import apply_events, make_end_event, make_planned_books
from farm.model import Bed, JobState, PrintState, Verdict
from farm.planning.plan_storage import list_job_files
from farm.state import events as ev
from farm.state.lifecycles import InvalidTransition
from farm.state.plate_state import MAX_ATTEMPTS, PlateState
from farm.views import describe_job
from farm.views.accounting import compute_job_totals


def make_replaced_event(books, plate, letters=("a", "b")):
    """Make the event of a part that is cut into pieces with these letters, or resliced if there are none."""
    old_plate = books.plates[plate]
    (part,) = (books.parts[name] for name in old_plate.parts)
    if not letters:
        new_plate = old_plate.model_copy(update={"id": f"{plate}-2", "prints": (), "printer": "c"})
        return ev.PlateReplaced(
            at_s=9.0,
            plate=plate,
            parts=(part.model_copy(update={"plate": new_plate.id}),),
            plates=(new_plate,),
        )
    parts, plates = [], []
    for letter in letters:
        changes = {"id": f"{part.id}{letter}", "plate": f"{plate}{letter}", "cut_from": part.id}
        parts.append(part.model_copy(update=changes))
        changes = {"id": f"{plate}{letter}", "parts": (f"{part.id}{letter}",), "prints": ()}
        plates.append(old_plate.model_copy(update=changes))
    new_fields = {"parts": tuple(parts), "plates": tuple(plates)}
    return ev.PlateReplaced(
        at_s=9.0, plate=plate, **new_fields, picture="n.png", decomposition="c.json", instructions="i.html"
    )


def make_assigned_event(plate, printer, print_id):
    return ev.PlateAssigned(at_s=2.0, plate=plate, printer=printer, print_id=print_id)


def make_cleared_event(printer, verdict=Verdict.GOOD):
    return ev.BedCleared(at_s=300.0, printer=printer, by="ann", filament=None, verdict=verdict, why=None)


def make_failed_books():
    return apply_events(
        make_planned_books(3),
        make_assigned_event("1/02", "b", "x"),
        make_end_event("x", PrintState.FAILED, fault="mintemp"),
    )[0]


def test_pieces_replace_their_part_and_continue_its_attempts():
    books = make_failed_books()
    books, instructions = apply_events(books, make_replaced_event(books, "1/02"))
    job = books.jobs[1]
    assert job.plates == ("1/01", "1/02a", "1/02b", "1/03")
    assert job.parts == ("1/p01", "1/p02a", "1/p02b", "1/p03")
    assert (job.picture, instructions) == ("n.png", [ev.LinkFiles(job=1)])
    assert list_job_files(job, (), ())["decomposition-p02.json"] == "c.json"
    assert list_job_files(job, (), ())["instructions-p02.html"] == "i.html"
    assert books.plates["1/02"].replaced_by == ("1/02a", "1/02b")
    assert books.parts["1/p02a"].cut_from == "1/p02"
    assert {plate.id for plate in books.list_waiting_plates()} == set(job.plates)
    assert compute_job_totals(books, job).wasted_s == 198.0  # the failed print is counted once
    for attempt in range(1, MAX_ATTEMPTS):
        name = f"y{attempt}"
        events = (
            make_cleared_event("b"),
            make_assigned_event("1/02a", "b", name),
            make_end_event(name, PrintState.FAILED, fault="mintemp"),
        )
        books, _ = apply_events(books, *events)
    assert books.find_plate_state(books.plates["1/02a"]) is PlateState.OUT_OF_ATTEMPTS
    assert books.find_plate_state(books.plates["1/02b"]) is PlateState.WAITING


def test_resliced_part_keeps_its_name_and_prints():
    books = make_failed_books()
    books, _ = apply_events(books, make_replaced_event(books, "1/02", ()))
    job = books.jobs[1]
    assert job.plates == ("1/01", "1/02-2", "1/03")
    assert (job.parts, books.parts["1/p02"].plate) == (("1/p01", "1/p02", "1/p03"), "1/02-2")
    assert books.plates["1/02-2"].prints == ("x",)
    with pytest.raises(InvalidTransition, match="plate 1/02 is replaced"):
        apply_events(books, make_assigned_event("1/02", "c", "z"))


@pytest.mark.parametrize("new_state", ["printing", "printed", "cancelled", "held", "replaced"])
def test_plate_that_no_longer_waits_is_not_replaced(new_state):
    books = make_failed_books()
    event = make_replaced_event(books, "1/02")
    other_events = {
        "printing": [make_assigned_event("1/02", "a", "z")],
        "printed": [make_assigned_event("1/02", "a", "z"), make_end_event("z")],
        "cancelled": [ev.PlateCancelled(at_s=8.0, plate="1/02", by="ann")],
        "held": [ev.BooksRestored(at_s=8.0, copied_s=7.0)],
        "replaced": [make_replaced_event(books, "1/02", ())],
    }[new_state]
    books, _ = apply_events(books, *other_events)
    with pytest.raises(InvalidTransition):
        apply_events(books, event)


steps = st.lists(
    st.tuples(
        st.sampled_from(["slice", "cut", "begin", "done", "fail", "clear", "bad"]),
        st.integers(0, 5),
        st.sampled_from("abc"),
    ),
    max_size=40,
)


@given(steps)
def test_replacing_plates_neither_loses_nor_repeats_a_part(choices):
    """Check that, after any reslices and recuts, the current plates have each piece of the parts once."""
    books = make_planned_books(3)
    for number, (kind, choice, printer) in enumerate(choices):
        waiting_ids = sorted(plate.id for plate in books.list_waiting_plates())
        attempt = books.find_open_print(printer)
        if kind in ("slice", "cut") and waiting_ids:
            letters = "ab" if kind == "cut" else ()
            books, _ = apply_events(
                books, make_replaced_event(books, waiting_ids[choice % len(waiting_ids)], letters)
            )
        elif kind == "begin" and waiting_ids and attempt is None and books.printers[printer].bed is Bed.CLEAR:
            books, _ = apply_events(
                books, make_assigned_event(waiting_ids[choice % len(waiting_ids)], printer, f"p{number}")
            )
        elif kind in ("done", "fail") and attempt is not None:
            state = PrintState.DONE if kind == "done" else PrintState.FAILED
            books, _ = apply_events(books, make_end_event(attempt.id, state, 200.0 + number, fault="mintemp"))
        elif kind in ("clear", "bad") and attempt is None:
            is_bad = kind == "bad" and books.find_print_to_judge(printer) is not None
            books, _ = apply_events(
                books, make_cleared_event(printer, Verdict.BAD if is_bad else Verdict.GOOD)
            )
    job = books.jobs[1]
    assert len(set(job.plates)) == len(job.plates)
    current_parts = [name for plate in books.list_plates(job) for name in plate.parts]
    assert sorted(current_parts) == sorted(job.parts)
    assert all(books.parts[name].plate in job.plates for name in job.parts)
    for part_id in ("1/p01", "1/p02", "1/p03"):  # either the part or all of its pieces are there
        assert sum(compute_share(books, name, part_id) for name in job.parts) == pytest.approx(1.0)
    assert all(attempt.plate in job.plates for attempt in books.list_open_prints())
    for plate in books.list_plates(job):  # at most one print of a plate counts
        counted_prints = [
            p for p in books.list_prints(plate) if p.state is PrintState.DONE and p.verdict is not Verdict.BAD
        ]
        assert len(counted_prints) <= 1
    if job.state in (JobState.PRINTED, JobState.DONE):
        assert {books.find_plate_state(p) for p in books.list_plates(job)} <= {
            PlateState.PRINTED,
            PlateState.GOOD,
        }


def compute_share(books, part, part_id):
    """Compute the share of the planned part `part_id` that a part contains; every cut makes halves."""
    if part == part_id:
        return 1.0
    parent = books.parts[part].cut_from
    return 0.0 if parent is None else compute_share(books, parent, part_id) / 2


def test_failures_of_a_cut_part_are_shown_once():
    books = make_failed_books()
    books, _ = apply_events(books, make_replaced_event(books, "1/02"), make_assigned_event("1/02a", "a", "y"))
    view = describe_job(make_view_context(books), books.jobs[1])
    shown_prints = {part.id: [item.part for item in part.prints] for part in view.parts}
    assert shown_prints == {
        "1/p01": [],
        "1/p02a": ["1/p02", "1/p02a"],
        "1/p02b": ["1/p02"],
        "1/p03": [],
    }
    assert [len(part.own_prints) for part in view.parts] == [0, 1, 0, 0]
    assert [(item.part, item.printer) for item in view.prints] == [("1/p02", "b"), ("1/p02a", "a")]
    assert {plate.id: plate.printer for plate in view.plates}["1/02b"] == "b"  # its planned printer
