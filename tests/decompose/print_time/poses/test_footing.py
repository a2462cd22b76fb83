"""Footing of a part on the bed, and its brim."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from decompose.geometry import Solid
from decompose.print_time.poses.footing import FIRST_LAYER_MIDDLE_MM, Footing

NO_SUPPORTS_MM = np.zeros((0, 2))


def measure_footing(solid: Solid) -> Footing:
    vertices, faces = solid.arrays()
    return Footing.from_mesh(vertices[faces], NO_SUPPORTS_MM)


def measure_box(width_mm: float, depth_mm: float, height_mm: float) -> Footing:
    return measure_footing(Solid.box((0, 0, 0), (width_mm, depth_mm, height_mm)))


def test_footing_of_a_block_is_its_base() -> None:
    result = measure_box(30, 20, 10)
    assert result.contact_mm2 == pytest.approx(600.0)
    assert result.hydraulic_diameter_mm == pytest.approx(4 * 600 / 100)
    assert (result.width_mm, result.length_mm) == pytest.approx((20.0, math.hypot(30, 20)))
    assert result.sharp_corner_count == 4
    assert result.measure_margins_mm(np.array([[15.0, 10.0], [3.0, 10.0]])) == pytest.approx([10.0, 3.0])
    assert result.measure_margins_mm(np.array([[-2.0, 10.0]]))[0] == pytest.approx(-2.0)


def test_ball_touches_where_its_first_layer_is_cut() -> None:
    mesh = trimesh.creation.icosphere(5, 20.0)
    mesh.apply_translation([0, 0, 20])
    result = measure_footing(Solid.from_arrays(mesh.vertices, mesh.faces))
    assert result.contact_mm2 == pytest.approx(math.pi * (400 - (20 - FIRST_LAYER_MIDDLE_MM) ** 2), rel=0.1)
    assert result.sharp_corner_count == 0


def test_legs_stand_on_thin_walls_but_on_a_wide_base() -> None:
    legs = [Solid.box((x, y, 0), (x + 5, y + 5, 40)) for x in (0, 55) for y in (0, 35)]
    result = measure_footing(Solid.union([*legs, Solid.box((0, 0, 40), (60, 40, 45))]))
    assert result.contact_mm2 == pytest.approx(100.0)
    assert result.hydraulic_diameter_mm == pytest.approx(5.0)
    assert result.width_mm == pytest.approx(40.0)
    assert result.choose_brim_width_mm(45.0, 5.0, 8.0) == pytest.approx(6.0)


def test_supports_widen_the_base() -> None:
    vertices, faces = Solid.box((0, 0, 0), (10, 10, 50)).arrays()
    result = Footing.from_mesh(vertices[faces], np.array([[40.0, 5.0]]))
    assert result.contact_mm2 == pytest.approx(100.0)
    assert result.length_mm == pytest.approx(math.hypot(10, 10))  # a support does not curl up
    assert result.measure_margins_mm(np.array([[20.0, 5.0]]))[0] > 0.0


def test_footing_of_an_edge_is_empty() -> None:
    mesh = trimesh.creation.box((10, 10, 10))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 4, [1, 0, 0]))
    mesh.apply_translation([0, 0, math.sqrt(50.0)])
    result = measure_footing(Solid.from_arrays(mesh.vertices, mesh.faces))
    assert result.contact_mm2 == pytest.approx(2 * FIRST_LAYER_MIDDLE_MM * 10.0)
    assert (
        Footing.from_mesh(np.zeros((0, 3, 3)), NO_SUPPORTS_MM).measure_margins_mm(np.zeros((1, 2)))[0]
        == -math.inf
    )


def test_brim_depends_on_width_height_and_size() -> None:
    assert measure_box(40, 40, 20).choose_brim_width_mm(20.0, 5.0, 8.0) == 0.0
    assert measure_box(40, 10, 100).choose_brim_width_mm(100.0, 5.0, 8.0) == 8.0  # a tall plate
    assert measure_box(8, 8, 8).choose_brim_width_mm(8.0, 5.0, 8.0) > 5.0  # little contact with the bed
    assert measure_box(120, 40, 20).choose_brim_width_mm(20.0, 5.0, 8.0) == 8.0  # a long part would curl up
    # The brim is narrower if the material shrinks less.
    assert measure_box(120, 40, 20).choose_brim_width_mm(20.0, 5.0, 8.0, 0.002) < 2.5
    # The centre of mass is beside the footing.
    assert measure_box(40, 40, 20).choose_brim_width_mm(20.0, -0.1, 8.0) == 8.0
    disc = trimesh.creation.cylinder(60.0, 10.0, sections=64)
    disc.apply_translation([0, 0, 5])
    round_footing = measure_footing(Solid.from_arrays(disc.vertices, disc.faces))
    assert 0.0 < round_footing.choose_brim_width_mm(10.0, 5.0, 8.0) < 8.0  # it is as long, but has no corners


def test_chamfered_corner_is_sharp_but_a_rounded_one_is_not() -> None:
    def measure_block(corner_mm: float) -> Footing:
        corners = [
            (x + s * a, y + t * b)
            for x, s in ((0, 1), (80, -1))
            for y, t in ((0, 1), (30, -1))
            for a, b in ((0.0, corner_mm), (corner_mm, 0.0))
        ]
        hull = trimesh.convex.convex_hull([(x, y, z) for x, y in corners for z in (0.0, 10.0)])
        return measure_footing(Solid.from_arrays(hull.vertices, hull.faces))

    assert measure_block(0.2).sharp_corner_count == 4
    assert measure_block(8.0).sharp_corner_count == 0
    rounded_mm, sharp_mm = (
        measure_block(corner_mm).choose_brim_width_mm(10.0, 5.0, 8.0) for corner_mm in (8.0, 0.2)
    )
    assert rounded_mm < sharp_mm


def test_first_layer_is_narrowed_at_joints_but_not_at_thin_walls() -> None:
    assert measure_box(20, 20, 20).choose_expansion_mm(is_joined=True) == -0.2
    assert measure_box(20, 20, 20).choose_expansion_mm(is_joined=False) == 0.0
    assert measure_box(80, 0.9, 20).choose_expansion_mm(is_joined=True) == 0.0


sizes_mm = st.floats(1.0, 150.0)


@given(sizes_mm, sizes_mm, sizes_mm, st.floats(0.0, 10.0))
def test_brim_is_never_wider_than_the_maximum_and_grows_with_height(
    width_mm: float, depth_mm: float, height_mm: float, max_mm: float
) -> None:
    result = measure_box(width_mm, depth_mm, height_mm)
    brims_mm = [result.choose_brim_width_mm(ratio * height_mm, 5.0, max_mm) for ratio in (1, 2, 4)]
    assert brims_mm == sorted(brims_mm)
    assert all(0.0 <= brim_mm <= max_mm for brim_mm in brims_mm)
