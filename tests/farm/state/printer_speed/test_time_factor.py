"""Time factor of a printer, which its prints update."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from books.make_books import apply_events, make_end_event, make_planned_books
from farm.model import Bed, PrintState, TimeFactors
from farm.state import events as ev
from farm.state.printer_speed import (
    MAX_STARVED_SHARE,
    MAX_TIME_FACTOR,
    MIN_LEARNED_S,
    MIN_TIME_FACTOR,
    update_time_factor,
)

HOUR_S = 3600.0
FACTORS = st.floats(MIN_TIME_FACTOR, MAX_TIME_FACTOR)
DURATIONS_S = st.floats(MIN_LEARNED_S, 100 * HOUR_S)
TIMES_S = st.floats(0.0, 1e9)


def apply_ratios(ratios, factor=1.0):
    for ratio in ratios:
        factor = update_time_factor(factor, HOUR_S, ratio * HOUR_S)
    return factor


@given(FACTORS, FACTORS, DURATIONS_S)
def test_time_factor_converges_to_the_true_ratio(initial_factor, true_ratio, expected_s):
    factor = initial_factor
    for _ in range(60):
        new_factor = update_time_factor(factor, expected_s, true_ratio * expected_s)
        assert abs(new_factor - true_ratio) <= abs(factor - true_ratio) + 1e-12
        factor = new_factor
    assert factor == pytest.approx(true_ratio, abs=1e-4)


@given(FACTORS, TIMES_S, TIMES_S, TIMES_S)
def test_time_factor_is_bounded_and_changes_slowly(factor, expected_s, actual_s, starved_s):
    new_factor = update_time_factor(factor, expected_s, actual_s, starved_s)
    assert MIN_TIME_FACTOR <= new_factor <= MAX_TIME_FACTOR
    assert abs(new_factor - factor) <= 0.025 + 1e-12


@given(st.lists(st.floats(0.9, 1.2), min_size=1, max_size=5), FACTORS)
def test_order_of_prints_hardly_affects_the_factor(ratios, initial_factor):
    final_factors = [apply_ratios(order, initial_factor) for order in itertools.permutations(ratios)]
    assert max(final_factors) - min(final_factors) <= max(ratios) - min(ratios) + 1e-9


@given(st.lists(st.floats(1.0, 1.1), min_size=1, max_size=30))
def test_time_factor_stays_within_observed_ratios(ratios):
    assert 1.0 <= apply_ratios(ratios) <= max(ratios)


@pytest.mark.parametrize(
    ("expected_s", "actual_s", "starved_s"),
    [
        (MIN_LEARNED_S - 1, 1.1 * MIN_LEARNED_S, 0.0),  # too short
        (HOUR_S, 1.1 * HOUR_S, 0.02 * HOUR_S),  # starved too long
        (HOUR_S, 5 * HOUR_S, 0.0),  # paused overnight
        (HOUR_S, -10.0, 0.0),  # the clock was set back
        (HOUR_S, 0.0, 0.0),
    ],
)
def test_unrepresentative_print_does_not_change_the_factor(expected_s, actual_s, starved_s):
    assert update_time_factor(1.05, expected_s, actual_s, starved_s) == 1.05


def lengthen_first_plate(books, factor):
    """Give the first plate, planned with a factor, an hour of layers and 100 s of other time."""
    plate = books.plates["1/01"]
    changes = {
        "sliced_s": HOUR_S,
        "time_factor": factor,
        "expected_s": HOUR_S * factor + 100.0,
    }
    books.plates["1/01"] = plate.model_copy(update=changes)
    return books


def make_printed_books(state=PrintState.DONE, planned_factor=1.0, elapsed_s=1.1 * HOUR_S + 100.0):
    return apply_events(
        lengthen_first_plate(make_planned_books(plates=2), planned_factor),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        make_end_event("x", state, at_s=2.0 + elapsed_s, fault=None, reason="r"),
    )[0]


@pytest.mark.parametrize("planned_factor", [1.0, 0.9])
def test_time_factor_learns_from_a_completed_print(planned_factor):
    books = make_printed_books(planned_factor=planned_factor)
    assert books.printers["a"].time_factor == pytest.approx(1.025)
    assert books.printers["b"].time_factor == 1.0
    assert books.plates["1/01"].compute_expected_s(TimeFactors(1.2)) == pytest.approx(1.2 * HOUR_S + 100.0)


def test_failed_print_does_not_update_the_factor():
    books = make_printed_books(PrintState.FAILED)
    assert books.printers["a"].bed is Bed.NOT_CLEAR
    assert books.printers["a"].time_factor == 1.0


def test_paused_print_does_not_update_the_factor():
    fields = {"print_id": "x", "started_s": 2.0, "extruded": True}
    books, _ = apply_events(
        lengthen_first_plate(make_planned_books(), 1.0),
        ev.PlateAssigned(at_s=2.0, plate="1/01", printer="a", print_id="x"),
        ev.PrintProgressed(at_s=3.0, state=PrintState.PAUSED, **fields),
        ev.PrintProgressed(at_s=4.0, state=PrintState.PRINTING, **fields),
        make_end_event("x", at_s=1.1 * HOUR_S),
    )
    assert books.printers["a"].time_factor == 1.0


@pytest.mark.parametrize("ratio", [0.3, 0.49, 2.01, 5.0])
def test_implausible_print_time_is_ignored_by_the_factor(ratio):
    assert update_time_factor(1.0, HOUR_S, ratio * HOUR_S) == 1.0


def test_print_with_a_short_starvation_updates_the_factor():
    assert update_time_factor(1.0, HOUR_S, 1.1 * HOUR_S, MAX_STARVED_SHARE * HOUR_S) > 1.0
