"""Faces that are hidden once parts are glued, and the skin that they save."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from decompose.geometry import Solid
from decompose.grid import GridRules, build_grid, price_boxes
from decompose.grid.box_index import find_box
from decompose.pieces import find_cut_faces
from decompose.print_time import (
    MEAN_SIDE_SHARE,
    POSE_ROTATIONS,
    CostModel,
    PartMesh,
    PrintTimeSettings,
    find_best_pose,
    measure_pose,
)
from decompose.print_time.hidden_faces import SIDE_END_MM, sum_side_ends_mm
from decompose.print_time.pose_prices import price_poses_s, sum_pose_features
from decompose.print_time.surfaces import measure_surfaces
from decompose.printers import TargetPrinter

SETTINGS = PrintTimeSettings(skin_layer_count=4.0, saved_bed_layer_count=2.0, saved_top_layer_count=1.0)
COST, PLAIN_COST = (
    CostModel.from_settings(SETTINGS),
    CostModel.from_settings(
        replace(SETTINGS, **dict.fromkeys(("saved_bed_layer_count", "saved_top_layer_count"), 0.0))
    ),
)
BLOCK = Solid.box((0.0, 0.0, 0.0), (40.0, 30.0, 20.0))
BOTTOM_PLANE, TOP_PLANE, SIDE_PLANE = (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 1.0, 20.0), (1.0, 0.0, 0.0, 40.0)
UPRIGHT_ROTATION, UPSIDE_DOWN_ROTATION = POSE_ROTATIONS[4], POSE_ROTATIONS[5]
LEANING_ROTATION = np.array(((0.8, 0.0, -0.6), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)))


def measure_block(*planes: tuple[float, ...], solid: Solid = BLOCK, rotation=UPRIGHT_ROTATION, cost=COST):
    vertices, faces = solid.arrays()
    is_cut = find_cut_faces(vertices, faces, np.array(planes).reshape(-1, 4))
    return measure_pose(vertices, faces, is_cut, rotation, cost, fit_first_layer=False)


@pytest.mark.parametrize(
    ("planes", "rotation", "is_bed_hidden", "are_tops_hidden"),
    [
        ((BOTTOM_PLANE,), UPRIGHT_ROTATION, True, False),
        ((BOTTOM_PLANE,), UPSIDE_DOWN_ROTATION, False, True),
        ((TOP_PLANE,), UPSIDE_DOWN_ROTATION, True, False),
        ((BOTTOM_PLANE, TOP_PLANE), UPRIGHT_ROTATION, True, True),
        ((SIDE_PLANE,), UPRIGHT_ROTATION, False, False),
        ((), UPRIGHT_ROTATION, False, False),
    ],
)
def test_cut_faces_on_the_bed_and_on_top_are_hidden(planes, rotation, is_bed_hidden, are_tops_hidden):
    pose = measure_block(*planes, rotation=rotation)
    assert (pose.bed_face_hidden, pose.tops_hidden) == (is_bed_hidden, are_tops_hidden)
    plain_pose = measure_block(*planes, rotation=rotation, cost=PLAIN_COST)
    assert not plain_pose.bed_face_hidden
    assert not plain_pose.tops_hidden
    # Each layer saves the skin on 1200 mm2, except for the rim under the walls, less the infill in its place.
    layer_s = 1200.0 * COST.skin_s_per_mm2 / 4.0
    assert plain_pose.price_s - pose.price_s == pytest.approx(
        (2.0 * is_bed_hidden + 1.0 * are_tops_hidden) * layer_s, rel=0.1
    )


def test_visible_top_beside_a_cut_keeps_its_skin():
    step = Solid.union([BLOCK, Solid.box((10.0, 10.0, 10.0), (20.0, 20.0, 30.0))])
    assert not measure_block(BOTTOM_PLANE, (0.0, 0.0, 1.0, 30.0), solid=step).tops_hidden
    assert measure_block(BOTTOM_PLANE, (0.0, 0.0, 1.0, 30.0), solid=step).bed_face_hidden


@pytest.mark.parametrize(
    ("top_mm", "planes", "is_visible"),
    [
        ((20.0, 20.0), (), True),
        ((20.0, 20.0), (TOP_PLANE,), False),
        ((20.0, 20.8), (), True),  # a slope of 1.1 degrees
        ((20.0, 21.7), (), False),  # 2.4 degrees
    ],
)
def test_only_flat_tops_that_are_no_cuts_stay_visible(top_mm, planes, is_visible):
    corners_mm = [
        (x, y, z) for x, top in zip((0.0, 30.0), top_mm, strict=True) for y in (0, 40) for z in (0, top)
    ]
    assert measure_block(*planes, solid=Solid.hull(np.array(corners_mm))).flat_tops_visible == is_visible


def test_small_flat_top_does_not_count():
    """Check a pyramid with a top of 9 mm on each side."""
    corners_mm = [(x, y, 0.0) for x in (0.0, 40.0) for y in (0.0, 40.0)]
    corners_mm += [(x, y, 20.0) for x in (15.0, 24.0) for y in (15.0, 24.0)]
    assert not measure_block(solid=Solid.hull(np.array(corners_mm))).flat_tops_visible


def test_foot_beside_a_cut_face_on_the_bed_is_visible():
    vertices, faces = BLOCK.arrays()
    is_cut = find_cut_faces(vertices, faces, np.array([BOTTOM_PLANE]))
    is_cut[np.flatnonzero(is_cut)[0]] = False
    assert not measure_pose(vertices, faces, is_cut, UPRIGHT_ROTATION, COST).bed_face_hidden


def test_hidden_faces_make_a_part_lie_on_its_cut():
    """Check that of two equal ends, the cut one is at the bottom."""
    vertices, faces = Solid.box((0.0, 0.0, 0.0), (80.0, 80.0, 10.0)).arrays()
    flat_printers = [TargetPrinter("flat", ((90.0, 90.0, 15.0),))]
    for plane, up_z in ((BOTTOM_PLANE, 1.0), ((0.0, 0.0, 1.0, 10.0), -1.0)):
        pose = find_best_pose(
            vertices, faces, find_cut_faces(vertices, faces, np.array([plane])), flat_printers, COST
        )
        assert pose is not None
        assert pose.to_model[:3, 2] == pytest.approx((0.0, 0.0, up_z))


def test_walls_along_upright_cut_faces_are_cheaper():
    """Compare with the length of the walls over both speeds: 30 mm, less 6 mm at each end, in 80 layers."""
    fast_settings = replace(SETTINGS, hidden_outer_wall_mm_s=60.0, hidden_inner_wall_mm_s=60.0)
    cost = CostModel.from_settings(fast_settings)
    saved_s = 80.0 * (30.0 - 2.0 * SIDE_END_MM) * (1.0 / 40.0 - 1.0 / 60.0 + 1.0 / 50.0 - 1.0 / 60.0)
    plain_s, fast_s = (measure_block(SIDE_PLANE, cost=c).price_s for c in (COST, cost))
    assert plain_s - fast_s == pytest.approx(saved_s, rel=1e-6)
    for planes in ((), (BOTTOM_PLANE,)):
        assert measure_block(*planes, cost=cost).price_s == pytest.approx(measure_block(*planes).price_s)
    lying_rotation = POSE_ROTATIONS[0]  # the side is on the bed or on top
    assert measure_block(SIDE_PLANE, rotation=lying_rotation, cost=cost).price_s == pytest.approx(
        measure_block(SIDE_PLANE, rotation=lying_rotation).price_s
    )


@pytest.mark.parametrize("rotation", [*POSE_ROTATIONS, LEANING_ROTATION])
def test_connectors_are_priced_by_the_cut_faces(rotation: np.ndarray) -> None:
    """Price a block with a cut of 600 mm2 at its side and one of 1200 mm2 at its bottom."""
    cost = replace(PLAIN_COST, connector_side_s_per_mm2=0.01, connector_level_s_per_mm2=0.02)
    plain_pose, pose = (
        measure_block(SIDE_PLANE, BOTTOM_PLANE, rotation=rotation, cost=c) for c in (PLAIN_COST, cost)
    )
    areas_mm2 = {0: 600.0, 2: 1200.0}
    added_s = sum((0.01 if abs(rotation[2, axis]) < 1e-6 else 0.02) * mm2 for axis, mm2 in areas_mm2.items())
    assert pose.connectors_s == pytest.approx(added_s)
    assert pose.price_s - plain_pose.price_s == pytest.approx(added_s)


def test_hidden_sides_end_only_at_visible_faces():
    """Hide one side, two beside each other, two opposite ones, and all sides of a block 20 mm high."""
    planes = ((1.0, 0.0, 0.0, 40.0), (0.0, 1.0, 0.0, 30.0), (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0))
    vertices, faces = BLOCK.arrays()
    for sides, ends_mm in (((0,), 40.0), ((0, 1), 40.0), ((0, 2), 80.0), ((0, 1, 2, 3), 0.0), ((), 0.0)):
        cut_planes = np.array([planes[side] for side in sides]).reshape(-1, 4)
        mesh = PartMesh(vertices, faces, find_cut_faces(vertices, faces, cut_planes))
        assert sum_side_ends_mm(mesh, np.array((0.0, 0.0, 1.0))) == pytest.approx(ends_mm)


def test_short_hidden_side_saves_nothing():
    """Compare a side of 10 mm, which is shorter than its two ends."""
    fast_settings = replace(SETTINGS, hidden_outer_wall_mm_s=60.0, hidden_inner_wall_mm_s=60.0)
    plate = Solid.box((0.0, 0.0, 0.0), (40.0, 10.0, 20.0))
    fast_s, plain_s = (
        measure_block(SIDE_PLANE, solid=plate, cost=CostModel.from_settings(settings)).price_s
        for settings in (fast_settings, SETTINGS)
    )
    assert fast_s == pytest.approx(plain_s)


@pytest.mark.parametrize("top_share", [0.0, COST.hidden_top_share])
@pytest.mark.parametrize("side_share", [0.0, 0.2])
def test_tables_price_hidden_faces_as_parts_do(ring_with_bar: Solid, top_share: float, side_share: float):
    """Compare faces on the bed exactly, and faces on top only if no face above or below needs skin."""
    angles = {"effective_support_angle_deg": math.degrees(math.asin(0.7)), "skin_cos": 0.75}
    connectors = {"connector_side_s_per_mm2": 0.01, "connector_level_s_per_mm2": 0.02}
    cost = replace(COST, hidden_top_share=top_share, hidden_side_share=side_share, **connectors, **angles)
    vertices, faces = ring_with_bar.arrays()
    grid = build_grid(vertices[faces], 4, GridRules(0.0, True, 0.7, 0.75))
    tables = price_boxes(grid, [TargetPrinter("huge", ((1e4, 1e4, 1e4),))], cost)
    cost = replace(cost, hidden_side_share=MEAN_SIDE_SHARE * side_share)
    cheaper_count = 0
    for index in np.flatnonzero(tables.trimmed_box == np.arange(len(tables.trimmed_box)))[::9]:
        lo, hi = grid.find_bounds_mm(find_box(int(index), grid.shape))
        mesh = ring_with_bar.clip(lo, hi).arrays()
        planes = [[*axis, end[i]] for end in (lo, hi) for i, axis in enumerate(np.eye(3).tolist())]
        is_cut = find_cut_faces(*mesh, np.array(planes))
        features, extents = sum_pose_features(*mesh, POSE_ROTATIONS, cost, is_cut=is_cut)
        surfaces = measure_surfaces(*mesh)
        connectors_s = []
        for rotation in POSE_ROTATIONS:
            cos = surfaces.normals[is_cut] @ rotation[2]
            areas_mm2 = surfaces.areas_mm2[is_cut]
            side_mm2 = float(areas_mm2[np.abs(cos) < 0.5].sum())
            connectors_s.append(cost.price_connectors_s(side_mm2, float(areas_mm2.sum())))
        hidden_s = min(
            cost.price_part_s(*pose) + added_s
            for *pose, added_s in zip(features, extents, connectors_s, strict=True)
        )
        visible_s = (price_poses_s(*mesh, POSE_ROTATIONS, cost) + connectors_s).min()
        assert hidden_s * (1.0 - 1e-5) <= tables.seconds[index] <= visible_s * (1.0 + 1e-5)
        cheaper_count += tables.seconds[index] < visible_s * (1.0 - 1e-3)
        if not top_share:
            assert tables.seconds[index] == pytest.approx(hidden_s, rel=1e-5)
    assert cheaper_count > 10
