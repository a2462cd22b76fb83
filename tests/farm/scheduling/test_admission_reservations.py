"""Reservations of printers for plates that start soon, for replans and for spares."""

import pytest

from books.scheduling_examples import make_plate, make_printer, make_rules, make_situation
from farm.scheduling.admission import (
    Availability,
    JobRequest,
    PendingPlan,
    PrinterChoice,
    choose_printers,
    choose_unreserved_printers,
    list_pending_printers,
    list_reservations,
)
from farm.scheduling.matching import Requirements

ANY_PRINTER = JobRequest(Requirements(None, None, None))
START_RULES = make_rules(max_heating=1)
FLEET = (make_printer("a", is_booked=True, is_heating=True), make_printer("b", grams=50.0), make_printer("c"))


@pytest.mark.parametrize(
    "plate_changes",
    [
        {"extra_printer_count": 0},
        {"not_before_s": 16 * 3600.0},
        {"grams": 900.0, "failed_on": frozenset("c")},
    ],
)
@pytest.mark.parametrize("start_rules", [make_rules(), START_RULES])
def test_no_printer_is_reserved_for_a_plate_that_may_not_start(plate_changes, start_rules):
    assert (
        list_reservations(
            make_situation([make_plate("1/02", "b", **plate_changes)], FLEET[:2], start_rules), {}
        )
        == {}
    )


def test_printer_is_reserved_for_a_plate_waiting_for_the_heating_limit():
    assert list_reservations(make_situation([make_plate("6/03", "b")], FLEET, START_RULES), {}) == {
        "b": "6/03"
    }


def test_printers_are_reserved_for_replans_and_as_spares():
    situation = make_situation([], FLEET, spares=1)
    reservations = list_reservations(situation, {"b": "6/03"})
    assert reservations == {"b": "6/03", "c": "a failed part (--spares)"}


def test_reserved_printers_are_avoided_while_another_is_free():
    fleet = (make_printer("a"), make_printer("b"), make_printer("c", is_booked=True))
    assert choose_printers(ANY_PRINTER, Availability(fleet, {"b": "6/03"})) == PrinterChoice(("a",))
    pending_plan = PendingPlan(job=8, priority=1, printers=frozenset("b"))
    assert choose_unreserved_printers(ANY_PRINTER, Availability(fleet), 5, [pending_plan]) == PrinterChoice(
        ("a",)
    )
    shared_plan = PendingPlan(job=8, priority=1, printers=frozenset("ab"))
    assert choose_unreserved_printers(ANY_PRINTER, Availability(fleet), 1, [shared_plan]) == PrinterChoice(
        ("a", "b", "c")
    )
    assert choose_unreserved_printers(ANY_PRINTER, Availability(fleet), 2, [shared_plan]) == PrinterChoice(
        ("a", "b")
    )
    assert list_pending_printers([shared_plan]) == {"a": "job 8", "b": "job 8"}


def test_printers_of_a_replan_are_avoided_while_others_exist():
    fleet = (make_printer("a"), make_printer("c", is_booked=True))
    assert choose_printers(ANY_PRINTER, Availability(fleet, replan_printers=frozenset("a"))) == PrinterChoice(
        ("c",)
    )
    assert choose_printers(
        ANY_PRINTER, Availability(fleet[:1], replan_printers=frozenset("a"))
    ) == PrinterChoice(("a",))
