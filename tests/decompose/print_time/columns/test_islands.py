"""Counts of islands, bodies and holes in the raster of a level, and the travel between islands."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import label
from scipy.sparse.csgraph import minimum_spanning_tree

from decompose.print_time.columns.islands import (
    ISLAND_LEVEL_COUNT,
    ISLAND_STRIDE,
    Runs,
    sum_islands_mm,
)
from decompose.print_time.columns.rasters import MAX_TOUR_COUNT, count_islands

EIGHT_NEIGHBOURS = np.ones((3, 3))
rasters = st.tuples(st.integers(1, 9), st.integers(1, 9)).flatmap(
    lambda shape: arrays(np.int8, shape, elements=st.integers(0, 2))
)


@settings(max_examples=300)
@given(rasters)
def test_counts_are_those_of_connected_regions(kinds):
    is_solid, is_support = kinds == 1, kinds == 2
    body_count = label(is_solid, EIGHT_NEIGHBOURS)[1]
    hole_count = label(np.pad(~is_solid, 1, constant_values=True))[1] - 1
    counts = count_islands(kinds)
    assert counts.islands == body_count + label(is_support, EIGHT_NEIGHBOURS)[1]
    assert (counts.bodies, counts.holes) == (body_count, hole_count)


@given(rasters)
def test_tour_is_as_long_as_a_way_to_all_islands(kinds):
    centres = [
        np.argwhere(labels == k).mean(axis=0)
        for labels, count in (label(kinds == kind, EIGHT_NEIGHBOURS) for kind in (1, 2))
        for k in range(1, count + 1)
    ]
    tour_cells = count_islands(kinds).tour_cells
    if len(centres) < 2:
        assert tour_cells == 0.0
        return
    distances_cells = np.linalg.norm(np.array(centres)[:, None] - np.array(centres), axis=2)
    # Any way to all islands is at least as long as the shortest tree that connects them. A cell is added to
    # each distance because one of 0 would count as no connection.
    tree_cells = minimum_spanning_tree(distances_cells + 1.0).sum() - (len(centres) - 1)
    assert tree_cells - 1e-6 < tour_cells < (len(centres) - 1) * distances_cells.max() + 1e-6


def test_tour_visits_supports_first_and_then_the_nearest_bodies():
    kinds = np.zeros((3, 40), np.int8)
    kinds[0, [0, 10]] = 1
    kinds[0, [4, 30]] = 2
    # From the support at 4 to that at 30, then to the bodies at 10 and 0.
    assert count_islands(kinds).tour_cells == 26 + 20 + 10


def test_tour_is_measured_between_centres():
    kinds = np.zeros((9, 20), np.int8)
    kinds[0:5, 0:5] = 1  # centre at (2, 2)
    kinds[4:7, 9:12] = 1  # centre at (5, 10)
    assert count_islands(kinds).tour_cells == pytest.approx(np.hypot(3, 8))


def test_tour_of_many_islands_is_estimated():
    side = 2 * math.isqrt(MAX_TOUR_COUNT) + 1
    kinds = np.zeros((side, side), np.int8)
    kinds[::2, ::2] = 1
    counts = count_islands(kinds)
    assert counts.islands > MAX_TOUR_COUNT
    assert counts.tour_cells == pytest.approx(2 * (counts.islands - 1), rel=0.1)


@given(
    st.lists(
        st.tuples(st.floats(0.0, 40.0), st.floats(0.01, 40.0), st.floats(0.0, 20.0)), min_size=1, max_size=3
    )
)
def test_levels_within_a_run_and_its_support_are_counted(stretches):
    """Let a column stand alone: it adds an island in each level within its runs and their supports."""
    ends, z_mm = [], 0.0
    for air_mm, run_mm, support_mm in stretches:
        bottom_mm = z_mm + air_mm
        z_mm = bottom_mm + run_mm
        ends.append((bottom_mm, z_mm, 0.0, min(support_mm, air_mm), 1.0))
    height_mm = z_mm
    # Another column, beyond a free one, is solid everywhere, so that the first one adds an island.
    ny = 2 * ISLAND_STRIDE + 1
    counts, start = np.zeros(ny, np.int64), np.zeros(ny, np.int64)
    counts[0], counts[-1] = len(ends), 1
    start[1:] = len(ends)
    runs = Runs(start, counts, np.array([*ends, (-1.0, height_mm + 1.0, 0.0, 0.0, 1.0)]))
    levels_mm = height_mm * (np.arange(ISLAND_LEVEL_COUNT) + 0.5) / ISLAND_LEVEL_COUNT
    is_filled = [
        any(bottom - support < z < top for bottom, top, _, support, _ in ends) for z in levels_mm.tolist()
    ]
    extra_mm = sum_islands_mm(runs, (1, ny), height_mm, 1.0)[0]
    assert extra_mm == pytest.approx(sum(is_filled) * height_mm / ISLAND_LEVEL_COUNT)
