"""Repair of open and intersecting surfaces, which are closed without moving vertices, or refused."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.errors import ModelNotSolid
from decompose.geometry import Solid, load_model, shells
from decompose.geometry.repair import close_surface
from decompose.geometry.weld import weld_triangles

MODELS = Path(os.environ.get("FARM_MODELS", Path(__file__).parents[3] / "shared" / "models"))


def make_block(lo: tuple[float, ...], hi: tuple[float, ...]) -> np.ndarray:
    vertices, faces = Solid.box(lo, hi).arrays()
    return vertices[faces]


def join_corners(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of triangles, with common corners joined."""
    vertices, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, faces.reshape(-1, 3)


def remove_lid(triangles: np.ndarray, axis: int, at_mm: float) -> np.ndarray:
    """Remove the triangles that lie in an axis plane."""
    return triangles[~(np.abs(triangles[:, :, axis] - at_mm) < 1e-9).all(axis=1)]


@pytest.mark.parametrize(
    ("corner", "piece_count"),
    [((20.0, 0.0, 0.0), 1), ((20.0, 20.0, 0.0), 2), ((20.0, 20.0, 20.0), 2), ((20.0, 10.0, 0.0), 1)],
    ids=["face", "edge", "corner", "half a face"],
)
def test_touching_bodies_are_separated(corner: tuple[float, ...], piece_count: int) -> None:
    other_corner = tuple(20.0 + w for w in corner)
    bodies = np.concatenate([make_block((0, 0, 0), (20, 20, 20)), make_block(corner, other_corner)])
    solid, _ = close_surface("two", weld_triangles(bodies))
    assert solid.volume_mm3 == pytest.approx(16_000.0)
    assert len(solid.list_pieces()) == piece_count


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, max_size=12, unique=True), st.data())
def test_touching_cubes_of_a_lattice_are_united(
    positions: list[tuple[int, int, int]], data: st.DataObject
) -> None:
    """Use cubes that share faces, edges and corners, some of them inside out."""
    cubes = [
        make_block(tuple(10.0 * p for p in position), tuple(10.0 * p + 10.0 for p in position))
        for position in positions
    ]
    order = data.draw(st.permutations(range(12 * len(cubes))))
    solid, _ = close_surface("lattice", weld_triangles(np.concatenate(cubes)[list(order)]))
    assert solid.volume_mm3 == pytest.approx(1000.0 * len(positions))


def make_overlapping_blocks() -> np.ndarray:
    """Make two blocks that overlap slightly and share an edge of four triangles; no edge is open."""
    overlap_mm = 0.01
    first_body, second_body = (
        make_block((0, 0, 0), (20, 20, 20)),
        make_block((20 - overlap_mm, 0, 0), (40, 30, 20)),
    )
    # Move two corners, so that the side between them and the others intersects the first block.
    second_body[(second_body[..., 0] < 20) & (second_body[..., 1] == 0.0), 0] = 20.0
    return np.concatenate([first_body, second_body])


def test_overlapping_bodies_with_a_common_edge_are_united() -> None:
    """Use a closed mesh in which solid and air do not alternate around the shared edge."""
    triangles = make_overlapping_blocks()
    solid, repairs = close_surface("hair", weld_triangles(triangles))
    first_body, second_body = (Solid.from_arrays(*join_corners(item)) for item in np.split(triangles, 2))
    assert solid.volume_mm3 == pytest.approx(Solid.union([first_body, second_body]).volume_mm3, rel=1e-9)
    sentence = "Separated bodies that touch or overlap (1 edges shared by more than two triangles)."
    assert repairs[0] == sentence


def test_inverted_body_is_separated_from_one_that_it_touches() -> None:
    cubes = [make_block((0, 0, 0), (20, 20, 20)), make_block((20, 20, 0), (40, 40, 20))[:, ::-1]]
    solid, repairs = close_surface("two", weld_triangles(np.concatenate(cubes)))
    assert solid.volume_mm3 == pytest.approx(16_000.0)
    assert not any("new" in repair for repair in repairs)


@pytest.mark.skipif(not MODELS.is_dir(), reason="the real model files are not available")
def test_closed_model_with_edges_of_four_faces_is_not_reported_as_open() -> None:
    """Use the paper's 'Hole Pipe', whose flange overlaps the pipe slightly."""
    model = load_model(MODELS / "thingi10k-78224.stl")
    assert model.solid.volume_mm3 == pytest.approx(19_384.0, rel=1e-3)
    assert not any("open" in repair for repair in model.repairs)


def test_open_shells_that_penetrate_each_other_are_closed_and_joined() -> None:
    """Use a tube that penetrates an open box, as the handle of a mug does; MeshFix alone would drop it."""
    box = remove_lid(make_block((0, 0, 0), (100, 100, 100)), 0, 100.0)
    tube = remove_lid(remove_lid(make_block((-60, 40, 40), (20, 60, 60)), 0, -60.0), 0, 20.0)
    solid, repairs = close_surface("mug", weld_triangles(np.concatenate([box, tube])))
    assert solid.volume_mm3 == pytest.approx(1e6 + 60.0 * 400.0)
    assert solid.bounds_mm[0] == pytest.approx([-60.0, 0.0, 0.0])
    assert any("12 open edges" in r and "% of the surface is new" in r for r in repairs)


def test_open_ends_of_a_pipe_are_closed_by_rings() -> None:
    pipe = trimesh.creation.annulus(r_min=20.0, r_max=25.0, height=100.0)
    triangles = np.array(pipe.triangles)
    is_end = np.ptp(triangles[:, :, 2], axis=1) < 1e-9
    solid, _ = close_surface("pipe", weld_triangles(triangles[~is_end]))
    assert solid.volume_mm3 == pytest.approx(pipe.volume, rel=1e-6)


def test_gaps_due_to_rounding_are_welded() -> None:
    ball = trimesh.creation.icosphere(3, 50.0)
    rng = np.random.default_rng(1)
    triangles = np.array(ball.triangles) + rng.uniform(-1e-5, 1e-5, ball.triangles.shape)
    solid, repairs = close_surface("ball", weld_triangles(triangles))
    assert solid.volume_mm3 == pytest.approx(ball.volume, rel=1e-4)
    assert repairs == ["Joined vertices within 0.0001 mm of each other."]


def test_small_triangles_do_not_count_as_lost_or_new_surface() -> None:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=50.0)
    x, _, z = ball.triangles_center.T
    triangles = ball.triangles[z < 40.0 + 0.2 * x]  # the rim runs along triangles, so it is not flat
    solid, (repair,) = close_surface("ball", weld_triangles(triangles))
    assert repair.endswith(" % of the surface is new.")
    new_share = float(repair.split()[-7]) / 100.0
    open_share = 1.0 - len(triangles) / len(ball.faces)
    assert new_share == pytest.approx(open_share, rel=0.3)
    assert solid.area_mm2 < ball.area


def test_cup_without_wall_thickness_is_refused() -> None:
    """Check the refusal of a repair that would add a lid to a cup."""
    with pytest.raises(ModelNotSolid, match=r"would add 2\d %"):
        close_surface("cup", weld_triangles(remove_lid(make_block((0, 0, 0), (100, 100, 50)), 2, 50.0)))


def test_surface_that_a_repair_would_drop_is_refused() -> None:
    loose_triangle = np.array([[[50.0, 50.0, 100.0], [50.0, 250.0, 100.0], [50.0, 50.0, 250.0]]])
    with pytest.raises(ModelNotSolid, match=r"would lose \d+ %"):
        close_surface(
            "sail", weld_triangles(np.concatenate([make_block((0, 0, 0), (100, 100, 100)), loose_triangle]))
        )


def test_one_sided_surfaces_are_not_oriented() -> None:
    band = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4], [4, 5, 1], [5, 0, 1]])
    assert shells.orient_faces(band) is None


def test_holes_that_share_a_vertex_get_separate_rims() -> None:
    """Remove two opposite triangles of an octahedron's top, so that both holes share its tip."""
    corners = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], dtype=float)
    octahedron = np.array(
        [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1], [5, 2, 1], [5, 3, 2], [5, 4, 3], [5, 1, 4]]
    )
    result = shells.split_shells(corners, np.delete(octahedron, [0, 2], axis=0))
    assert result is not None
    ((vertices, faces),) = result
    assert len(vertices) == 7
    assert sorted(len(rim) for rim in shells.find_rims(faces)) == [6]
    filled_mesh = trimesh.Trimesh(
        vertices, np.concatenate([faces, shells.cap_holes(vertices, faces)]), process=False
    )
    assert filled_mesh.is_watertight and filled_mesh.is_winding_consistent


@pytest.mark.skipif(not MODELS.is_dir(), reason="the real model files are not available")
def test_repaired_teapot_keeps_all_its_parts() -> None:
    model = load_model(MODELS / "utah-teapot.obj", longest_side_mm=450.0)
    assert model.extents_mm == pytest.approx([450.0, 220.3, 279.8], abs=0.1)
    assert model.solid.volume_mm3 == pytest.approx(8.844e6, rel=1e-3)
    assert len(model.solid.list_pieces()) == 1
    assert "160 open edges" in model.repairs[0]
