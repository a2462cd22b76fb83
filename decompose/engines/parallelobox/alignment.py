"""Orientation step of the paper: the frame in which the grid is built over a model.

If the model has a plane of symmetry, the plane is perpendicular to an axis of the frame. The frame is rotated
further, so that its axes are those of the model's oriented bounding box, if this reduces the overhangs. The
paper also moves the centroid to the origin, which has no effect here, because the grid reaches from one end
of the model to the other.
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

# The axes of the bounding box are used only if less than this share of the overhanging area remains then.
MAX_REMAINING_OVERHANG_SHARE = 0.95
MAX_BED_FACE_HEIGHT_MM = 1e-3  # maximum height of a face that lies on the bed


@dataclass(frozen=True, slots=True)
class AlignedModel:
    """Model in the frame in which it is cut.

    Attributes
    ----------
    model
        Model in that frame.
    rotation
        (3, 3) rotation into the frame: ``v_aligned = rotation @ v_model``.
    mirror
        Axis perpendicular to the plane of symmetry, and coordinate of the plane in mm; None if there is none.
    """

    model: Model
    rotation: Floats
    mirror: tuple[int, float] | None


def align_model(model: Model, seed: int, overhang_cos: float) -> AlignedModel:
    """Rotate a model so that its plane of symmetry is perpendicular to an axis, and its overhangs are small.

    A plane of symmetry close to a flat face is not used, because it would cut off slivers, and the face would
    count as a cut face.

    Parameters
    ----------
    model
        Model to rotate.
    seed
        Seed of the random planes among which the plane of symmetry is sought.
    overhang_cos
        A face counts as an overhang if the cosine of the angle between its normal and the downward direction
        is above this value.
    """
    vertices, faces = model.solid.arrays()
    mirror = find_mirror(vertices, np.random.default_rng(seed))
    rotation, axis = (np.eye(3), -1) if mirror is None else find_rotation_to_axis(mirror.normal)
    box_rotation = _find_box_frame(vertices @ rotation.T, axis)
    corners = (vertices @ rotation.T)[faces]
    if measure_overhang_mm2(
        corners @ box_rotation.T, overhang_cos
    ) < MAX_REMAINING_OVERHANG_SHARE * measure_overhang_mm2(corners, overhang_cos):
        rotation = box_rotation @ rotation
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
    """Measure the least overhanging area of a mesh over its six axis-aligned poses.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm; the faces point outward.
    overhang_cos
        A face counts as an overhang if the cosine of the angle between its normal and the downward direction
        is above this value.
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

    For an axis from 0 to 2, only rotations about this axis are considered, which keep a plane of symmetry in
    place; the axis -1 allows all rotations.
    """
    if axis < 0:
        find_oriented_bounds: Any = oriented_bounds  # trimesh is untyped
        return _find_smallest_rotation(find_oriented_bounds(vertices, ordered=False)[0][:3, :3])
    x, y = (axis + 1) % 3, (axis + 2) % 3
    outline = find_convex_outline(np.ascontiguousarray(vertices[:, [x, y]]))
    angle_rad = find_smallest_rectangle_angle_rad(outline)
    angle_rad = (angle_rad + math.pi / 4.0) % (math.pi / 2.0) - math.pi / 4.0
    box_rotation = np.eye(3)
    box_rotation[x, x] = box_rotation[y, y] = math.cos(angle_rad)
    box_rotation[x, y], box_rotation[y, x] = math.sin(angle_rad), -math.sin(angle_rad)
    return box_rotation


def _find_smallest_rotation(rotation: Floats) -> Floats:
    """Find the smallest rotation (3, 3) with the axes of a given rotation, in any order and direction."""
    costs = np.abs(rotation)
    rows = [-1, -1, -1]
    for _ in range(3):
        row, axis = np.unravel_index(int(costs.argmax()), costs.shape)
        rows[axis] = int(row)
        costs[row], costs[:, axis] = -1.0, -1.0
    box_rotation: Floats = rotation[rows]
    box_rotation = box_rotation * np.sign(np.diagonal(box_rotation))[:, None]
    if np.linalg.det(box_rotation) < 0.0:
        weakest = int(np.abs(np.diagonal(box_rotation)).argmin())
        box_rotation[weakest] *= -1.0
    return box_rotation
