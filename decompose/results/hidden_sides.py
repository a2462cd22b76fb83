"""Upright sides of parts that are hidden once the parts are glued."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from decompose.arrays import Floats
from decompose.connectors import Tool
from decompose.geometry import Solid
from decompose.pieces import find_cut_faces
from decompose.results.decomposition import Part

MAX_UPRIGHT_COS = 1e-6  # maximum upward component of the normal of an upright side
# Maximum share of a side's area that may face the other way, for example at fins of zero thickness.
MAX_REVERSED_SHARE = 0.01
MIN_SIDE_MM2 = 100.0  # minimum area of a side; smaller sides save no time
ADJACENCY_TOLERANCE_MM = 1e-3
# Minimum cosine between the normals of a side and of a face with a groove, and between the vertical and the
# normal of a level face.
MIN_NORMAL_COS = 1.0 - 1e-6


def add_hidden_sides(parts: Sequence[Part], model: Solid) -> list[Part]:
    """Add `Part.hidden_sides` to parts: cut faces that are upright while the part is printed.

    A cut face in the plane of a visible face of the model counts as visible if the two faces are adjacent.

    Parameters
    ----------
    parts
        Parts in one frame.
    model
        Uncut model in the same frame.

    Returns
    -------
    list[Part]
        Parts with their hidden sides.
    """
    surface = _Surface(model)
    new_parts = []
    for part in parts:
        sides = [side for plane in part.planes if (side := _find_side(part, plane, surface)) is not None]
        new_parts.append(replace(part, hidden_sides=np.array(sides).reshape(-1, 3)))
    return new_parts


def _find_side(part: Part, plane: Floats, surface: _Surface) -> Floats | None:
    """Find the side (3,) of a part on a plane (4,), in printing pose; None if it is not upright and hidden.

    The result has the form of a row of `Part.hidden_sides`.
    """
    normal = part.rotation @ plane[:3]
    if abs(normal[2]) > MAX_UPRIGHT_COS:
        return None
    vertices, faces = part.solid.arrays()
    corners = vertices[faces[find_cut_faces(vertices, faces, plane[None])]]
    areas_mm2 = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ plane[:3] / 2.0
    outward_mm2, inward_mm2 = areas_mm2[areas_mm2 > 0.0].sum(), -areas_mm2[areas_mm2 < 0.0].sum()
    area_mm2 = outward_mm2 + inward_mm2
    faces_both_ways = min(outward_mm2, inward_mm2) > MAX_REVERSED_SHARE * area_mm2
    if area_mm2 < MIN_SIDE_MM2 or faces_both_ways or surface.is_beside(plane, corners.reshape(-1, 3)):
        return None
    offset_mm = plane[3] - plane[:3] @ part.to_model[:3, 3]
    sign = 1.0 if outward_mm2 > inward_mm2 else -1.0
    return sign * np.array([normal[0], normal[1], offset_mm])


def list_hidden_grooves(part: Part, tools: Sequence[Tool]) -> Floats:
    """List the grooves that are cut into the hidden sides of a part.

    Parameters
    ----------
    part
        Part with its hidden sides.
    tools
        Tools of its grooves, in the frame of the parts.

    Returns
    -------
    ndarray
        (k, 4) in printing pose: index of the side in `Part.hidden_sides`; start and end of the groove along
        the side in mm, in the direction (-ny, nx) for a side with the normal (nx, ny); depth in mm.
    """
    rows = []
    for tool in tools:
        points_mm = (tool.points_mm - part.to_model[:3, 3]) @ part.to_model[:3, :3]
        normal = -part.rotation @ tool.inward_normal
        for number, (x, y, offset_mm) in enumerate(part.hidden_sides):
            depths_mm = offset_mm - points_mm[:, :2] @ (x, y)
            # A tool extends slightly beyond its face.
            if normal[:2] @ (x, y) > MIN_NORMAL_COS and depths_mm.min() < 0.0 < depths_mm.max():
                positions_mm = points_mm[:, :2] @ (-y, x)
                rows.append((number, positions_mm.min(), positions_mm.max(), depths_mm.max()))
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def list_hidden_recesses(part: Part, recesses: Sequence[Sequence[Tool]]) -> Floats:
    """List the recesses in level faces of a part; a recess is cut by one or more tools.

    Parameters
    ----------
    part
        Part in which the recesses are.
    recesses
        Tools of each recess, in the frame of the parts.

    Returns
    -------
    ndarray
        (k, 6) in printing pose, in mm: the box min_x, min_y, max_x, max_y of a recess, the height of the face
        in which the recess is, and the height of the bottom of the recess.
    """
    rows = []
    for tools in recesses:
        rise = float(part.rotation[2] @ tools[0].inward_normal)
        if abs(rise) < MIN_NORMAL_COS:
            continue
        points_mm = np.concatenate([tool.points_mm for tool in tools]) - part.to_model[:3, 3]
        points_mm = points_mm @ part.to_model[:3, :3]
        low_mm, high_mm = points_mm.min(axis=0), points_mm.max(axis=0)
        face_mm = tools[0].face_offset_mm * rise - float(part.to_model[:3, 3] @ part.rotation[2])
        rows.append((*low_mm[:2], *high_mm[:2], face_mm, high_mm[2] if rise > 0.0 else low_mm[2]))
    return np.array(rows, dtype=np.float64).reshape(-1, 6)


class _Surface:
    """Surface of the model. The faces that lie in a plane are found once and cached."""

    def __init__(self, model: Solid) -> None:
        self._vertices, self._faces = model.arrays()
        self._flat_corners: dict[bytes, Floats] = {}

    def is_beside(self, plane: Floats, points: Floats) -> bool:
        """Check whether a face of the model in a plane (4,) meets the bounding box of points (n, 3)."""
        key = plane.tobytes()
        if key not in self._flat_corners:
            is_flat = find_cut_faces(self._vertices, self._faces, plane[None])
            self._flat_corners[key] = self._vertices[self._faces[is_flat]]
        corners = self._flat_corners[key]
        low_mm, high_mm = (
            points.min(axis=0) - ADJACENCY_TOLERANCE_MM,
            points.max(axis=0) + ADJACENCY_TOLERANCE_MM,
        )
        overlaps = (corners.min(axis=1) <= high_mm) & (corners.max(axis=1) >= low_mm)
        return bool(overlaps.all(axis=1).any())
