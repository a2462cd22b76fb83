"""The curve over the number of printers against a search for each number."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from box_tables import Shape, tables
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.curve import CLOSE, Point, curve, in_time, knee
from decompose.guillotine import Partitioner

MOST = 8


@settings(max_examples=25, deadline=None)
@given(shape=st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 3)), seed=st.integers(0, 10**6))
def test_each_point_is_what_a_search_of_its_own_finds(shape: Shape, seed: int) -> None:
    boxes, needed = tables(shape, seed)
    points = {p.printers: p.makespan_s for p in curve(boxes, MOST)}
    for printers in range(1, MOST + 1):
        least = Partitioner(boxes).least_makespan(printers, 0.0, tolerance_s=1e-3)
        if least is None or not needed.any():
            assert printers not in points
        else:
            assert least - 2e-3 <= points[printers] <= least / (1.0 - CLOSE)


def test_more_printers_never_take_longer_and_threads_change_nothing() -> None:
    boxes, _ = tables((6, 5, 4), 3)
    points = curve(boxes, 30)
    assert [p.printers for p in points] == list(range(points[0].printers, 31))
    assert all(b.makespan_s <= a.makespan_s for a, b in pairwise(points))
    with ThreadPoolExecutor(2) as executor:
        assert curve(boxes, 30, executor) == points


def test_nothing_to_print_has_no_curve() -> None:
    boxes, _ = tables((2, 2, 2), 1)
    boxes.seconds[:] = np.inf
    assert curve(boxes, 4) == ()


def test_the_knee_counts_what_a_person_does() -> None:
    points = [Point(n, 36000.0 / n) for n in range(1, 101)]
    assert knee(points, clear_s=300.0, assemble_s=60.0).printers == 10  # the root of 36000 / 360
    assert knee(points, clear_s=0.0, assemble_s=0.0).printers == 100
    assert knee([Point(3, 100.0), Point(4, 100.0)], 0.0, 0.0).printers == 3


def test_as_few_printers_as_are_done_in_time_or_the_soonest() -> None:
    points = [Point(1, 9.0), Point(2, 5.0), Point(3, 4.0), Point(4, 4.0)]
    assert [in_time(points, within_s).printers for within_s in (9.0, 8.9, 5.0, 4.5, 3.0)] == [1, 2, 2, 3, 3]
