"""Printers that no job gets: what a plate takes in a moment, and nothing for plates that may not start."""

import pytest

from farm.scheduling.admission import (
    Availability,
    Begin,
    JobRequest,
    Promise,
    choose_printers,
    choose_printers_beside,
    kept_printers,
)
from farm.scheduling.matching import Requirements
from scheduling_examples import plate, printer, rules, situation

ANY = JobRequest(Requirements(None, None, None))
HOUSE = rules(max_heating=1)
FLEET = (printer("a", booked=True, heating=True), printer("b", grams=50.0), printer("c"))


@pytest.mark.parametrize(
    "reason", [{"places": 0}, {"not_before_s": 16 * 3600.0}, {"grams": 900.0, "failed_on": frozenset("c")}]
)
@pytest.mark.parametrize("house", [rules(), HOUSE])
def test_nothing_is_kept_for_a_plate_that_may_not_start(reason, house):
    assert kept_printers(situation([plate("1/02", "b", **reason)], FLEET[:2], house), {}) == {}


def test_a_printer_is_kept_for_a_plate_that_starts_when_another_has_heated_up():
    assert kept_printers(situation([plate("6/03", "b")], FLEET, HOUSE), {}) == {"b": "6/03"}


def test_printers_are_kept_for_a_plate_that_is_being_replanned_and_as_spares():
    moment = situation([], FLEET, spares=1)
    kept = kept_printers(moment, {"b": "6/03"})
    assert kept == {"b": "6/03", "c": "a failed part (--spares)"}


def test_hold_names_the_purpose_of_a_kept_printer():
    hold = choose_printers(ANY, Availability(FLEET, {"b": "6/03", "c": "7/01"}))
    assert hold.text == "b is kept for 6/03; c is kept for 7/01"
    promise = Promise(job=8, priority=1, printers=frozenset("bc"))
    assert choose_printers_beside(ANY, Availability(FLEET), 0, [promise]).text == "b c are kept for job 8"
    assert choose_printers_beside(ANY, Availability(FLEET), 1, [promise]) == Begin(("b", "c"))
