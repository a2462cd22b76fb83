"""Convex outlines, compared with those of shapely."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import MultiPoint

from decompose.geometry import (
    find_convex_outline,
    find_half_planes,
    find_smallest_rectangle_angle_rad,
    measure_rectangles,
)
from decompose.geometry.convex import MIN_FILTERED_POINTS

coordinates = st.integers(-20, 20).map(lambda v: v / 2.0)
few_points = st.lists(st.tuples(coordinates, coordinates), min_size=3, max_size=30).map(np.array)
many_points = st.builds(  # so many that inner points are dropped first
    lambda seed, count: np.random.default_rng(seed).integers(-40, 41, (count, 2)) / 2.0,
    st.integers(0, 2**32 - 1),
    st.integers(MIN_FILTERED_POINTS, 4 * MIN_FILTERED_POINTS),
)
point_lists = st.one_of(few_points, many_points)


@settings(deadline=None)  # the first call compiles
@given(point_lists)
def test_outline_has_the_area_of_the_hull_and_holds_all_points(points: np.ndarray) -> None:
    outline = find_convex_outline(points)
    hull = MultiPoint(points).convex_hull
    if hull.area == 0.0:
        assert len(outline) == 0
        return
    x, y = outline.T
    assert (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2.0 == pytest.approx(hull.area)
    half_planes = find_half_planes(outline)
    assert len(outline) == len(hull.exterior.coords) - 1  # no corner on a straight side
    assert (points @ half_planes[:, :2].T + half_planes[:, 2] <= 1e-9).all()


@settings(deadline=None)  # the first call compiles
@given(point_lists)
def test_smallest_rectangle_equals_that_of_shapely(points: np.ndarray) -> None:
    outline = find_convex_outline(points)
    if not len(outline):
        return
    ((length, width),) = measure_rectangles(outline, np.array([find_smallest_rectangle_angle_rad(outline)]))
    assert length >= width - 1e-9
    assert length * width == pytest.approx(MultiPoint(points).minimum_rotated_rectangle.area)


def test_points_on_a_line_have_no_outline() -> None:
    assert len(find_convex_outline(np.array([[0.0, 0.0], [1.0, 1.0], [3.0, 3.0]]))) == 0
    assert len(find_convex_outline(np.zeros((0, 2)))) == 0
