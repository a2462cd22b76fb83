"""Start rules: hours, reels, the heating limit, priorities and spares."""

import math
import re
from dataclasses import replace
from datetime import datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from books.scheduling_examples import (
    LOW_BOXES,
    TALL_BOXES,
    UTC,
    make_box,
    make_plate,
    make_printer,
    make_rules,
    make_situation,
)
from farm.model import Bed, HoldCode
from farm.scheduling import assignment
from farm.scheduling.holds import join_names
from farm.scheduling.matching import Requirements
from farm.scheduling.start_rules import CLEARING_RESERVE_S, compute_needed_grams, find_filament_shortage
from farm.text import format_moment

HOUR_S = 3600.0
ATTENDED_HOURS = [("mon-fri 08:00-18:00",), ("08:00-10:00", "16:00-18:00"), ()]


def parse_time_s(text):
    return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()


FRIDAY_S = parse_time_s("2026-11-20 17:00")


def assign_with_holds(waiting_plates, fleet, start_rules, now_s, spares=0):
    situation = make_situation(waiting_plates, fleet, start_rules, now_s, spares=spares)
    assignments = assignment.assign_plates(situation)
    return assignments, assignment.find_holds(situation, assignments)


fleets = st.lists(
    st.builds(
        make_printer,
        st.sampled_from("abcd"),
        boxes=st.sampled_from([LOW_BOXES, TALL_BOXES]),
        bed=st.sampled_from([Bed.CLEAR, Bed.CLEAR, Bed.NOT_CLEAR]),
        is_heating=st.booleans(),
        grams=st.none() | st.floats(0, 200),
        may_print_unattended=st.booleans(),
    ),
    unique_by=lambda p: p.name,
)
plates = st.lists(
    st.builds(
        make_plate,
        st.uuids().map(str),
        st.sampled_from("abcd"),
        requirements=st.builds(
            Requirements, st.none(), st.none(), st.none(), st.sampled_from([make_box(100.0), make_box(250.0)])
        ),
        expected_s=st.floats(600, 20 * HOUR_S),
        first_layer_s=st.floats(300, 900),
        grams=st.floats(1, 150),
        job=st.integers(1, 3),
        priority=st.integers(0, 2),
        failed_on=st.frozensets(st.sampled_from("abcd")),
        not_before_s=st.none() | st.floats(FRIDAY_S - HOUR_S, FRIDAY_S + HOUR_S),
    ),
    max_size=7,
    unique_by=lambda p: p.id,
)
rule_sets = st.builds(
    make_rules,
    attended=st.sampled_from(ATTENDED_HOURS),
    quiet=st.sampled_from([(), ("22:00-06:00",), ("fri 18:00-24:00",)]),
    first_layers_attended=st.booleans(),
    max_heating=st.none() | st.integers(1, 3),
)
times_s = st.floats(FRIDAY_S, FRIDAY_S + 7 * 24 * HOUR_S)


@given(plates, fleets, rule_sets, times_s, st.integers(0, 2))
def test_forbidden_starts_are_refused(waiting_plates, fleet, start_rules, now_s, spares):
    assignments, holds = assign_with_holds(waiting_plates, fleet, start_rules, now_s, spares)
    printers_by_name, plates_by_id = {p.name: p for p in fleet}, {p.id: p for p in waiting_plates}
    assert len({a.printer for a in assignments}) == len(assignments)
    assert {a.plate for a in assignments} | set(holds) == set(plates_by_id)
    if start_rules.max_heating is not None:
        heating_count = sum(p.is_heating for p in fleet)
        assert not assignments or heating_count + len(assignments) <= start_rules.max_heating
    for plate, printer in ((plates_by_id[a.plate], printers_by_name[a.printer]) for a in assignments):
        assert printer.bed is Bed.CLEAR
        assert printer.grams is None or plate.grams <= printer.grams
        assert plate.not_before_s is None or plate.not_before_s <= now_s
        quiet_span = start_rules.quiet_hours.find_span(now_s) or start_rules.quiet_hours.find_next_span(now_s)
        assert quiet_span is None or now_s + plate.expected_s <= quiet_span[0]
        attended_span = start_rules.attended_hours.find_span(now_s)
        if not printer.may_print_unattended:
            assert (
                attended_span is not None
                and now_s + plate.expected_s + CLEARING_RESERVE_S <= attended_span[1]
            )
        elif start_rules.first_layers_attended:
            assert attended_span is not None and now_s + plate.first_layer_s <= attended_span[1]


@given(plates, fleets, rule_sets, times_s)
def test_every_time_in_the_text_of_a_hold_is_also_a_field(waiting_plates, fleet, start_rules, now_s):
    _, holds = assign_with_holds(waiting_plates, fleet, start_rules, now_s)
    now = datetime.fromtimestamp(now_s, UTC)
    for hold in holds.values():
        assert sorted(re.findall(r"\w{3} (?:\d\d \w{3} )?\d\d:\d\d", hold.text)) == sorted(
            time.text for time in hold.times
        )
        for time in hold.times:
            assert format_moment(datetime.fromisoformat(time.at), now) == time.text


@given(plates, fleets, rule_sets, times_s)
@settings(deadline=None)
def test_start_is_allowed_until_the_latest_start(waiting_plates, fleet, start_rules, now_s):
    for plate, printer in ((w, p) for w in waiting_plates for p in fleet):
        at_s = start_rules.find_start(plate, printer, now_s).at_s
        if at_s is None:
            continue
        latest_s = start_rules.find_latest_start_s(plate, printer, at_s)
        for time_s in (at_s, (at_s + min(latest_s, at_s + HOUR_S)) / 2, min(latest_s, at_s + HOUR_S) - 1e-3):
            assert time_s < at_s or start_rules.find_start(plate, printer, time_s).at_s == time_s
        if latest_s < math.inf:
            assert start_rules.find_start(plate, printer, latest_s + 1.0).at_s != latest_s + 1.0
        ends_by_s = start_rules.find_latest_end_s(printer, at_s)
        assert (ends_by_s is None) == (
            printer.may_print_unattended or math.isinf(start_rules.attended_hours.find_span(at_s)[1])
        )
        assert ends_by_s is None or at_s + plate.expected_s < ends_by_s


def test_attended_printer_ends_before_the_hours_and_names_the_next_start():
    start_rules, attended_printer = (
        make_rules(attended=ATTENDED_HOURS[0]),
        make_printer("a", may_print_unattended=False, attended_reason="no verified timer"),
    )
    assert start_rules.find_latest_end_s(attended_printer, FRIDAY_S) == parse_time_s("2026-11-20 17:45")
    assert start_rules.find_unattended_reason(attended_printer, parse_time_s("2026-11-20 17:44")) is None
    message = "a prints only in attended hours (no verified timer): from Mon 08:00 (UTC)"
    assert start_rules.find_unattended_reason(attended_printer, parse_time_s("2026-11-20 17:45")) == message
    assert start_rules.find_unattended_reason(attended_printer, parse_time_s("2026-11-21 03:00")) == message
    assert start_rules.find_latest_end_s(attended_printer, parse_time_s("2026-11-21 03:00")) == parse_time_s(
        "2026-11-21 03:00"
    )
    assert (
        make_rules().find_unattended_reason(attended_printer, FRIDAY_S)
        == "a prints only in attended hours (no verified timer)"
    )
    assert start_rules.find_unattended_reason(make_printer("a"), parse_time_s("2026-11-21 03:00")) is None
    assert make_rules(attended=["00:00-24:00"]).find_latest_end_s(attended_printer, FRIDAY_S) is None


@given(plates, fleets, rule_sets, times_s)
@settings(deadline=None)
def test_window_allows_exactly_the_possible_starts(waiting_plates, fleet, start_rules, now_s):
    for plate, printer in ((w, p) for w in waiting_plates for p in fleet):
        window = start_rules.find_start_window(printer.may_print_unattended, now_s)
        assert window.allows(plate) == (start_rules.find_start(plate, printer, now_s).at_s == now_s)


@given(plates, fleets, rule_sets, times_s)
@settings(deadline=None)
def test_every_possible_start_is_made_in_any_order(waiting_plates, fleet, start_rules, now_s):
    """Compare with brute force: as many plates as possible start, including the first of the queue."""
    waiting_plates = [replace(p, failed_on=frozenset()) for p in waiting_plates[:5]]
    start_rules = replace(start_rules, max_heating=None)
    assignments, _ = assign_with_holds(waiting_plates, fleet, start_rules, now_s)

    def can_start(plate, printer):
        return bool(assign_with_holds([plate], [printer], start_rules, now_s)[0])

    def find_best_starts(remaining_plates, free_printers):
        if not remaining_plates:
            return ()
        first_plate, *other_plates = remaining_plates
        options = [find_best_starts(other_plates, free_printers)]
        options += [
            (first_plate.id, *find_best_starts(other_plates, free_printers - {p}))
            for p in free_printers
            if can_start(first_plate, p)
        ]
        return max(options, key=lambda ids: [p.id in ids for p in remaining_plates])

    ordered_plates = sorted(waiting_plates, key=lambda p: p.priority_key)
    assert {a.plate for a in assignments} == set(find_best_starts(ordered_plates, frozenset(fleet)))


def test_planned_printer_is_never_a_spare():
    tall_plate = make_plate("1/02", "b", requirements=Requirements("generic_pla", None, 0.4, make_box(231.0)))
    assignments, _ = assign_with_holds(
        [tall_plate],
        [make_printer("a"), make_printer("b", boxes=TALL_BOXES)],
        make_rules(),
        FRIDAY_S,
        spares=1,
    )
    assert assignments[0].printer == "b"
    broken_printer = make_printer("b", boxes=TALL_BOXES, attention_reason="heater")
    assignments, _ = assign_with_holds(
        [tall_plate],
        [broken_printer, make_printer("c", boxes=TALL_BOXES)],
        make_rules(),
        FRIDAY_S,
        spares=1,
    )
    assert assignments[0].printer == "c"


@given(plates, fleets, st.integers(0, 2))
def test_every_plate_is_served_eventually(waiting_plates, fleet, spares):
    """Check that plates that fit a printer start after all prints have ended and all beds are clear."""
    waiting_plates = [replace(p, not_before_s=None) for p in waiting_plates]
    for _ in range(len(waiting_plates) + 1):
        _, holds = assign_with_holds(waiting_plates, fleet, make_rules(max_heating=4), FRIDAY_S, spares)
        waiting_plates = [p for p in waiting_plates if p.id in holds]
        fleet = [replace(p, is_heating=False) for p in fleet]
    final_codes = {
        HoldCode.NO_SUCH_PRINTER,
        HoldCode.BED_NOT_CLEAR,
        HoldCode.REEL_TOO_SHORT,
        HoldCode.UNATTENDED,
    }
    for candidate in waiting_plates:
        if holds[candidate.id].code is HoldCode.KEPT_AS_SPARE:  # its own printer waits for a person
            planned_printer = [p for p in fleet if p.name == candidate.planned_printer]
            assert not assign_with_holds([candidate], planned_printer, make_rules(max_heating=4), FRIDAY_S)[0]
        else:
            assert holds[candidate.id].code in final_codes


def find_printer_or_hold(plate, printer, start_rules=None, now_s=FRIDAY_S, **changes):
    assignments, holds = assign_with_holds([plate], [printer], start_rules or make_rules(), now_s, **changes)
    return holds[plate.id] if holds else assignments[0].printer


@pytest.mark.parametrize(
    ("plate", "printer", "start_rules", "code", "message"),
    [
        ({"expected_s": 6 * HOUR_S}, {}, {"quiet": ["22:00-06:00"]}, "quiet_hours", "to Sat 06:00"),
        ({"expected_s": 17 * HOUR_S}, {}, {"quiet": ["22:00-06:00"]}, "too_long", "takes 17h00"),
        (
            {},
            {"may_print_unattended": False},
            {"attended": ATTENDED_HOURS[0]},
            "unattended",
            "from Mon 08:00",
        ),
        ({}, {"may_print_unattended": False}, {}, "unattended", "has none (`attended`)"),
        (
            {"first_layer_s": 2 * HOUR_S},
            {},
            {"attended": ATTENDED_HOURS[0], "first_layers_attended": True},
            "unattended",
            "first layers",
        ),
        ({"not_before_s": FRIDAY_S + HOUR_S}, {}, {}, "start_time", "Fri 18:00"),
        ({"grams": 96.0}, {"grams": 40.0}, {}, "reel_too_short", "a has 40 g, but this plate needs 101 g"),
        ({}, {"is_heating": True}, {"max_heating": 1}, "heating_limit", "1 printers are heating up"),
    ],
)
def test_hold_has_a_code_and_a_reason(plate, printer, start_rules, code, message):
    hold = find_printer_or_hold(
        make_plate("1/01", "a", **plate), make_printer("a", **printer), make_rules(**start_rules)
    )
    assert hold.code == code
    assert message in hold.text
    assert find_printer_or_hold(make_plate("1/01", "a"), make_printer("a")) == "a"


def test_short_reel_is_named_in_addition_to_another_hold():
    short_printer = make_printer("b", grams=10.0)
    busy_printer = make_printer("a", is_booked=True, print_end_s=FRIDAY_S + HOUR_S)
    hold = assign_with_holds(
        [make_plate("1/01", "a", grams=20.0)], [busy_printer, short_printer], make_rules(), FRIDAY_S
    )[1]["1/01"]
    assert hold.code is HoldCode.PRINTER_BUSY
    assert (hold.reel.printer, hold.reel.text) == ("b", "b has 10 g, 1/01 needs 25 g")
    white_requirements = Requirements("generic_pla", "white", 0.4, make_box(100.0))
    fleet = [make_printer("b", grams=10.0, colour="white"), make_printer("c", colour="black")]
    hold = assign_with_holds(
        [make_plate("1/01", "b", grams=20.0, requirements=white_requirements)], fleet, make_rules(), FRIDAY_S
    )[1]["1/01"]
    assert hold.text.startswith("needs white: b has 10 g") and hold.reel.text == "b has 10 g, 1/01 needs 25 g"


def test_plate_ends_with_a_margin_before_quiet_hours():
    start_rules = make_rules(quiet=["22:00-06:00"])
    assert (
        find_printer_or_hold(
            make_plate("1/01", "a", expected_s=5 * HOUR_S / 1.05 - 1), make_printer("a"), start_rules
        )
        == "a"
    )
    assert (
        find_printer_or_hold(
            make_plate("1/01", "a", expected_s=5 * HOUR_S), make_printer("a"), start_rules
        ).code
        == "quiet_hours"
    )


def test_hold_of_a_large_plate_names_when_its_printers_are_free():
    tall_printers = [
        make_printer(n, boxes=TALL_BOXES, is_booked=True, print_end_s=FRIDAY_S + 10.2 * HOUR_S)
        for n in ("um2x-02", "um2x-03")
    ]
    hold = assign_with_holds(
        [make_plate("1/01", "um2x-02", requirements=Requirements("generic_pla", None, 0.4, make_box(231.0)))],
        [make_printer("um2-01"), *tall_printers],
        make_rules(),
        FRIDAY_S,
    )[1]["1/01"]
    assert hold.text == "needs 231 mm of height: um2x-02 and um2x-03 are printing until Sat 03:12"


def test_priority_precedes_order_of_submission():
    early_plate, urgent_plate = make_plate("1/01", "a", job=1), make_plate("2/01", "a", job=2, priority=1)
    assignments, holds = assign_with_holds(
        [early_plate, urgent_plate], [make_printer("a")], make_rules(), FRIDAY_S
    )
    assert assignments[0].plate == "2/01"
    assert holds["1/01"].code is HoldCode.PRINTER_BUSY


def test_plate_moves_to_an_equivalent_printer():
    low_plate = make_plate("1/01", "b", expected_s=9 * HOUR_S)
    tall_plate = make_plate("1/02", "b", requirements=Requirements("generic_pla", None, 0.4, make_box(231.0)))
    assignments, _ = assign_with_holds(
        [low_plate, tall_plate],
        [make_printer("a"), make_printer("b", boxes=TALL_BOXES)],
        make_rules(),
        FRIDAY_S,
    )
    assert {a.plate: a.printer for a in assignments} == {"1/01": "a", "1/02": "b"}


def test_spares_are_kept_for_plates_that_failed():
    fleet = [make_printer("a"), make_printer("b"), make_printer("c", boxes=TALL_BOXES)]
    waiting_plates = [make_plate(f"1/0{i}", "a") for i in range(3)]
    assignments, holds = assign_with_holds(waiting_plates, fleet, make_rules(), FRIDAY_S, spares=1)
    assert {a.printer for a in assignments} == {"a", "b"}
    assert [hold.code for hold in holds.values()] == [HoldCode.KEPT_AS_SPARE]
    assignments, _ = assign_with_holds(
        [make_plate("1/01", "a", failed_on=frozenset("ab"))], fleet, make_rules(), FRIDAY_S, spares=1
    )
    assert assignments[0].printer == "c"


def test_reel_with_enough_grams_is_accepted():
    plate, printer = make_plate("p1", "a", grams=200.0), make_printer("a")
    needed_grams = compute_needed_grams(plate)
    assert find_filament_shortage(plate, replace(printer, grams=needed_grams)) is None
    assert (
        find_filament_shortage(plate, replace(printer, grams=needed_grams - 0.1)).code
        is HoldCode.REEL_TOO_SHORT
    )


def test_longest_plate_of_a_job_is_served_first():
    short_plate, long_plate = (
        make_plate("a", "a", expected_s=HOUR_S),
        make_plate("b", "a", expected_s=2 * HOUR_S),
    )
    assert tuple(make_situation([short_plate, long_plate], [make_printer("a")]).waiting_plates) == (
        long_plate,
        short_plate,
    )


@given(st.integers(1, 30))
def test_joined_names_are_shown_or_counted(count):
    text = join_names([f"um2-{number:02d}" for number in range(count)])
    count_match = re.search(r"(\d+) more", text)
    assert text.count("um2-") + (int(count_match[1]) if count_match else 0) == count
    assert text.count("um2-") >= min(count, 3)
