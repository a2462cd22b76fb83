"""Seams: their length on the model's surface, and rims that are too thin."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.geometry import Solid
from decompose.pieces import Piece, Seam, cut_box, describe_thin_rims, find_joints, measure_seams
from decompose.pieces.seams import _build_region

LIMIT_MM = 1e3


def cut_solid_at_plane(solid: Solid, axis: int, at_mm: float) -> list[Piece]:
    lo, hi = np.full(3, -LIMIT_MM), np.full(3, LIMIT_MM)
    lower_end, upper_start = hi.copy(), lo.copy()
    lower_end[axis] = upper_start[axis] = at_mm
    return [*cut_box(solid, lo, lower_end), *cut_box(solid, upper_start, hi)]


def measure_cut_seams(pieces: list[Piece]) -> list[Seam]:
    return measure_seams(pieces, find_joints(pieces))


def test_seam_of_a_cut_bar_goes_around_it() -> None:
    [seam] = measure_cut_seams(cut_solid_at_plane(Solid.box((0, 0, 0), (60, 40, 30)), 0, 25.0))
    assert seam.length_mm == pytest.approx(2 * (40 + 30))
    assert seam.thin_length_mm == 0.0


def test_seam_is_found_beside_faces_in_the_planes_of_the_box() -> None:
    solid = Solid.box((0, 0, 0), (60, 40, 30))
    pieces = [*cut_box(solid, (0, 0, 0), (30, 40, 30)), *cut_box(solid, (30, 0, 0), (60, 40, 30))]
    [seam] = measure_cut_seams(pieces)
    assert seam.length_mm == pytest.approx(2 * (40 + 30))


def test_inner_edges_are_not_seams() -> None:
    solid = Solid.box((0, 0, 0), (60, 60, 20))
    quarters = [
        piece
        for x in (0, 30)
        for y in (0, 30)
        for piece in cut_box(solid, (x, y, -LIMIT_MM), (x + 30, y + 30, LIMIT_MM))
    ]
    seams = measure_cut_seams(quarters)
    assert len(seams) == 4
    assert sum(seam.length_mm for seam in seams) == pytest.approx(2 * (60 + 60) + 4 * 20)


def test_wedge_cut_near_its_edge_has_a_thin_rim() -> None:
    """Use a slope of 10 mm over 100 mm, whose rim at a horizontal cut is thinner than 0.8 mm for 8 mm."""
    ramp = Solid.from_arrays(*make_prism(np.array([(0, 0), (100, 0), (100, 10)])))
    [seam] = measure_cut_seams(cut_solid_at_plane(ramp, 2, 5.0))
    assert seam.length_mm == pytest.approx(2 * (50 + 40))
    assert 40 < seam.thin_length_mm < 40 + 3 * 10
    [upright_seam] = measure_cut_seams(cut_solid_at_plane(ramp, 0, 50.0))
    assert upright_seam.thin_length_mm == 0.0


def make_prism(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make a prism along y, 40 mm long, with an outline in x and z."""
    mesh = trimesh.creation.extrude_triangulation(outline.astype(float), np.array([[0, 1, 2]]), 40.0)
    return mesh.vertices[:, [0, 2, 1]] * [1, -1, 1], mesh.faces


@settings(max_examples=15, deadline=None)
@given(st.floats(-45.0, 45.0), st.integers(0, 2))
def test_seam_of_a_cut_ball_is_the_rim_of_the_cut(at_mm: float, axis: int) -> None:
    sphere = trimesh.creation.icosphere(3, 50.0)
    pieces = cut_solid_at_plane(Solid.from_arrays(sphere.vertices, sphere.faces), axis, at_mm)
    joints = find_joints(pieces)
    [seam] = measure_seams(pieces, joints)
    assert seam.length_mm == pytest.approx(joints[0].faces[0].outline.length, rel=1e-4)
    assert 0.0 <= seam.thin_length_mm <= seam.length_mm


def test_only_long_thin_rims_are_described() -> None:
    pieces = cut_solid_at_plane(Solid.box((0, 0, 0), (60, 40, 30)), 0, 25.0)
    joints = find_joints(pieces)
    assert describe_thin_rims(["p01", "p02"], joints, [Seam(100.0, 4.0)]) == ""
    assert "on 12 mm of the seams, the greatest length between p01 and p02" in describe_thin_rims(
        ["p01", "p02"], joints, [Seam(100.0, 12.0)]
    )


@pytest.mark.parametrize("spike", [[(10.0, 10.0), (10.0, 15.0)], [(10.0, 10.0), (13.0, 10.0)], []])
def test_outline_with_a_spike_bounds_the_same_area(spike: list[tuple[float, float]]) -> None:
    ring = np.array([(0.0, 0.0), (10.0, 0.0), *spike, (10.0, 10.0), (0.0, 10.0)])
    hole = np.array([(2.0, 2.0), (2.0, 4.0), (4.0, 4.0), (4.0, 2.0), (6.0, 2.0), (4.0, 2.0)])
    area = _build_region([ring, hole])
    assert area.area == pytest.approx(100.0 - 4.0)
    assert shapely.box(-5.0, -5.0, 20.0, 20.0).difference(area).area == pytest.approx(625.0 - 96.0)
