"""Forecast: plates do not overlap, hours are kept, and the bound is valid."""

import itertools
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
    make_rules,
    make_situation,
)
from farm.model import Bed, Link, TimeFactors
from farm.scheduling.forecast import CLEARING_TIME_S, compute_printing_s, forecast_prints
from farm.scheduling.matching import Requirements

MONDAY_S = 1_000_000.0 // 604800 * 604800 + 4 * 86400  # 00:00 UTC
HOUR_S = 3600.0


def make_forecast(waiting_plates, fleet, start_rules, now_s):
    return forecast_prints(make_situation(waiting_plates, fleet, start_rules, now_s))


fleets = st.lists(
    st.builds(
        make_printer,
        st.sampled_from("abcd"),
        boxes=st.sampled_from([LOW_BOXES, TALL_BOXES]),
        is_booked=st.booleans(),
        print_end_s=st.none() | st.floats(MONDAY_S, MONDAY_S + 10 * HOUR_S),
        bed=st.sampled_from([Bed.CLEAR, Bed.NOT_CLEAR]),
        grams=st.none() | st.floats(0, 300),
        time_factors=st.sampled_from([0.9, 1.0, 1.2]).map(TimeFactors),
    ),
    min_size=1,
    unique_by=lambda p: p.name,
)
plate_lists = st.lists(
    st.builds(
        make_plate,
        st.uuids().map(str),
        st.sampled_from("abcd"),
        requirements=st.builds(
            Requirements, st.none(), st.none(), st.none(), st.sampled_from([make_box(100.0), make_box(250.0)])
        ),
        expected_s=st.floats(600, 9 * HOUR_S),
        overhead_s=st.just(300.0),
        first_layer_s=st.just(500.0),
        grams=st.floats(0, 100),
        job=st.integers(1, 2),
        priority=st.integers(0, 1),
    ),
    max_size=8,
    unique_by=lambda p: p.id,
)
rule_sets = st.builds(
    make_rules,
    attended=st.sampled_from([(), ("08:00-18:00",), ("mon-fri 08:00-12:00", "13:00-17:00")]),
    quiet=st.sampled_from([(), ("22:00-06:00",), ("sat,sun 00:00-24:00",)]),
    first_layers_attended=st.booleans(),
    max_heating=st.none() | st.integers(1, 3),
)


@given(plate_lists, fleets, rule_sets, st.floats(0, 7 * 24 * HOUR_S), st.randoms())
def test_forecast_keeps_its_invariants(plates, fleet, start_rules, offset_s, random):
    now_s = MONDAY_S + offset_s
    forecast = make_forecast(plates, fleet, start_rules, now_s)
    plates_by_id, printers_by_name = {p.id: p for p in plates}, {p.name: p for p in fleet}
    assert sorted([slot.plate for slot in forecast.slots] + list(forecast.unprintable_plates)) == sorted(
        plates_by_id
    )
    for name, slots in itertools.groupby(
        sorted(forecast.slots, key=lambda s: s.printer), lambda s: s.printer
    ):
        ordered_slots = sorted(slots, key=lambda slot: slot.start_s)
        for slot, next_slot in itertools.pairwise(ordered_slots):
            assert next_slot.start_s >= slot.end_s + CLEARING_TIME_S
        reel_grams = printers_by_name[name].grams
        assert (
            reel_grams is None or sum(plates_by_id[slot.plate].grams for slot in ordered_slots) <= reel_grams
        )
    for slot in forecast.slots:
        plate, printer = plates_by_id[slot.plate], printers_by_name[slot.printer]
        assert plate.requirements.matches(printer.capabilities)
        assert slot.start_s >= now_s
        assert slot.end_s - slot.start_s == pytest.approx(compute_printing_s(plate, printer))
        assert start_rules.find_start(plate, printer, slot.start_s).at_s == slot.start_s
        heating_slots = [s for s in forecast.slots if s.start_s <= slot.start_s < s.start_s + 300.0]
        assert start_rules.max_heating is None or len(heating_slots) <= start_rules.max_heating
    assert now_s <= forecast.lower_bound_s <= forecast.end_s
    for items in (plates, fleet):
        random.shuffle(items)
    assert make_forecast(plates, fleet, start_rules, now_s) == forecast


@given(st.lists(st.floats(600, 9 * HOUR_S), min_size=1, max_size=6), st.integers(1, 3))
def test_bound_is_below_the_end_of_every_order(durations_s, printer_count):
    names = "abc"[:printer_count]
    plates = [make_plate(f"1/{i}", "a", expected_s=duration_s) for i, duration_s in enumerate(durations_s)]
    forecast = make_forecast(plates, [make_printer(name) for name in names], make_rules(), 0.0)
    best_end_s = min(
        max(sum(t for t, place in zip(durations_s, places, strict=True) if place == name) for name in names)
        for places in itertools.product(names, repeat=len(durations_s))
    )
    assert forecast.lower_bound_s <= best_end_s * (1 + 1e-9)
    rounds = -(-len(durations_s) // printer_count)
    assert forecast.end_s <= 4 / 3 * best_end_s + len(durations_s) * CLEARING_TIME_S
    assert rounds > 1 or forecast.end_s == pytest.approx(best_end_s)


def test_second_round_waits_for_a_cleared_bed():
    start_rules = make_rules(attended=("mon-fri 08:00-18:00",))
    plates = [make_plate("1/01", "a", expected_s=4 * HOUR_S), make_plate("1/02", "a", expected_s=2 * HOUR_S)]
    forecast = make_forecast(plates, [make_printer("a")], start_rules, MONDAY_S + 17 * HOUR_S)
    assert [slot.start_s - MONDAY_S for slot in forecast.slots] == [
        17 * HOUR_S,
        32 * HOUR_S + CLEARING_TIME_S,
    ]


def test_heating_limit_delays_starts():
    plates = [make_plate(f"1/{i}", "abc"[i], expected_s=HOUR_S, overhead_s=600.0) for i in range(3)]
    forecast = make_forecast(plates, [make_printer(name) for name in "abc"], make_rules(max_heating=2), 0.0)
    assert [slot.start_s for slot in forecast.slots] == [0.0, 0.0, 600.0]


def test_absent_printer_is_not_used():
    plates = [make_plate(f"1/{i}", "a", expected_s=HOUR_S) for i in range(2)]
    forecast = make_forecast(
        plates, [make_printer("a"), make_printer("b", link=Link.ABSENT)], make_rules(), 0.0
    )
    assert {slot.printer for slot in forecast.slots} == {"a"}


def test_time_of_a_plate_scales_with_the_time_factor():
    plate = make_plate("p", "a", expected_s=1100.0, overhead_s=100.0, time_factor=1.25)
    for factor, expected_s in ((1.0, 100.0 + 800.0), (1.25, 1100.0)):
        printer = make_printer("b", time_factors=TimeFactors(factor))
        assert compute_printing_s(plate, printer) == pytest.approx(expected_s)


def test_time_of_a_plate_depends_on_its_features():
    plate = make_plate(
        "p", "a", expected_s=1100.0, overhead_s=100.0, feature_shares=(0.5, 0.2, 0.1, 0.0, 0.2)
    )
    printer = make_printer("b", time_factors=TimeFactors(1.1, (1.0, 1.0, 1.2, 1.0, 1.4)))
    assert compute_printing_s(plate, printer) == pytest.approx(100.0 + 1000.0 * 1.1)
    travel_plate = replace(plate, feature_shares=(0.0, 0.0, 0.0, 0.0, 1.0))
    assert compute_printing_s(travel_plate, printer) == pytest.approx(100.0 + 1000.0 * 1.4)
    assert compute_printing_s(replace(plate, feature_shares=None), printer) == pytest.approx(1200.0)


def test_bound_considers_plates_that_fit_only_some_printers():
    low_requirements, tall_requirements = (
        Requirements(None, None, None, make_box(height_mm)) for height_mm in (100.0, 250.0)
    )
    plate_requirements = enumerate((tall_requirements, low_requirements, low_requirements))
    plates = [
        make_plate(f"1/{i}", "b", requirements=item, expected_s=2 * HOUR_S) for i, item in plate_requirements
    ]
    forecast = make_forecast(
        plates,
        [make_printer("a", boxes=LOW_BOXES), make_printer("b", boxes=TALL_BOXES)],
        make_rules(),
        0.0,
    )
    assert forecast.lower_bound_s == pytest.approx(3 * HOUR_S)


def test_plate_that_needs_more_filament_than_a_reel_has_waits_for_another_printer():
    plates = [make_plate(f"1/{i}", "a", expected_s=HOUR_S, grams=40.0) for i in range(2)]
    fleet = [make_printer("a", grams=50.0), make_printer("b", is_booked=True, print_end_s=10 * HOUR_S)]
    forecast = make_forecast(plates, fleet, make_rules(), 0.0)
    assert (forecast.unprintable_plates, [slot.printer for slot in forecast.slots]) == (
        (),
        ["a", "b"],
    )
