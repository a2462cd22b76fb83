"""Upright sides that are hidden once parts are glued."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from decompose.connectors import Tool
from decompose.decompose import decompose_model
from decompose.geometry import Model, Solid
from decompose.options import Options
from decompose.pieces import cut_box
from decompose.print_time import POSE_ROTATIONS, CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter
from decompose.results import Part
from decompose.results.hidden_sides import add_hidden_sides, list_hidden_grooves, list_hidden_recesses

BAR = Solid.box((0.0, 0.0, 0.0), (60.0, 40.0, 20.0))
LEFT_BOX, RIGHT_BOX = ((-1.0, -1.0, -1.0), (25.0, 41.0, 21.0)), ((25.0, -1.0, -1.0), (61.0, 41.0, 21.0))


def make_parts(solid: Solid, *boxes, rotation=POSE_ROTATIONS[4]) -> list[Part]:
    parts = []
    for number, (lo, hi) in enumerate(boxes):
        for piece in cut_box(solid, lo, hi):
            to_model = np.eye(4)
            to_model[:3, :3] = rotation.T
            to_model[:3, 3] = piece.solid.bounds_mm.mean(axis=0)
            parts.append(Part(f"p{number + 1:02d}", piece.solid, to_model, 1.0, "um", planes=piece.planes))
    return parts


def list_hidden_sides(solid: Solid, *boxes, rotation=POSE_ROTATIONS[4]) -> list[list[list[float]]]:
    """Cut a solid into boxes, and list the hidden sides of each part."""
    parts = make_parts(solid, *boxes, rotation=rotation)
    return [part.hidden_sides.tolist() for part in add_hidden_sides(parts, solid)]


def test_sides_of_a_cut_are_hidden_with_outward_normals():
    left_sides, right_sides = list_hidden_sides(BAR, LEFT_BOX, RIGHT_BOX)
    assert left_sides == [pytest.approx([1.0, 0.0, 12.5])]
    assert right_sides == [pytest.approx([-1.0, 0.0, 17.5])]


def test_sides_follow_the_pose_and_horizontal_ones_do_not_count():
    rotated_axes = trimesh.transformations.rotation_matrix(np.radians(30.0), (0.0, 0.0, 1.0))[:3, :3]
    (left_side,), _ = list_hidden_sides(BAR, LEFT_BOX, RIGHT_BOX, rotation=rotated_axes)
    assert left_side == pytest.approx([np.cos(np.radians(30.0)), np.sin(np.radians(30.0)), 12.5])
    assert list_hidden_sides(BAR, LEFT_BOX, RIGHT_BOX, rotation=POSE_ROTATIONS[0]) == [[], []]


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0])
def test_grooves_lie_along_their_side_in_printing_pose(angle_deg):
    """Cut a groove from y = 5 to y = 8 and 2 mm deep into the face at x = 25."""
    rotation = trimesh.transformations.rotation_matrix(np.radians(angle_deg), (0.0, 0.0, 1.0))[:3, :3]
    left_part, right_part = add_hidden_sides(
        make_parts(BAR, LEFT_BOX, RIGHT_BOX, rotation=rotation @ POSE_ROTATIONS[4]), BAR
    )
    points_mm = np.array([[x, y, z] for x in (23.0, 25.1) for y in (5.0, 8.0) for z in (0.0, 20.0)])
    tool = Tool(0, points_mm, np.array([-1.0, 0.0, 0.0]), -25.0)
    ((number, low_mm, high_mm, depth_mm),) = list_hidden_grooves(left_part, [tool])
    assert (number, depth_mm) == (0.0, pytest.approx(2.0))
    assert (low_mm, high_mm) == pytest.approx((5.0 - 20.0, 8.0 - 20.0))
    assert list_hidden_grooves(right_part, [tool]).shape == (0, 4)


@pytest.mark.parametrize("is_on_bed", [True, False], ids=["bed face", "top face"])
def test_recesses_of_level_faces_are_boxes_in_printing_pose(is_on_bed):
    """Cut two strokes of a mark, 0.4 mm deep, into the face at x = 25, which is level in the pose."""
    inward_normal = np.array([-1.0, 0.0, 0.0])
    up = inward_normal if is_on_bed else -inward_normal
    rotation = np.stack([[0.0, 1.0, 0.0], np.cross(up, [0.0, 1.0, 0.0]), up])
    part, _ = make_parts(BAR, LEFT_BOX, RIGHT_BOX, rotation=rotation)
    strokes = [
        Tool(
            0,
            np.array([[x, y, z] for x in (24.6, 25.1) for y in ys for z in (2.0, 6.0)]),
            inward_normal,
            -25.0,
        )
        for ys in ((5.0, 6.0), (8.0, 9.0))
    ]
    upright = replace(strokes[0], inward_normal=np.array([0.0, 1.0, 0.0]))
    ((min_x, min_y, max_x, max_y, face_z, bottom_z),) = list_hidden_recesses(part, [strokes, [upright]])
    corners_mm = (np.array([[25.0, 5.0, 2.0], [24.6, 9.0, 6.0]]) - part.to_model[:3, 3]) @ rotation.T
    assert (min_x, max_x) == pytest.approx(sorted(corners_mm[:, 0]))
    assert (min_y, max_y) == pytest.approx(sorted(corners_mm[:, 1]))
    assert (face_z, bottom_z) == pytest.approx(corners_mm[:, 2])
    assert (bottom_z > face_z) == is_on_bed


def test_side_that_continues_a_visible_face_is_visible():
    """Cut a stair at its step, so that the visible face above the step continues the plane of the cut."""
    stair = Solid.union([BAR, Solid.box((0.0, 0.0, 0.0), (25.0, 40.0, 40.0))])
    high_box = ((-1.0, -1.0, -1.0), (25.0, 41.0, 41.0))
    stepped_sides, low_sides = list_hidden_sides(stair, high_box, RIGHT_BOX)
    assert stepped_sides == low_sides == []


def test_side_towards_an_omitted_solid_is_hidden():
    assert list_hidden_sides(BAR, LEFT_BOX) == [[pytest.approx([1.0, 0.0, 12.5])]]


def test_small_side_does_not_count():
    small_bar = Solid.box((0.0, 0.0, 0.0), (60.0, 9.0, 9.0))
    assert list_hidden_sides(small_bar, LEFT_BOX, RIGHT_BOX) == [[], []]


def test_sides_of_a_result_lie_on_the_printed_parts():
    """Check that each printed part lies behind all its hidden sides, and has a face on each of them."""
    printers = [TargetPrinter(f"um{i}", ((50.0, 50.0, 50.0),)) for i in range(8)]
    settings = PrintTimeSettings(hidden_outer_wall_mm_s=60.0, hidden_inner_wall_mm_s=60.0)
    model = Model(Solid.box((0.0, 0.0, 0.0), (90.0, 60.0, 40.0)).rotate(POSE_ROTATIONS[2]), (), 1.0)
    result = decompose_model(
        model,
        printers,
        replace(Options(granularity=6), min_wall_mm=5.0),
        CostModel.from_settings(settings),
    )
    count = 0
    for part in result.parts:
        vertices, faces = part.build_printing_mesh()
        for x, y, offset_mm in part.hidden_sides:
            depth_mm = offset_mm - vertices[:, :2] @ (x, y)
            assert depth_mm.min() == pytest.approx(0.0, abs=1e-6)
            assert (np.abs(depth_mm[faces]) < 1e-6).all(axis=1).any()
            assert [round(x, 12), round(y, 12), offset_mm] in [
                [round(s[0], 12), round(s[1], 12), s[2]] for s in part.as_dict()["hidden_sides"]
            ]
            count += 1
    assert count >= len(result.parts)
