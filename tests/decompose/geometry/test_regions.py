"""Regions of a solid: a box cut out of its region is the same as one cut out of the whole solid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decompose.geometry import Model, Solid, SolidRegions

# Shares of the solid's extent; boxes may also end outside the solid.
shares = st.floats(-0.2, 1.2)
corners = st.tuples(shares, shares, shares)


@pytest.fixture(scope="module")
def regions(ball: Model) -> SolidRegions:
    return SolidRegions(ball.solid)


@given(corners, corners)
def test_box_from_a_region_is_the_same_as_from_the_whole_solid(
    regions: SolidRegions, ball: Model, first: tuple[float, ...], second: tuple[float, ...]
) -> None:
    low_mm, high_mm = ball.solid.bounds_mm
    box_mm = low_mm + np.sort([first, second], axis=0) * (high_mm - low_mm)
    expected_solid = ball.solid.clip(*box_mm)
    solid = regions.find_region(box_mm).clip(*box_mm)
    assert solid.volume_mm3 == pytest.approx(expected_solid.volume_mm3, rel=1e-9, abs=1e-6)
    assert solid.area_mm2 == pytest.approx(expected_solid.area_mm2, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("start", [0.0, 0.2, 0.3, 0.49, 0.7])
def test_small_box_is_cut_out_of_a_small_region_that_is_kept(start: float, ball: Model) -> None:
    regions = SolidRegions(ball.solid)
    low_mm, high_mm = ball.solid.bounds_mm
    box_mm = low_mm + np.array([[start], [start + 0.2]]) * (high_mm - low_mm)
    region = regions.find_region(box_mm)
    assert region.face_count < 0.5 * ball.solid.face_count
    assert regions.find_region(box_mm) is region
    assert regions.cut_face_count == ball.solid.face_count


def test_whole_solid_and_planes_of_regions_need_no_region() -> None:
    """Check boxes as long as the solid, and boxes that end at the planes of the regions along one axis."""
    solid = Solid.box((0.0, 0.0, 0.0), (80.0, 80.0, 80.0))
    regions = SolidRegions(solid)
    assert regions.find_region(np.array([[0.0] * 3, [80.0] * 3])) is solid
    region = regions.find_region(np.array([[0.0, 20.0, 0.0], [40.0, 60.0, 10.0]]))
    assert np.allclose(region.bounds_mm, [[0.0, 0.0, 0.0], [80.0, 80.0, 40.0]])
