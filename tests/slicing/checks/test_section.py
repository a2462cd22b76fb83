"""Sections of closed meshes: area, length and moments compared with known values."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from slicing.checks.section import cut_sections, measure_rings


def compute_sections(mesh, z_mm):
    return measure_rings(cut_sections(np.asarray(mesh.triangles, float), z_mm), len(z_mm))


def test_section_of_a_box_with_a_hole_has_its_area_length_and_moment():
    box = trimesh.creation.box((40, 30, 10))
    hole = trimesh.creation.box((10, 10, 20), trimesh.transformations.translation_matrix((5, 0, 0)))
    result = compute_sections(trimesh.boolean.difference([box, hole]), np.array([-9.0, -2.0, 0.0, 3.0]))
    assert result.area_mm2 == pytest.approx([0, 1100, 1100, 1100])
    assert result.length_mm == pytest.approx([0, 180, 180, 180])
    assert result.moment_mm3[1] == pytest.approx([-500, 0])


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000), st.floats(-20, 20), st.floats(-20, 20))
def test_sections_add_up_to_the_volume_and_centre_of_mass(seed, x_mm, y_mm):
    rng = np.random.default_rng(seed)
    mesh = trimesh.convex.convex_hull(rng.uniform(-10, 10, (12, 3)))
    mesh.apply_translation((x_mm, y_mm, 0))
    step_mm = np.ptp(mesh.bounds[:, 2]) / 400
    z_mm = np.arange(mesh.bounds[0, 2] + step_mm / 2, mesh.bounds[1, 2], step_mm)
    result = compute_sections(mesh, z_mm)
    assert result.area_mm2.sum() * step_mm == pytest.approx(mesh.volume, rel=2e-3)
    centre = result.moment_mm3.sum(axis=0) / result.area_mm2.sum()
    assert centre == pytest.approx(mesh.center_mass[:2], abs=0.02)
    assert (result.area_mm2 >= 0).all()


def test_plane_through_corners_leaves_closed_rings():
    mesh = trimesh.creation.icosphere(2, 10)
    for z_mm in np.unique(mesh.vertices[:, 2].round(12))[1:-1]:
        pieces = list(cut_sections(np.asarray(mesh.triangles, float), np.array([z_mm])))
        start = np.concatenate([piece[1] for piece in pieces])
        end = np.concatenate([piece[2] for piece in pieces])
        is_long = (start != end).any(axis=1)
        assert sorted(map(tuple, start[is_long])) == sorted(map(tuple, end[is_long]))
