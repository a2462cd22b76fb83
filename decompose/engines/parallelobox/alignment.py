"""Orientation step of the paper: the frame in which the grid is built over a model.

If the model has a plane of symmetry, the plane is normal to an axis of the frame. The frame is rotated
further to the model's oriented bounding box if that reduces the overhangs. The paper also moves the
centroid to the origin, which has no effect here, because the grid reaches from one end of the model to the
other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from trimesh.bounds import oriented_bounds

from decompose.arrays import Floats
from decompose.geometry import (
    Model,
    find_convex_outline,
    find_mirror,
    find_rotation_to_axis,
    find_smallest_rectangle_angle_rad,
)
from decompose.grid import find_flat_faces
from decompose.print_time import POSE_ROTATIONS

MAX_REMAINING_OVERHANG_SHARE = 0.95  # a model is rotated only if at most this share of its overhang remains
MAX_BED_FACE_HEIGHT_MM = 1e-3  # maximum height of a face that lies on the bed


@dataclass(frozen=True, slots=True)
class AlignedModel:
    """A model in the frame in which it is cut.

    Attributes
    ----------
    model
        The model in that frame.
    rotation
        (3, 3) rotation into it: ``v_aligned = rotation @ v_model``.
    mirror
        The axis and the coordinate in mm of its plane of symmetry; None if it has none.
    """

    model: Model
    rotation: Floats
    mirror: tuple[int, float] | None


def align_model(model: Model, seed: int, overhang_cos: float) -> AlignedModel:
    """Rotate a model so that its plane of symmetry is normal to an axis and its overhangs are small.

    A plane of symmetry next to a face is not used, because it would cut slivers off, and the face would count
    as a cut.

    Parameters
    ----------
    model
        The model.
    seed
        Seed of the random planes among which a plane of symmetry is sought.
    overhang_cos
        Cosine of the angle between normal and downward direction above which a face counts as an overhang.
    """
    vertices, faces = model.solid.arrays()
    mirror = find_mirror(vertices, np.random.default_rng(seed))
    rotation, axis = (np.eye(3), -1) if mirror is None else find_rotation_to_axis(mirror.normal)
    turn = _find_box_frame(vertices @ rotation.T, axis)
    corners = (vertices @ rotation.T)[faces]
    if measure_overhang_mm2(
        corners @ turn.T, overhang_cos
    ) < MAX_REMAINING_OVERHANG_SHARE * measure_overhang_mm2(corners, overhang_cos):
        rotation = turn @ rotation
    if (rotation != np.eye(3)).any():
        model = replace(model, solid=model.solid.rotate(rotation))
    if mirror is None:
        return AlignedModel(model, rotation, None)
    at_mm = mirror.offset_mm * float(np.sign(mirror.normal[axis]))
    vertices, faces = model.solid.arrays()
    if find_flat_faces(vertices[faces], axis).measure_gaps_mm(at_mm) < 0.0:
        return AlignedModel(model, rotation, None)
    return AlignedModel(model, rotation, (axis, at_mm))


def measure_overhang_mm2(triangles: Floats, overhang_cos: float) -> float:
    """Measure the least overhanging area of a mesh over its six axis poses.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm, facing outward.
    overhang_cos
        Cosine of the angle between normal and downward direction above which a face counts as an overhang.
    """
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1)  # twice the area
    areas_mm2 = []
    for up in POSE_ROTATIONS[:, 2]:
        top_mm = (triangles @ up).max(axis=1)
        is_overhang = (-(cross @ up) > overhang_cos * length) & (
            top_mm > (triangles @ up).min() + MAX_BED_FACE_HEIGHT_MM
        )
        areas_mm2.append(float(length[is_overhang].sum()) / 2.0)
    return min(areas_mm2)


def _find_box_frame(vertices: Floats, axis: int) -> Floats:
    """Find the rotation (3, 3) into the frame of the smallest box around vertices (n, 3).

    For an axis from 0 to 2, only rotations about it are considered, which keep a plane of symmetry in place;
    -1 allows all.
    """
    if axis < 0:
        to_box: Any = oriented_bounds  # trimesh is untyped
        return _find_smallest_rotation(to_box(vertices, ordered=False)[0][:3, :3])
    x, y = (axis + 1) % 3, (axis + 2) % 3
    outline = find_convex_outline(np.ascontiguousarray(vertices[:, [x, y]]))
    angle_rad = find_smallest_rectangle_angle_rad(outline)
    angle_rad = (angle_rad + math.pi / 4.0) % (math.pi / 2.0) - math.pi / 4.0
    turn = np.eye(3)
    turn[x, x] = turn[y, y] = math.cos(angle_rad)
    turn[x, y], turn[y, x] = math.sin(angle_rad), -math.sin(angle_rad)
    return turn


def _find_smallest_rotation(rotation: Floats) -> Floats:
    """Find the smallest rotation (3, 3) with the same axes as a rotation, in any order and direction."""
    costs = np.abs(rotation)
    rows = [-1, -1, -1]
    for _ in range(3):
        row, axis = np.unravel_index(int(costs.argmax()), costs.shape)
        rows[axis] = int(row)
        costs[row], costs[:, axis] = -1.0, -1.0
    turn: Floats = rotation[rows]
    turn = turn * np.sign(np.diagonal(turn))[:, None]
    if np.linalg.det(turn) < 0.0:
        weakest = int(np.abs(np.diagonal(turn)).argmin())
        turn[weakest] *= -1.0
    return turn
