"""Counts of islands, bodies and holes in the raster of a level."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import label

from decompose.print_time.columns.islands import (
    ISLAND_LEVEL_COUNT,
    ISLAND_STRIDE,
    Runs,
    count_islands,
    sum_islands_mm,
)

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
    assert counts.solid_cells == is_solid.sum()
    filled = np.argwhere(kinds > 0)
    sides = np.ptp(filled, axis=0) + 1 if len(filled) else np.zeros(2)
    assert counts.rectangle_cells == sides.prod()


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
