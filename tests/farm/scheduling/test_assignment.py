"""Assignment of plates: one for each printer, clear beds only, independent of the order of the input."""

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.scheduling_examples import (
    LOW_BOXES,
    TALL_BOXES,
    make_box,
    make_plate,
    make_printer,
    make_situation,
)
from farm.model import Bed, FilamentState, HoldCode, Link
from farm.scheduling import assignment, plate_matching
from farm.scheduling.matching import Requirements

NOW_S = 1_000_000.0


def assign_with_holds(waiting_plates, fleet, start_rules=None, **changes):
    situation = make_situation(waiting_plates, fleet, start_rules, NOW_S, **changes)
    assignments = assignment.assign_plates(situation)
    return assignments, assignment.find_holds(situation, assignments)


def test_unmatched_printers_and_plates_are_skipped(monkeypatch):
    """Skip plates of other materials instead of searching a large queue for each free printer."""
    placed_ids = []
    original_place = plate_matching._Matching.place
    monkeypatch.setattr(
        plate_matching._Matching,
        "place",
        lambda self, item: (placed_ids.append(item.id), original_place(self, item))[1],
    )
    fleet = [make_printer("a"), *(make_printer(name, material="generic_abs") for name in "bcd")]
    tpu_requirements = Requirements(material="generic_tpu", colour=None, nozzle_mm=0.4)
    waiting_plates = [make_plate(f"1/{number:02d}", "a") for number in range(50)]
    other_plates = [
        make_plate(f"2/{number:02d}", "a", requirements=tpu_requirements, job=2) for number in range(50)
    ]
    assignments, _ = assign_with_holds([*waiting_plates, *other_plates], fleet)
    assert [item.printer for item in assignments] == ["a"]
    assert len(placed_ids) == 1
    assert assign_with_holds(waiting_plates, fleet[1:])[0] == [] and len(placed_ids) == 1


def test_plate_waits_for_the_start_time_of_its_job():
    fleet = [make_printer("a", is_booked=True), make_printer("b", bed=Bed.NOT_CLEAR)]
    _, holds = assign_with_holds(
        [make_plate("1/01", "a", not_before_s=NOW_S + 60.0), make_plate("1/02", "a")], fleet
    )
    assert (holds["1/01"].code, holds["1/02"].code) == (HoldCode.START_TIME, HoldCode.PRINTER_BUSY)
    assert "farm cleared b" in holds["1/02"].text and "cleared" not in holds["1/01"].text


printers = st.lists(
    st.builds(
        make_printer,
        st.sampled_from("abcdef"),
        bed=st.sampled_from(Bed),
        filament=st.sampled_from(FilamentState),
        link=st.sampled_from(Link),
        is_booked=st.booleans(),
        attention_reason=st.sampled_from([None, "its nozzle is cold"]),
        boxes=st.sampled_from([LOW_BOXES, TALL_BOXES]),
    ),
    unique_by=lambda p: p.name,
)
plates = st.lists(
    st.builds(
        make_plate,
        st.uuids().map(str),
        st.sampled_from("abcdefg"),
        requirements=st.builds(
            Requirements,
            st.sampled_from(["generic_pla", "generic_abs", None]),
            st.none(),
            st.sampled_from([0.4, 0.8]),
            st.sampled_from([None, make_box(100.0), make_box(250.0), make_box(10.0, 110.0)]),
        ),
        expected_s=st.floats(60, 1e5),
        failed_on=st.frozensets(st.sampled_from("abc")),
    ),
    unique_by=lambda p: p.id,
)


@given(plates, printers)
def test_assignment_keeps_its_invariants(waiting_plates, fleet):
    assignments, holds = assign_with_holds(waiting_plates, fleet)
    printers_by_name = {p.name: p for p in fleet}
    plates_by_id = {p.id: p for p in waiting_plates}
    used_printers = [a.printer for a in assignments]
    assert len(used_printers) == len(set(used_printers))
    for pair in assignments:
        printer = printers_by_name[pair.printer]
        assert (
            printer.bed is Bed.CLEAR
            and printer.link is Link.READY
            and not printer.is_booked
            and printer.attention_reason is None
        )
        assert printer.filament is not FilamentState.UNKNOWN
        assert plates_by_id[pair.plate].requirements.matches(printer.capabilities)
    assert {a.plate for a in assignments} | set(holds) == set(plates_by_id)
    assert not {a.plate for a in assignments} & set(holds)


@given(plates, printers)
def test_no_matching_printer_stays_idle(waiting_plates, fleet):
    assignments, holds = assign_with_holds(waiting_plates, fleet)
    used_printers = {a.printer for a in assignments}
    for plate in (p for p in waiting_plates if p.id in holds):
        idle_printers = [p for p in fleet if p.name not in used_printers and p.find_obstacle() is None]
        assert not [p for p in idle_printers if plate.requirements.matches(p.capabilities)]


@given(plates, printers, st.randoms())
def test_assignment_is_independent_of_input_order(waiting_plates, fleet, random):
    answer = assign_with_holds(waiting_plates, fleet)
    for items in (fleet, waiting_plates):
        random.shuffle(items)
    assert assign_with_holds(waiting_plates, fleet) == answer


def test_plate_keeps_its_planned_printer_and_avoids_a_printer_on_which_it_failed():
    assignments, _ = assign_with_holds([make_plate("1/01", "b")], [make_printer("a"), make_printer("b")])
    assert assignments[0].printer == "b"
    assignments, _ = assign_with_holds(
        [make_plate("1/01", "b", failed_on=frozenset("b"))], [make_printer("a"), make_printer("b")]
    )
    assert assignments[0].printer == "a"
    assignments, _ = assign_with_holds(
        [make_plate("1/01", "b", failed_on=frozenset("b"))], [make_printer("b")]
    )
    assert assignments[0].printer == "b"


def test_hold_names_the_reason_for_waiting():
    _, holds = assign_with_holds([make_plate("1/01", "a")], [make_printer("a", bed=Bed.NOT_CLEAR)])
    assert holds["1/01"].code is HoldCode.BED_NOT_CLEAR
    assert "farm cleared a" in holds["1/01"].text
    tall_requirements = Requirements("generic_pla", None, 0.4, make_box(231.0))
    _, holds = assign_with_holds(
        [make_plate("1/01", "a", requirements=tall_requirements)], [make_printer("a")]
    )
    assert holds["1/01"].code is HoldCode.NO_SUCH_PRINTER
    assert "231 mm of height" in holds["1/01"].text


def test_plate_is_moved_only_to_a_printer_with_a_sufficient_volume():
    small_printer = make_printer("b", boxes=((-50.0, -50.0, 50.0, 50.0, 205.0),))
    small_bed_requirements = Requirements("generic_pla", None, 0.4, (20.0, -20.0, 60.0, 20.0, 30.0))
    assignments, holds = assign_with_holds(
        [make_plate("1/01", "a", requirements=small_bed_requirements)],
        [make_printer("a", is_booked=True), small_printer],
    )
    assert assignments == []
    assert holds["1/01"].code is HoldCode.PRINTER_BUSY
    assignments, _ = assign_with_holds(
        [make_plate("1/01", "a", requirements=small_bed_requirements)],
        [make_printer("a", is_booked=True), make_printer("b")],
    )
    assert assignments[0].printer == "b"


def test_job_uses_at_most_the_requested_printers():
    waiting_plates = [make_plate(f"1/0{i}", "ab"[i % 2], extra_printer_count=1) for i in range(4)]
    assignments, holds = assign_with_holds(waiting_plates, [make_printer(name) for name in "abcd"])
    assert len(assignments) == 1
    assert {hold.code for hold in holds.values()} == {HoldCode.JOB_PRINTER_LIMIT}
    assert assign_with_holds([make_plate("1/01", "a", extra_printer_count=0)], [make_printer("a")])[0] == []


@given(plates, printers, st.integers(0, 5))
def test_limit_on_printers_of_a_job_holds_for_any_fleet(waiting_plates, fleet, extra_printer_count):
    assignments, _ = assign_with_holds(
        [replace(plate, extra_printer_count=extra_printer_count) for plate in waiting_plates], fleet
    )
    assert len(assignments) <= extra_printer_count


def test_plate_of_an_earlier_job_comes_before_a_longer_one_of_a_later_job():
    waiting_plates = [
        make_plate("1/01", "x", job=1, expected_s=60.0),
        make_plate("2/01", "x", job=2, expected_s=6000.0),
    ]
    assignments, _ = assign_with_holds(waiting_plates, [make_printer("a")])
    assert assignments[0].plate == "1/01"


def test_gcode_for_another_kind_of_printer_waits():
    """Keep G-code for an Ultimaker 2 and for a 2+ apart, because these printers feed and heat differently."""
    plain_printer = make_printer("plain")
    plain_printer = replace(
        plain_printer, capabilities=replace(plain_printer.capabilities, family="ultimaker2")
    )
    plus_printer = make_printer("plus")
    plus_printer = replace(
        plus_printer, capabilities=replace(plus_printer.capabilities, family="ultimaker2_plus")
    )
    sliced_plate = make_plate(
        "p1", "plus", requirements=Requirements("generic_pla", None, 0.4, make_box(100.0), "ultimaker2_plus")
    )
    assignments, holds = assign_with_holds([sliced_plate], [plain_printer])
    assert not assignments
    assert "a printer of the family ultimaker2_plus" in holds["p1"].text
    assignments, _ = assign_with_holds([sliced_plate], [plain_printer, plus_printer])
    assert [a.printer for a in assignments] == ["plus"]


def make_named_printer(name, **changes):
    plain_printer = make_printer(name, **changes)
    return replace(plain_printer, capabilities=replace(plain_printer.capabilities, requested_name=name))


def test_plate_for_named_printers_is_assigned_to_one_or_held_with_their_names():
    requirements_for_b = Requirements("generic_pla", None, 0.4, make_box(100.0), allowed_printers=("b",))
    fleet = [make_printer("a"), make_named_printer("b"), make_printer("c")]
    first_plate, second_plate = (
        make_plate("1/01", "a", requirements=requirements_for_b),
        make_plate("1/02", "a", requirements=requirements_for_b),
    )
    assignments, holds = assign_with_holds([first_plate, second_plate], fleet)
    assert [(assignment.plate, assignment.printer) for assignment in assignments] == [("1/01", "b")]
    assert holds["1/02"].text == "needs b: every matching printer was assigned another plate"
    assignments, holds = assign_with_holds(
        [first_plate], [make_printer("a"), make_named_printer("b", bed=Bed.NOT_CLEAR)]
    )
    assert assignments == []
    assert holds["1/01"].text.startswith("needs b: the bed of b is not clear")
    assert assign_with_holds([first_plate], [make_printer("a")])[1]["1/01"].text.startswith(
        "no printer of the fleet matches: gener"
    )


def test_hold_of_a_plate_names_the_obstacle_of_its_own_printer():
    fleet = [make_printer("a", attention_reason="it smokes"), make_printer("b", bed=Bed.NOT_CLEAR)]
    for planned_printer, code in (("a", HoldCode.NEEDS_INSPECTION), ("b", HoldCode.BED_NOT_CLEAR)):
        _, holds = assign_with_holds([make_plate("p", planned_printer)], fleet)
        assert holds["p"].code is code


ready_printers = st.lists(
    st.builds(
        make_printer,
        st.sampled_from("abcdefgh"),
        boxes=st.sampled_from([LOW_BOXES, TALL_BOXES]),
        grams=st.sampled_from([None, 3.0, 500.0]),
        may_print_unattended=st.booleans(),
    ),
    unique_by=lambda p: p.name,
)


@given(plates, ready_printers)
def test_shortcut_to_an_unassigned_printer_does_not_change_assignments(waiting_plates, fleet):
    situation = make_situation(waiting_plates, fleet, None, NOW_S)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plate_matching._Matching, "_find_unassigned_printer", lambda self, plate: None)
        expected_assignments = assignment.assign_plates(situation)
    assert assignment.assign_plates(situation) == expected_assignments


@given(plates, ready_printers, printers)
def test_only_starts_that_are_still_possible_are_selected(waiting_plates, fleet, later_fleet):
    situation, later_situation = (
        make_situation(waiting_plates, p, None, NOW_S) for p in (fleet, later_fleet)
    )
    assignments = assignment.assign_plates(situation)
    assert assignment.select_possible_assignments(assignments, situation) == assignments
    possible_assignments = assignment.select_possible_assignments(assignments, later_situation)
    free_names = {p.name for p in later_situation.free_printers}
    assert all(item in assignments and item.printer in free_names for item in possible_assignments)
    extra_printer_counts = {
        plate.job: plate.extra_printer_count
        for plate in waiting_plates
        if plate.extra_printer_count is not None
    }
    plate_counts = Counter(
        plate.job for plate in waiting_plates if plate.id in {item.plate for item in possible_assignments}
    )
    assert all(plate_counts[job] <= limit for job, limit in extra_printer_counts.items())
