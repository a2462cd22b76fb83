"""Change of a part's print time as one of its cut faces moves, compared with parts that are cut again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from decompose.geometry import Solid
from decompose.pieces import cut_box, find_cut_faces, find_face_planes, list_box_planes
from decompose.print_time import (
    POSE_ROTATIONS,
    CostModel,
    PartMesh,
    PrintTimeSettings,
    measure_face_slopes,
    sum_pose_features,
)
from decompose.print_time.hidden_faces import find_hidden_faces
from decompose.print_time.surfaces import measure_surfaces

COST = replace(
    CostModel.from_settings(PrintTimeSettings()),
    skin_rim_s_per_mm=0.0,  # the square root of a small skin has no slope over a millimetre
    hidden_bed_share=0.5,
    hidden_top_share=0.3,
    hidden_side_share=0.4,
)
SIDE_NORMALS = np.vstack([-np.eye(3), np.eye(3)])
MOVE_MM = 0.01


def find_flags(solid: Solid, box_mm: np.ndarray, rotation: np.ndarray) -> tuple[bool, bool]:
    (piece,) = cut_box(solid, *box_mm)
    vertices, faces = piece.solid.arrays()
    is_cut, up = find_cut_faces(vertices, faces, piece.planes), rotation[2]
    hidden_faces = find_hidden_faces(
        measure_surfaces(vertices, faces), is_cut, up, float((vertices @ up).min()), COST.skin_cos
    )
    return hidden_faces.is_bed_hidden, hidden_faces.are_tops_hidden


def price_without_support_s(solid: Solid, box_mm: np.ndarray, rotation: np.ndarray) -> float:
    (piece,) = cut_box(solid, *box_mm)
    vertices, faces = piece.solid.arrays()
    is_cut = find_cut_faces(vertices, faces, piece.planes)
    (features,), (extents_mm,) = sum_pose_features(vertices, faces, rotation[None], COST, is_cut=is_cut)
    return COST.price_part_s([*features[:-1], 0.0], extents_mm)


def measure_slopes(solid: Solid, box_mm: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    (piece,) = cut_box(solid, *box_mm)
    vertices, faces = piece.solid.arrays()
    face_planes = find_face_planes(vertices, faces, piece.planes)
    return measure_face_slopes(
        PartMesh(vertices, faces, face_planes >= 0), rotation, face_planes, SIDE_NORMALS, COST
    )


@settings(max_examples=40, deadline=None)
@given(
    turn=st.tuples(*[st.floats(0.1, 1.0)] * 3),
    low_mm=st.tuples(*[st.floats(-45.0, -15.0)] * 3),
    high_mm=st.tuples(*[st.floats(15.0, 45.0)] * 3),
    pose=st.integers(0, 5),
)
def test_slope_is_the_time_of_the_next_slice_of_an_oblique_block(turn, low_mm, high_mm, pose):
    block = Solid.box((-40.0, -30.0, -25.0), (40.0, 30.0, 25.0))
    solid = block.rotate(Rotation.from_rotvec(turn).as_matrix())
    box_mm = np.array([low_mm, high_mm])
    slopes_s_per_mm = measure_slopes(solid, box_mm, POSE_ROTATIONS[pose])
    for plane, normal in enumerate(SIDE_NORMALS):
        side, axis = divmod(plane, 3)
        moved_mm = np.array([box_mm, box_mm])
        moved_mm[:, side, axis] += np.array([-MOVE_MM, MOVE_MM]) * normal[axis]
        # Whether all tops are hidden is decided by 1 mm2, at which the price jumps.
        assume(len({find_flags(solid, box, POSE_ROTATIONS[pose]) for box in moved_mm}) == 1)
        less_s, more_s = (price_without_support_s(solid, box, POSE_ROTATIONS[pose]) for box in moved_mm)
        expected_s_per_mm = (more_s - less_s) / (2.0 * MOVE_MM)
        # The slope is that of the next millimetre, in which the outline may change.
        tolerance = 0.02 * np.abs(slopes_s_per_mm).max() + 0.5
        assert slopes_s_per_mm[plane] == pytest.approx(expected_s_per_mm, abs=tolerance)


def test_face_on_no_plane_has_no_slope():
    solid = Solid.box((0.0, 0.0, 0.0), (40.0, 30.0, 20.0))
    slopes_s_per_mm = measure_slopes(
        solid, np.array([[-5.0, -5.0, -5.0], [30.0, 50.0, 50.0]]), POSE_ROTATIONS[4]
    )
    assert slopes_s_per_mm[3] > 0.0
    assert np.flatnonzero(slopes_s_per_mm).tolist() == [3]


def test_slope_is_that_of_the_layers_that_fit_the_part():
    cost = replace(COST, fit_layer_mm=lambda height_mm: 0.8 * COST.layer_height_mm)
    solid = Solid.box((0.0, 0.0, 0.0), (40.0, 30.0, 50.0))
    (piece,) = cut_box(solid, (-1.0, -1.0, -1.0), (50.0, 50.0, 20.0))
    vertices, faces = piece.solid.arrays()
    face_planes = find_face_planes(vertices, faces, piece.planes)
    mesh = PartMesh(vertices, faces, face_planes >= 0)
    slope, fitted_slope = (
        measure_face_slopes(mesh, POSE_ROTATIONS[4], face_planes, SIDE_NORMALS, model)[5]
        for model in (COST, cost)
    )
    assert fitted_slope == pytest.approx(slope / 0.8, rel=0.01)


def test_faces_are_found_on_the_first_of_their_planes():
    vertices, faces = Solid.box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)).arrays()
    planes = list_box_planes(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]))
    face_planes = find_face_planes(vertices, faces, np.vstack([planes, planes]))
    assert np.bincount(face_planes).tolist() == [2] * 6
    assert (find_face_planes(vertices, faces, planes[:0]) == -1).all()
