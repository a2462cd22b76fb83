"""Rims of flat faces, and rings of denser infill below slopes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from decompose.geometry import Solid
from decompose.print_time import POSE_ROTATIONS, PartMesh, PrintTimeSettings
from decompose.print_time.contours import RISING_WALL_FACTOR, Contours, measure_contours

UP_AXIS = np.array([0.0, 0.0, 1.0])


def make_mesh(solid: Solid) -> PartMesh:
    vertices, faces = solid.arrays()
    return PartMesh(vertices, faces, np.zeros(len(faces), np.bool_))


def measure_solid(solid: Solid, ring_cos: float = 1.0) -> Contours:
    return measure_contours(make_mesh(solid), UP_AXIS, 0.7, ring_cos)


def make_frustum(bottom_mm: float, top_mm: float, height_mm: float) -> Solid:
    corners = [
        (x * side, y * side, z)
        for side, z in ((bottom_mm / 2, 0.0), (top_mm / 2, height_mm))
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    hull = trimesh.convex.convex_hull(np.array(corners, float))
    return Solid.from_arrays(hull.vertices, hull.faces)


def test_rims_of_a_block_are_those_of_its_bottom_and_top() -> None:
    rims = measure_solid(Solid.box((0, 0, 0), (30, 20, 10)))
    assert rims.rim_mm == rims.rim_ends_mm == pytest.approx(2 * 100.0)


def test_skin_continues_under_a_wall_that_rises_from_it() -> None:
    stepped_block = Solid.union([Solid.box((0, 0, 0), (60, 60, 10)), Solid.box((20, 20, 9), (40, 40, 20))])
    rims = measure_solid(stepped_block)
    assert rims.rim_mm == pytest.approx(2 * 240.0 + 80.0 - RISING_WALL_FACTOR * 80.0)
    assert rims.rim_ends_mm == pytest.approx(2 * 240.0 + 2 * 80.0)


def test_ball_has_no_rims() -> None:
    ball = trimesh.creation.icosphere(5, 20.0)
    rims = measure_solid(Solid.from_arrays(ball.vertices, ball.faces))
    assert rims.rim_ends_mm < 0.05 * 4 * np.pi * 20.0 * np.sqrt(1.0 - 0.7**2)


def test_rings_lie_below_slopes_that_are_flat_enough() -> None:
    """Check the smallest slope that has a ring: 10 degrees for 2 mm of depth and lines of 0.35 mm."""
    ring_cos = PrintTimeSettings(infill_step_count=1, infill_step_mm=2.0).ring_cos
    assert np.degrees(np.arcsin(ring_cos)) == pytest.approx(9.93, abs=0.01)
    flat_frustum, steep_frustum = (
        make_frustum(60, 60 - 2 * 20 * np.tan(np.radians(15)), 20),
        make_frustum(60, 58, 20),
    )
    rings = measure_solid(flat_frustum, ring_cos)
    assert rings.steep_top_mm2 == pytest.approx(60.0**2 - (60 - 40 * np.tan(np.radians(15))) ** 2)
    assert rings.ring_mm2 == pytest.approx(rings.steep_top_mm2 / np.tan(np.radians(15)))
    assert measure_solid(steep_frustum, ring_cos).ring_mm2 == 0.0
    assert measure_contours(make_mesh(flat_frustum), POSE_ROTATIONS[5][2], 0.7, ring_cos).ring_mm2 == 0.0
