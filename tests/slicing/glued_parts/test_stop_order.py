"""Order of stops: each stop once, never longer than before, and the shortest one for few stops."""

from itertools import pairwise, permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slicing.glued_parts.stop_order import Stops, find_order

POINTS = st.tuples(st.integers(0, 100), st.integers(0, 100))


def measure_mm(stops, order):
    arrivals_mm, departures_mm = stops.list_arrivals_mm(), stops.list_departures_mm()
    return sum(float(np.hypot(*(departures_mm[a] - arrivals_mm[b]))) for a, b in pairwise(order))


def make_stops(lines, *, start=(0, 0), end=(0, 0), is_reversible=True):
    begins_mm, ends_mm = np.array(lines, np.float64).reshape(-1, 2, 2).transpose(1, 0, 2)
    return Stops(begins_mm, ends_mm, np.array(start), np.array(end), is_reversible)


@given(lines=st.lists(st.tuples(POINTS, POINTS), min_size=1, max_size=10), start=POINTS, end=POINTS)
def test_each_stop_is_passed_once_on_a_way_that_is_not_longer(lines, start, end):
    for is_reversible in (False, True):
        stops = make_stops(lines, start=start, end=end, is_reversible=is_reversible)
        order = find_order(stops)
        assert sorted((stop - 1) % len(lines) for stop in order[1:-1]) == list(range(len(lines)))
        assert (order[0], order[-1]) == (0, 2 * len(lines) + 1)
        assert is_reversible or max(order[1:-1]) <= len(lines)
        present = [0, *range(1, len(lines) + 1), 2 * len(lines) + 1]
        assert measure_mm(stops, order) <= measure_mm(stops, present) + 1e-9


@given(lines=st.lists(st.tuples(POINTS, POINTS), min_size=1, max_size=3), start=POINTS)
def test_no_other_order_is_half_as_long(lines, start):
    stops = make_stops(lines, start=start)
    count = len(lines)
    shortest_mm = min(
        measure_mm(stops, [0, *(n + count * r for n, r in zip(numbers, turns, strict=True)), 2 * count + 1])
        for numbers in permutations(range(1, count + 1))
        for turns in product((0, 1), repeat=count)
    )
    assert measure_mm(stops, find_order(stops)) <= 2.0 * shortest_mm + 1.0


@pytest.mark.parametrize("is_reversible", [False, True])
def test_stops_on_a_line_are_passed_in_their_order(is_reversible):
    lines = [((x, 0), (x, 0)) for x in (30, 10, 40, 20)]
    stops = make_stops(lines, end=(50, 0), is_reversible=is_reversible)
    assert [(stop - 1) % 4 for stop in find_order(stops)[1:-1]] == [1, 3, 0, 2]
