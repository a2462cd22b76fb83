"""Solids: boxes, cuts by planes, pieces and simplified copies."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.errors import ModelNotSolid
from decompose.geometry import Solid


def test_box_has_exactly_its_corners() -> None:
    box = Solid.box((0.1, -0.2, 1 / 3), (1.1, 5.0, 7.7))
    assert box.bounds_mm.tolist() == [[0.1, -0.2, 1 / 3], [1.1, 5.0, 7.7]]
    assert box.volume_mm3 == pytest.approx(1.0 * 5.2 * (7.7 - 1 / 3))


def test_open_surface_is_refused() -> None:
    vertices, faces = Solid.box((0, 0, 0), (1, 1, 1)).arrays()
    with pytest.raises(ModelNotSolid, match="bound no solid"):
        Solid.from_arrays(vertices, faces[1:])


@settings(max_examples=15, deadline=None)
@given(axis=st.integers(0, 2), at_mm=st.floats(-24.0, 39.0))
def test_split_keeps_the_volume_and_divides_at_the_plane(
    ring_with_bar: Solid, axis: int, at_mm: float
) -> None:
    below, above = ring_with_bar.split(axis, at_mm)
    assert below.volume_mm3 + above.volume_mm3 == pytest.approx(ring_with_bar.volume_mm3, rel=1e-9)
    if not below.is_empty:
        assert below.bounds_mm[1, axis] <= at_mm + 1e-9
    if not above.is_empty:
        assert above.bounds_mm[0, axis] >= at_mm - 1e-9


def test_pieces_are_sorted_by_position() -> None:
    separate_boxes = Solid.union([Solid.box((5, 0, 0), (6, 1, 1)), Solid.box((0, 0, 0), (1, 1, 1))])
    assert [p.bounds_mm[0, 0] for p in separate_boxes.list_pieces()] == [0.0, 5.0]
    assert Solid.box((0, 0, 0), (1, 1, 1)).clip((3, 3, 3), (4, 4, 4)).list_pieces() == []


def test_cavity_belongs_to_the_piece_around_it() -> None:
    shell = Solid.box((0, 0, 0), (10, 10, 10)).subtract(Solid.box((2, 2, 2), (8, 8, 8)))
    inner = Solid.box((3, 3, 3), (7, 7, 7)).subtract(Solid.box((4, 4, 4), (6, 6, 6)))
    assert [p.volume_mm3 for p in shell.list_pieces()] == pytest.approx([1000.0 - 216.0])
    bodies = Solid.union([shell, inner, Solid.box((20, 0, 0), (21, 1, 1))])
    assert [p.volume_mm3 for p in bodies.list_pieces()] == pytest.approx([1000.0 - 216.0, 64.0 - 8.0, 1.0])


def test_simplify_removes_short_edges_only() -> None:
    box = Solid.box((0, 0, 0), (10, 10, 10))
    notched_box = Solid.union([box, Solid.box((4, 4, 9), (4.000001, 4.000001, 10.000001))])
    simplified_box = notched_box.simplify(1e-4)
    assert simplified_box.volume_mm3 == pytest.approx(1000.0, rel=1e-6)
    assert len(simplified_box.arrays()[1]) <= len(notched_box.arrays()[1])
    assert np.isfinite(simplified_box.arrays()[0]).all()


def test_parts_of_a_simplified_solid_have_its_whole_surface() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=50.0)
    roughness = np.random.default_rng(0).normal(0.0, 0.001, len(ball.vertices))
    rough_solid = Solid.from_arrays(ball.vertices * (1.0 + roughness)[:, None], ball.faces)
    solid = rough_solid.simplify(0.2)
    upper, lower = solid.clip((-60, -60, 10), (60, 60, 60)), solid.clip((-60, -60, -60), (60, 60, 10))
    cut_mm2 = sum(_measure_level_faces_mm2(half, 10.0) for half in (upper, lower))
    assert solid.face_count < rough_solid.face_count
    assert upper.area_mm2 + lower.area_mm2 - cut_mm2 == pytest.approx(solid.area_mm2, rel=1e-9)


def _measure_level_faces_mm2(solid: Solid, z_mm: float) -> float:
    """Measure the area of the faces at a height."""
    vertices, faces = solid.arrays()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    is_level = (np.abs(mesh.triangles[:, :, 2] - z_mm) < 1e-7).all(axis=1)
    return float(mesh.area_faces[is_level].sum())


def test_solid_is_cut_off_above_a_plane() -> None:
    box = Solid.box((0, 0, 0), (10, 20, 30))
    normal = np.array([0.0, 0.0, 1.0])
    assert box.keep_below(normal, 12.0).bounds_mm == pytest.approx(np.array([[0, 0, 0], [10, 20, 12]]))
    assert box.keep_below(-normal, -12.0).bounds_mm == pytest.approx(np.array([[0, 0, 12], [10, 20, 30]]))
    assert box.keep_below(normal, -1.0).is_empty
    assert box.subtract(box).keep_below(normal, 12.0).is_empty
