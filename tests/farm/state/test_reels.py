"""Filament on reels: the amount that prints use."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events, make_end_event, make_planned_books
from books.scheduling_examples import make_printer
from farm.config import Fleet
from farm.model import HoldCode, Printer, PrintState, Reel
from farm.state import events as ev
from farm.state.reels import apply_reels, compute_used_grams
from farm.views.tasks import list_request_tasks

WHITE_REEL = Reel(material="generic_pla", colour="white", grams=100.0, nozzle_mm=0.4)


def make_books_with_reel(**changes):
    loaded_event = ev.ReelLoaded(at_s=1.5, printer="a", reel=WHITE_REEL.model_copy(update=changes), by="ann")
    books, _ = apply_events(
        make_planned_books(),
        loaded_event,
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
    )
    return books


@pytest.mark.parametrize(
    ("changes", "remaining_grams"),
    [
        ({}, 97.0),
        ({"state": PrintState.FAILED, "printed_share": 0.5}, 98.5),
        ({"state": PrintState.FAILED, "printed_share": None}, 97.0),
        ({"state": PrintState.FAILED, "printed_share": 0.0, "extruded": False}, 100.0),
        ({"state": PrintState.CANCELLED, "started_s": None, "extruded": False}, 100.0),
    ],
)
def test_print_subtracts_its_grams_from_the_reel(changes, remaining_grams):
    books, _ = apply_events(make_books_with_reel(), make_end_event("x", **changes))
    assert books.get_printer("a").reel.grams == pytest.approx(remaining_grams)
    assert books.prints["x"].grams == pytest.approx(100.0 - remaining_grams), (
        "the history must agree with the reel"
    )


def test_grams_of_an_unweighed_reel_stay_unknown():
    books, _ = apply_events(make_books_with_reel(grams=None), make_end_event("x"))
    assert books.get_printer("a").reel.grams is None


@given(st.sampled_from(PrintState), st.booleans(), st.none() | st.floats(0, 5))
def test_print_uses_at_most_the_grams_of_its_plate(state, extruded, printed_share):
    plate = make_planned_books().plates["1/01"]
    assert 0.0 <= compute_used_grams(plate, state, extruded, printed_share) <= plate.grams


def test_fleet_shows_the_loaded_reels():
    row = {"name": "a", "model": "ultimaker2_plus", "port": "sim://ultimaker2_plus", "colour": "red"}
    fleet = Fleet.model_validate({"printers": [row, {**row, "name": "b"}]})
    abs_reel = Reel(material="generic_abs", nozzle_mm=0.8)
    fleet_with_reels = apply_reels(fleet, {"a": Printer(name="a", reel=abs_reel), "b": Printer(name="b")})
    shown_fields = [
        (section.material, section.colour, section.nozzle_mm) for section in fleet_with_reels.printers
    ]
    assert shown_fields == [("generic_abs", None, 0.8), ("generic_pla", "red", 0.4)]


def test_restored_reels_must_be_weighed_before_printing():
    loaded_event = ev.ReelLoaded(at_s=1.0, printer="a", reel=WHITE_REEL, by="ann")
    books, _ = apply_events(make_planned_books(), loaded_event, ev.BooksRestored(at_s=9.0, copied_s=2.0))
    assert [
        printer_record.reel and printer_record.reel.uncertain for printer_record in books.printers.values()
    ] == [True, None, None]
    (item,) = [item for item in list_request_tasks(books, {}) if item.code == "reel"]
    assert item.printers == ["a"]
    books, _ = apply_events(books, loaded_event)
    assert not [item for item in list_request_tasks(books, {}) if item.code == "reel"]
    assert make_printer("a", is_reel_uncertain=True).find_obstacle().code is HoldCode.REEL_UNCERTAIN
