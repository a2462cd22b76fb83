"""Triangles of an STL file: reading, refusal, and the waves that make CuraEngine keep all corners."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from slicing.errors import Rule, SliceRejected
from slicing.mesh import HALF_PERIODS_MM, WAVE_HEIGHT_MM, add_waves, read_triangles, write_triangles
from slicing.plate import slice_plate


def test_stl_of_trimesh_is_read(cube_20):
    triangles = read_triangles(cube_20.export(file_type="stl"))
    assert triangles.shape == (12, 3, 3)
    assert (triangles.min(), triangles.max()) == (-10.0, 10.0)
    assert (read_triangles(write_triangles(triangles)) == triangles).all()


@pytest.mark.parametrize("length", [slice(0), slice(50), slice(84), slice(-25), slice(300)])
def test_truncated_files_are_refused(cube_20, length):
    with pytest.raises(SliceRejected) as error:
        read_triangles(cube_20.export(file_type="stl")[length])
    assert error.value.rule is Rule.BROKEN_MESH


def test_stl_with_nan_is_refused(cube_20):
    stl = bytearray(cube_20.export(file_type="stl"))
    stl[96:100] = np.float32("nan").tobytes()
    with pytest.raises(SliceRejected, match="finite"):
        read_triangles(bytes(stl))


@given(st.binary(max_size=400))
def test_any_bytes_are_read_or_refused(content):
    try:
        assert len(read_triangles(content)) > 0
    except SliceRejected as error:
        assert error.rule is Rule.BROKEN_MESH


def make_slab(low_mm, high_mm, height_mm):
    """Make a block whose section changes linearly from its bottom to its top."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2.0
    points = [
        (*(corner * size), z) for size, z in ((low_mm, 0.0), (high_mm, height_mm)) for corner in corners
    ]
    return trimesh.convex.convex_hull(np.array(points))


def merge_corners(corners):
    return trimesh.Trimesh(corners.reshape(-1, 3), np.arange(len(corners) * 3).reshape(-1, 3), process=True)


@pytest.mark.parametrize(
    "mesh", [trimesh.creation.icosphere(2, 60.0), make_slab((100.0, 80.0), (90.0, 85.0), 40.0)]
)
def test_wavy_part_differs_by_hundredths_of_a_mm_at_most(mesh):
    wavy_mesh = merge_corners(read_triangles(write_triangles(add_waves(np.asarray(mesh.triangles)))))
    assert wavy_mesh.is_watertight
    assert wavy_mesh.volume == pytest.approx(mesh.volume, rel=2e-4)
    assert wavy_mesh.bounds == pytest.approx(mesh.bounds, abs=1.01 * WAVE_HEIGHT_MM)
    _, distances_mm, _ = trimesh.proximity.closest_point_naive(mesh, wavy_mesh.vertices[:200])
    assert distances_mm.max() <= 1.01 * np.hypot(WAVE_HEIGHT_MM, WAVE_HEIGHT_MM)


def test_corners_of_a_wavy_part_lie_on_the_crests():
    """Check that flat sides stay straight between crest and trough."""
    block = trimesh.creation.box((130.0, 40.0, 10.0))
    wavy_mesh = merge_corners(add_waves(np.asarray(block.triangles)))
    front_vertices = wavy_mesh.vertices[np.abs(wavy_mesh.vertices[:, 1] + 20.0) < 0.1]
    xs_mm = np.unique(front_vertices[:, 0].round(1))
    assert np.diff(xs_mm).max() <= HALF_PERIODS_MM[0] + 0.1
    depths_mm = [front_vertices[np.abs(front_vertices[:, 0] - x) < 0.1][:, 1].mean() for x in xs_mm[1:-1]]
    assert np.ptp(depths_mm) == pytest.approx(WAVE_HEIGHT_MM, rel=0.01)


def test_slowly_widening_part_keeps_its_corners(make_request, make_settings):
    """Use a part whose wall lengths multiply to 2**32 um2 in some layer of every variant."""
    settings = make_settings(infill_sparse_density="0", layer_height=0.1)
    request = make_request(make_slab((84.6, 51.0), (85.4, 51.3), 42.0), settings=settings)
    result = slice_plate(request)
    assert result.unprinted_walls == ()
    assert result.height_mm == pytest.approx(42.0, abs=0.11)
