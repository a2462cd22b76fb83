"""Coupon of numbered holes whose fits differ by 0.1 mm, and which print without support."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from decompose.connectors import Coupon, make_coupon
from decompose.connectors.coupon import UP_DIRECTION
from decompose.connectors.keys import choose_key_lengths_mm
from decompose.connectors.pins import END_GAP_MM, choose_depths_mm
from decompose.connectors.tools import MAX_GROOVE_SIN, MAX_HOLE_SIN, compute_overhang_sin, needs_bridge
from decompose.geometry import Solid, round_triangles


@pytest.fixture(scope="module", params=[1.75, 2.85, 5.0])
def coupon(request: pytest.FixtureRequest) -> tuple[float, Coupon]:
    return request.param, make_coupon(request.param)


def measure_width_mm(points: np.ndarray, direction: np.ndarray) -> float:
    """Measure the width across the flats of a hole, below any roof."""
    u = np.cross(np.eye(3)[int(np.abs(direction).argmin())], direction)
    plane_points = points @ np.stack([u, np.cross(direction, u)]).T
    middle = shapely.Point(plane_points[:6].mean(axis=0))
    return 2.0 * float(shapely.MultiPoint(plane_points).convex_hull.exterior.distance(middle))


def test_holes_on_top_and_in_front_get_wider_in_steps_of_the_fit(coupon: tuple[float, Coupon]) -> None:
    diameter_mm, coupon_result = coupon
    count = len(coupon_result.fits_mm)
    for start_index in (0, count):
        widths_mm = [
            measure_width_mm(hole.points_mm, hole.inward_normal)
            for hole in coupon_result.holes[start_index : start_index + count]
        ]
        assert widths_mm == pytest.approx([diameter_mm + fit_mm for fit_mm in coupon_result.fits_mm])
    gauges_mm = [
        float(np.ptp(hole.points_mm @ hole.inward_normal)) - 0.1 for hole in coupon_result.holes[2 * count :]
    ]
    assert gauges_mm == pytest.approx(coupon_result.lengths_mm)


def test_each_number_stands_on_the_face_of_its_hole(coupon: tuple[float, Coupon]) -> None:
    _, coupon_result = coupon
    texts = [f"{10 * fit_mm:.0f}" for fit_mm in coupon_result.fits_mm]
    assert [mark.text for mark in coupon_result.marks] == [
        *texts,
        *texts,
        *(f"{mm:g}" for mm in coupon_result.lengths_mm),
        *texts,
    ]
    tools = (*coupon_result.holes, *coupon_result.grooves[: len(texts)])
    for mark, hole in zip(coupon_result.marks, tools, strict=True):
        assert (mark.grooves[0].inward_normal == hole.inward_normal).all()
        assert mark.lines_mm[..., 0].mean() == pytest.approx(hole.points_mm[:, 0].mean(), abs=3.5)


def test_gauges_have_the_lengths_of_all_pins_and_keys(coupon: tuple[float, Coupon]) -> None:
    diameter_mm, coupon_result = coupon
    pin_lengths_mm = {2.0 * (depth_mm - END_GAP_MM) for depth_mm in choose_depths_mm(diameter_mm)}
    assert set(coupon_result.lengths_mm) == pin_lengths_mm | set(choose_key_lengths_mm(diameter_mm))
    if diameter_mm == 2.85:
        assert coupon_result.lengths_mm == (11.0, 8.0, 5.0, 4.0)


def test_grooves_of_block_and_plate_hold_a_key_of_the_pin_diameter_plus_their_fit(
    coupon: tuple[float, Coupon],
) -> None:
    """Move the plate onto the back of the block, and check that only a rod within the fit goes in."""
    diameter_mm, coupon_result = coupon
    block, plate = sorted(coupon_result.solid.list_pieces(), key=lambda piece: -piece.volume_mm3)
    back_mm = block.bounds_mm[1][1]
    closed_plate = plate.translate(np.array([0.0, back_mm - plate.bounds_mm[0][1], 0.0]))
    count = len(coupon_result.fits_mm)
    for fit_mm, groove in zip(coupon_result.fits_mm, coupon_result.grooves[:count], strict=True):
        middle = groove.points_mm.mean(axis=0)
        for excess_mm, fits in ((-0.02, True), (0.1, False)):
            circle = shapely.Point(middle[0], back_mm).buffer((diameter_mm + fit_mm + excess_mm) / 2.0, 32)
            ring = [np.asarray(circle.exterior.coords)[:-1]]
            rod = Solid.prism(ring, np.eye(3), float(middle[2]) - 1.0, float(middle[2]) + 1.0)
            overlap_mm3 = sum(rod.intersect(body).volume_mm3 for body in (block, closed_plate))
            assert (overlap_mm3 < 1e-4) == fits


def test_coupon_prints_without_support_in_two_pieces_and_is_a_closed_stl(
    coupon: tuple[float, Coupon],
) -> None:
    _, coupon_result = coupon
    assert len(coupon_result.solid.list_pieces()) == 2
    assert round_triangles(*coupon_result.solid.arrays()) is not None
    for tools, limit_sin in (
        (coupon_result.holes, MAX_HOLE_SIN),
        ([*coupon_result.grooves, *(g for m in coupon_result.marks for g in m.grooves)], MAX_GROOVE_SIN),
    ):
        for tool in tools:
            assert compute_overhang_sin(tool.points_mm, tool.inward_normal, UP_DIRECTION) <= limit_sin
            assert not needs_bridge(tool, UP_DIRECTION)
