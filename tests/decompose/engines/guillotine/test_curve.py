"""Curve of makespans over the number of printers, compared with a search for each number."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from books.box_tables import Shape, make_tables
from decompose.auto import CountGoal
from decompose.engines.guillotine import (
    CurvePoint,
    Partitioner,
    compute_makespan_curve,
    find_fewest_printers_in_time,
    find_least_total_time,
)
from decompose.engines.guillotine.curve import TOLERANCE
from decompose.engines.guillotine.partitioner import OtherClass

MAX_PRINTERS = 8


def make_equal_fleets(max_count: int) -> np.ndarray:
    """Make fleets of one, two, ... printers of one class."""
    return np.arange(1, max_count + 1)[:, None]


@settings(max_examples=25, deadline=None)
@given(shape=st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 3)), seed=st.integers(0, 10**6))
def test_each_point_equals_a_separate_search(shape: Shape, seed: int) -> None:
    tables, is_needed = make_tables(shape, seed)
    points = {
        p.printer_count: p.makespan_s
        for p in compute_makespan_curve([tables], make_equal_fleets(MAX_PRINTERS))
    }
    for printers in range(1, MAX_PRINTERS + 1):
        min_makespan_s = Partitioner(tables).find_min_makespan_s(printers, 0.0, tolerance_s=1e-3)
        if min_makespan_s is None or not is_needed.any():
            assert printers not in points
        else:
            assert min_makespan_s - 2e-3 <= points[printers] <= min_makespan_s / (1.0 - TOLERANCE)


@settings(max_examples=20, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 4), st.integers(1, 3), st.integers(1, 3)),
    seed=st.integers(0, 10**6),
    order=st.lists(st.integers(0, 1), min_size=1, max_size=5),
    ratio=st.floats(0.5, 1.5),
)
def test_each_point_of_unequal_printers_equals_a_separate_search(
    shape: Shape, seed: int, order: list[int], ratio: float
) -> None:
    """Use a second class with another speed; some boxes fit only one of the two."""
    first_tables, is_needed = make_tables(shape, seed)
    rng = np.random.default_rng(seed)
    factors = np.where(rng.random((2, len(first_tables.seconds))) < 0.2, np.inf, 1.0).astype(np.float32)
    scaled_tables = replace(first_tables, seconds=first_tables.seconds * factors[0])
    other_boxes = replace(first_tables, seconds=first_tables.seconds * np.float32(ratio) * factors[1])
    fleets = np.cumsum(np.eye(2, dtype=np.int64)[order], axis=0)
    points = {
        p.printer_count: p.makespan_s for p in compute_makespan_curve([scaled_tables, other_boxes], fleets)
    }
    for first_count, other_count in fleets.tolist():
        min_makespan_s = Partitioner(
            scaled_tables, [OtherClass(other_boxes, other_count)]
        ).find_min_makespan_s(first_count, 0.0, tolerance_s=1e-3)
        if min_makespan_s is None or not is_needed.any():
            assert first_count + other_count not in points
        else:
            assert (
                min_makespan_s - 2e-3
                <= points[first_count + other_count]
                <= (min_makespan_s + 2e-3) / (1.0 - TOLERANCE)
            )


def test_more_printers_never_take_longer_and_threads_change_nothing() -> None:
    tables, _ = make_tables((6, 5, 4), 3)
    points = compute_makespan_curve([tables], make_equal_fleets(30))
    assert [p.printer_count for p in points] == list(range(points[0].printer_count, 31))
    assert all(b.makespan_s <= a.makespan_s for a, b in pairwise(points))
    with ThreadPoolExecutor(2) as executor:
        assert compute_makespan_curve([tables], make_equal_fleets(30), executor) == points


def test_curve_of_an_empty_model_is_empty() -> None:
    tables, _ = make_tables((2, 2, 2), 1)
    tables.seconds[:] = np.inf
    assert compute_makespan_curve([tables], make_equal_fleets(4)) == ()


def test_least_total_time_includes_the_work_of_a_person() -> None:
    points = [CurvePoint(n, 36000.0 / n) for n in range(1, 101)]
    # The square root of 36000 / 360.
    assert find_least_total_time(points, clearing_s=300.0, assembly_s=60.0).printer_count == 10
    assert find_least_total_time(points, clearing_s=0.0, assembly_s=0.0).printer_count == 100
    assert find_least_total_time([CurvePoint(3, 100.0), CurvePoint(4, 100.0)], 0.0, 0.0).printer_count == 3


def test_fewest_printers_in_time_or_else_the_fastest_are_chosen() -> None:
    points = [CurvePoint(1, 9.0), CurvePoint(2, 5.0), CurvePoint(3, 4.0), CurvePoint(4, 4.0)]
    assert [
        find_fewest_printers_in_time(points, time_limit_s).printer_count
        for time_limit_s in (9.0, 8.9, 5.0, 4.5, 3.0)
    ] == [
        1,
        2,
        2,
        3,
        3,
    ]


def test_gluing_time_counts_if_the_parts_must_be_glued_in_time() -> None:
    points = [CurvePoint(1, 100.0), CurvePoint(2, 60.0), CurvePoint(3, 45.0), CurvePoint(4, 40.0)]
    assert find_fewest_printers_in_time(points, 70.0).printer_count == 2
    assert find_fewest_printers_in_time(points, 70.0, handling_s=5.0).printer_count == 2
    assert find_fewest_printers_in_time(points, 69.0, handling_s=5.0).printer_count == 3
    assert (
        find_fewest_printers_in_time(points, 100.0, handling_s=50.0).printer_count == 1
    )  # one part is not glued
    assert find_fewest_printers_in_time(points, 10.0, handling_s=20.0).printer_count == 1
    assert CountGoal(0.0, 5.0, 69.0).choose_point(points).printer_count == 2
    assert CountGoal(0.0, 5.0, 69.0, includes_gluing=True).choose_point(points).printer_count == 3
