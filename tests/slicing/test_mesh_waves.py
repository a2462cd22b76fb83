"""A mesh with waves is the same part, and CuraEngine keeps its corners."""

import numpy as np
import pytest
import trimesh

from slicing.mesh_waves import STEPS_MM, WAVE_MM, add_waves
from slicing.plate import slice_plate
from slicing.stl import read_triangles, write_triangles


def slab(low, high, height):
    """A block that widens from its foot to its top."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) / 2.0
    points = [(*(corner * size), z) for size, z in ((low, 0.0), (high, height)) for corner in corners]
    return trimesh.convex.convex_hull(np.array(points))


def merged(corners):
    return trimesh.Trimesh(corners.reshape(-1, 3), np.arange(len(corners) * 3).reshape(-1, 3), process=True)


@pytest.mark.parametrize(
    "mesh", [trimesh.creation.icosphere(2, 60.0), slab((100.0, 80.0), (90.0, 85.0), 40.0)]
)
def test_the_same_part_but_for_hundredths_of_a_mm(mesh):
    new = merged(read_triangles(write_triangles(add_waves(np.asarray(mesh.triangles)))))
    assert new.is_watertight
    assert new.volume == pytest.approx(mesh.volume, rel=2e-4)
    assert new.bounds == pytest.approx(mesh.bounds, abs=1.01 * WAVE_MM)
    _, away_mm, _ = trimesh.proximity.closest_point_naive(mesh, new.vertices[:200])
    assert away_mm.max() <= 1.01 * np.hypot(WAVE_MM, WAVE_MM)


def test_what_turns_lies_on_the_crests():
    """So that a flat side is straight from crest to trough, and no longer."""
    block = trimesh.creation.box((130.0, 40.0, 10.0))
    new = merged(add_waves(np.asarray(block.triangles)))
    front = new.vertices[np.abs(new.vertices[:, 1] + 20.0) < 0.1]
    xs = np.unique(front[:, 0].round(1))
    assert np.diff(xs).max() <= STEPS_MM[0] + 0.1
    depths = [front[np.abs(front[:, 0] - x) < 0.1][:, 1].mean() for x in xs[1:-1]]
    assert np.ptp(depths) == pytest.approx(WAVE_MM, rel=0.01)


def test_a_slowly_widening_part_keeps_its_corners(request_for, settings_of):
    """Its outer walls multiply to 2**32 um2 in some layer, however much it is grown."""
    settings = settings_of(infill_sparse_density="0", layer_height=0.1)
    request = request_for(slab((84.6, 51.0), (85.4, 51.3), 42.0), settings=settings)
    result = slice_plate(request)
    assert result.unprinted == ()
    assert result.height_mm == pytest.approx(42.0, abs=0.11)
