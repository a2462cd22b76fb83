"""Orientation of parts on the bed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from decompose.decompose import decompose_model
from decompose.export import write_decomposition
from decompose.geometry import Model, Solid
from decompose.options import Options
from decompose.print_time import (
    POSE_ROTATIONS,
    CostModel,
    Pose,
    PrintTimeSettings,
    find_best_pose,
    measure_pose,
)
from decompose.print_time.poses.rotations import build_hull, list_directions
from decompose.printers import TargetPrinter

COST = CostModel.from_settings(PrintTimeSettings())
PRINTER = TargetPrinter("p", ((200.0, 190.0, 200.0),))
ROTATION = Rotation.from_euler("xyz", [25.0, -40.0, 70.0], degrees=True).as_matrix()
EDGE_ROTATION = Rotation.from_euler("x", 45.0, degrees=True).as_matrix()
NO_CUTS = np.zeros(0, dtype=np.bool_)


def rotate_solid(solid: Solid, rotation: npt.NDArray[np.float64] = ROTATION) -> Solid:
    vertices, faces = solid.arrays()
    return Solid.from_arrays(vertices @ rotation.T, faces)


def find_pose(
    solid: Solid, printer: TargetPrinter = PRINTER, is_cut: npt.NDArray[np.bool_] = NO_CUTS
) -> Pose:
    vertices, faces = solid.arrays()
    pose = find_best_pose(
        vertices, faces, is_cut if len(is_cut) else np.zeros(len(faces), np.bool_), [printer], COST
    )
    assert pose is not None
    assert printer.fits(*pose.size_mm)
    return pose


def find_up_axis(pose: Pose) -> npt.NDArray[np.float64]:
    return pose.to_model[:3, 2]


def make_arch() -> Solid:
    hole = trimesh.creation.cylinder(20.0, 60.0, sections=48)
    hole.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return Solid.box((-35, -15, 0), (35, 15, 40)).subtract(Solid.from_arrays(hole.vertices, hole.faces))


def make_tee() -> Solid:
    return Solid.union([Solid.box((-5, -15, 0), (5, 15, 40)), Solid.box((-30, -15, 40), (30, 15, 50))])


def make_spool() -> Solid:
    """Make a post between a small slab below and a large one above."""
    return Solid.union(
        [
            Solid.box((-15, -15, 0), (15, 15, 5)),
            Solid.box((-5, -5, 0), (5, 5, 60)),
            Solid.box((-25, -25, 55), (25, 25, 60)),
        ]
    )


def make_inverted_pyramid() -> Solid:
    corners = np.array([(0, 0, 0), (25, 25, 40), (-25, 25, 40), (-25, -25, 40), (25, -25, 40)], float)
    hull = trimesh.convex.convex_hull(corners)
    return Solid.from_arrays(hull.vertices, hull.faces)


def test_tilted_block_is_laid_flat() -> None:
    pose = find_pose(rotate_solid(Solid.box((0, 0, 0), (70, 50, 12))))
    assert sorted(pose.size_mm) == pytest.approx([12.0, 50.0, 70.0], abs=1e-6)
    assert pose.stands
    assert pose.support_mm3 == 0.0
    assert pose.footing.contact_mm2 == pytest.approx(np.prod(pose.size_mm[:2]), rel=1e-6)


@pytest.mark.parametrize("solid", [make_arch(), make_tee()])
def test_pose_without_support_is_preferred(solid: Solid) -> None:
    pose = find_pose(solid)
    assert pose.stands
    assert pose.support_mm3 == 0.0
    unrotated_pose = measure_pose(
        *solid.arrays(), np.zeros(len(solid.arrays()[1]), np.bool_), POSE_ROTATIONS[4], COST
    )
    assert pose.price_s < unrotated_pose.price_s


def test_pyramid_is_turned_over() -> None:
    pose = find_pose(make_inverted_pyramid())
    assert pose.stands
    assert pose.support_mm3 == 0.0
    assert pose.footing.contact_mm2 > 1000.0  # on its base or on a side


@pytest.mark.parametrize("size_mm", [(100.0, 2.0, 100.0), (3.0, 3.0, 150.0)])
def test_thin_part_is_laid_down_or_gets_a_brim(size_mm: tuple[float, ...]) -> None:
    solid = Solid.box((0, 0, 0), size_mm)
    lying_pose = find_pose(solid)
    assert lying_pose.stands
    assert lying_pose.size_mm[2] == pytest.approx(min(size_mm))
    narrow_printer = TargetPrinter("narrow", ((110.0, 20.0, 200.0),))
    upright_pose = find_pose(solid, narrow_printer)
    assert upright_pose.size_mm[2] >= 100.0
    assert upright_pose.brim_width_mm == pytest.approx(COST.brim_mm, abs=0.1)


def test_edge_is_not_used_as_footing() -> None:
    vertices, faces = rotate_solid(Solid.box((0, 0, 0), (60, 30, 30)), EDGE_ROTATION).arrays()
    pose = measure_pose(vertices, faces, np.zeros(len(faces), np.bool_), np.eye(3), COST)
    assert pose.footing.contact_mm2 > 10.0  # narrower than a line, and as long as the block
    assert not pose.stands


def test_rotating_the_model_rotates_the_pose() -> None:
    solid = Solid.union([make_tee(), Solid.box((-5, -15, 0), (20, 10, 8))])
    pose, rotated_pose = find_pose(solid), find_pose(rotate_solid(solid))
    assert rotated_pose.price_s == pytest.approx(pose.price_s, rel=0.01)
    assert find_up_axis(rotated_pose) == pytest.approx(ROTATION @ find_up_axis(pose), abs=1e-6)
    assert sorted(rotated_pose.size_mm) == pytest.approx(sorted(pose.size_mm), abs=1e-6)


def mark_inner_faces(solid: Solid) -> npt.NDArray[np.bool_]:
    """Mark the faces of the spool's slabs that face the post."""
    vertices, faces = solid.arrays()
    z = vertices[faces][:, :, 2]
    return np.asarray(np.isclose(z, 5.0).all(axis=1) | np.isclose(z, 55.0).all(axis=1))


def test_no_support_touches_a_cut_face_where_another_pose_fits() -> None:
    solid = make_spool()
    is_cut = mark_inner_faces(solid)
    low_printer = TargetPrinter("p", ((51.0, 51.0, 61.0),))
    assert find_pose(solid, low_printer, is_cut).touched_mm2 > 0.0
    free_pose = find_pose(solid, PRINTER, is_cut)
    assert free_pose.touched_mm2 <= 1.0
    assert abs(find_up_axis(free_pose)[2]) < 0.9


def test_pose_with_the_least_support_on_cut_faces_is_preferred() -> None:
    """Check that support touches at most the area of the small slab on the large one."""
    solid = make_spool()
    is_cut = mark_inner_faces(solid)
    pose = find_pose(solid, TargetPrinter("p", ((51.0, 51.0, 61.0),)), is_cut)
    assert find_up_axis(pose) == pytest.approx([0.0, 0.0, -1.0])
    assert pose.touched_mm2 == pytest.approx(2 * (30 * 30 - 10 * 10), rel=0.05)


def test_first_layer_is_narrowed_at_a_cut_face() -> None:
    vertices, faces = Solid.box((0, 0, 0), (40, 40, 20)).arrays()
    is_cut = np.isclose(vertices[faces][:, :, 0], 40.0).all(axis=1)
    for is_marked, expansion_mm in ((is_cut, -0.2), (~is_cut & is_cut, 0.0)):
        pose = measure_pose(vertices, faces, is_marked, POSE_ROTATIONS[4], COST)
        assert pose.layer_0_expansion_mm == expansion_mm
        default_pose = measure_pose(
            vertices, faces, is_marked, POSE_ROTATIONS[4], COST, fit_first_layer=False
        )
        assert default_pose.layer_0_expansion_mm is default_pose.brim_width_mm is None
        assert default_pose.price_s > pose.price_s  # it includes the brim of the quality


def test_long_bar_lies_diagonally_on_the_bed() -> None:
    pose = find_pose(Solid.box((0, 0, 0), (230, 6, 6)), TargetPrinter("p", ((190.0, 190.0, 50.0),)))
    assert pose.size_mm[2] == pytest.approx(6.0)


def test_part_without_a_fitting_pose_is_reported() -> None:
    vertices, faces = Solid.box((0, 0, 0), (300, 300, 300)).arrays()
    assert find_best_pose(vertices, faces, np.zeros(len(faces), np.bool_), [PRINTER], COST) is None


def test_flat_sides_are_candidates_in_any_orientation() -> None:
    solid = rotate_solid(make_inverted_pyramid())
    vertices, faces = solid.arrays()
    up_axes = list_directions(vertices, faces, build_hull(vertices))
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert ((-normals @ up_axes.T).max(axis=1) > 1.0 - 1e-6).all()


@settings(max_examples=25, deadline=None)
@given(arrays(np.float64, (12, 3), elements=st.floats(-40.0, 40.0), unique=True))
def test_convex_part_is_stable_and_fits(points: npt.NDArray[np.float64]) -> None:
    """Use points around a core of 20 mm, so that the part is not a needle."""
    core = trimesh.creation.box((20.0, 20.0, 20.0)).vertices
    hull = trimesh.convex.convex_hull(np.vstack([points, core]))
    pose = find_pose(Solid.from_arrays(hull.vertices, hull.faces))
    assert pose.stands
    assert pose.support_mm3 >= 0.0
    centre_mm = (hull.center_mass - pose.to_model[:3, 3]) @ pose.to_model[:3, :3]
    assert pose.footing.measure_margins_mm(centre_mm[None, :2])[0] >= -COST.brim_mm / 2.0 - 0.5


def test_part_that_lies_on_a_slanting_side_is_written_flat_and_closed(tmp_path: Path) -> None:
    """Check that corners at the bed are at 0 after rounding to single precision."""
    solid = rotate_solid(Solid.box((0, 0, 0), (61.7, 47.3, 13.1)))
    model = Model(Solid.from_arrays(solid.arrays()[0].astype(np.float32), solid.arrays()[1]), (), 1.0)
    result = write_decomposition(decompose_model(model, [PRINTER], Options(granularity=3), COST), tmp_path)
    (part,) = result.parts
    mesh = trimesh.load_mesh(tmp_path / part.file)
    assert mesh.is_watertight
    assert mesh.bounds[0, 2] == 0.0
    is_on_bed = (mesh.triangles[:, :, 2] == 0.0).all(axis=1)
    assert mesh.area_faces[is_on_bed].sum() == pytest.approx(np.prod(mesh.extents[:2]), rel=1e-4)
    model_mesh = mesh.apply_transform(part.to_model)
    assert model_mesh.bounds == pytest.approx(model.solid.bounds_mm, abs=1e-3)


@pytest.mark.parametrize(
    ("angle_deg", "slope_mm", "is_supported"),
    [(53.0, 3.5, False), (53.0, 4.5, True), (58.0, 3.5, True), (45.0, 20.0, False)],
)
def test_small_overhang_has_no_price(angle_deg: float, slope_mm: float, is_supported: bool) -> None:
    """Pose a block 10 mm wide with an overhang at its side, of an angle and a length along its slope."""
    x_mm, z_mm = slope_mm * np.sin(np.radians(angle_deg)), slope_mm * np.cos(np.radians(angle_deg))
    outline_mm = np.array([(0, 0), (60, 0), (60, 40 - z_mm), (60 + x_mm, 40), (0, 40)])
    corners = [(x, y, z) for y in (0.0, 10.0) for x, z in outline_mm]
    sides = [(i, (i + 1) % 5, (i + 1) % 5 + 5, i + 5) for i in range(5)]
    faces = [(0, 2, 1), (0, 3, 2), (0, 4, 3), (5, 6, 7), (5, 7, 8), (5, 8, 9)]
    faces += [triangle for a, b, c, d in sides for triangle in ((a, b, c), (a, c, d))]
    mesh = trimesh.Trimesh(corners, faces)
    assert mesh.is_watertight
    mesh.fix_normals()
    vertices, face_array = mesh.vertices.astype(float), mesh.faces.astype(np.int64)
    time_settings = PrintTimeSettings(
        support_angle_deg=50.0, small_overhang_deg=55.0, small_overhang_mm2=40.0
    )
    cost, plain_cost = map(
        CostModel.from_settings, (time_settings, PrintTimeSettings(support_angle_deg=50.0))
    )
    no_cuts = np.zeros(len(face_array), np.bool_)
    pose, plain_pose = (
        measure_pose(vertices, face_array, no_cuts, np.eye(3), model) for model in (cost, plain_cost)
    )
    assert (pose.support_mm3 > 0.0) == is_supported
    assert (plain_pose.support_mm3 > 0.0) == (angle_deg > 50.0)
    assert (pose.price_s < plain_pose.price_s) == (angle_deg > 50.0 and not is_supported)
