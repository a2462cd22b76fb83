"""Area of a brim, compared with distances to everything that stands on the bed."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from decompose.print_time.columns.brim import count_brim_columns
from decompose.print_time.columns.sweep import sum_steps_mm


@settings(deadline=None)  # the first call compiles
@given(st.integers(0, 2**32 - 1), st.floats(0.3, 6.0), st.floats(0.4, 2.0))
def test_brim_covers_the_columns_outside_within_its_width(seed: int, width_mm: float, step_mm: float) -> None:
    rng = np.random.default_rng(seed)
    noise = ndimage.gaussian_filter(rng.random(rng.integers(1, 40, 2)), rng.uniform(0.3, 4.0))
    is_standing = np.pad(noise > np.quantile(noise, rng.uniform()), math.ceil(width_mm / step_mm) + 1)
    labels, _ = ndimage.label(~is_standing)
    is_filled = labels != labels[0, 0]
    expected_count = 0
    if is_filled.any():
        distances_mm = (ndimage.distance_transform_edt(~is_filled) - 0.5) * step_mm
        expected_count = int((~is_filled & (distances_mm <= width_mm)).sum())
    assert count_brim_columns(is_standing, width_mm, step_mm) == expected_count


@settings(deadline=None)  # the first call compiles
@given(st.integers(0, 2**32 - 1))
def test_steps_include_the_sides_of_the_outermost_columns(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights_mm = rng.random(rng.integers(1, 9, 2))
    padded_mm = np.pad(heights_mm, 1)
    expected_mm = np.abs(np.diff(padded_mm, axis=0)).sum() + np.abs(np.diff(padded_mm, axis=1)).sum()
    assert np.isclose(sum_steps_mm(heights_mm), expected_mm)
