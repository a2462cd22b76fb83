"""Upright sides of parts that are hidden once the parts are glued."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from decompose.arrays import Floats
from decompose.pieces import Joint, JointFace, find_cut_faces
from decompose.results.decomposition import Part

PARALLEL = 1e-9  # maximum difference of the cosine of two parallel normals from 1
SAME_PLANE_MM = 1e-6
UPRIGHT = 1e-6  # maximum upward component of the normal of an upright side
SEEN_SHARE = 0.01  # maximum share of a side that no other part covers: more than a seam is seen
MIN_SIDE_MM2 = 100.0  # sides with a smaller area save no time


def mark_hidden_sides(parts: Sequence[Part], joints: Sequence[Joint]) -> list[Part]:
    """Fill in `Part.hidden_sides`.

    A side is hidden if other parts cover it. One that only hollows left out of the partition cover, or that
    continues a visible face of the model, counts as visible.

    Parameters
    ----------
    parts
        Parts in one frame.
    joints
        Joints of `find_joints`, in the same frame.
    """
    faces: dict[int, list[JointFace]] = defaultdict(list)
    for joint in joints:
        for neighbour in (joint.a, joint.b):
            faces[neighbour] += joint.faces
    marked_parts = []
    for number, part in enumerate(parts):
        covered_mm2 = [_sum_covered_mm2(plane, faces[number]) for plane in part.planes]
        sides = [_find_side(part, *side) for side in zip(part.planes, covered_mm2, strict=True)]
        found_sides = [side for side in sides if side is not None]
        marked_parts.append(replace(part, hidden_sides=np.array(found_sides).reshape(-1, 3)))
    return marked_parts


def _sum_covered_mm2(plane: Floats, faces: Sequence[JointFace]) -> float:
    """Sum the areas of the faces of joints on a plane (4,), whichever way its normal points."""
    normal, offset_mm = plane[:3], float(plane[3])
    covered_mm2 = 0.0
    for face in faces:
        cosine = float(face.normal @ normal)
        is_parallel = abs(abs(cosine) - 1.0) < PARALLEL
        if is_parallel and abs(np.sign(cosine) * face.offset_mm - offset_mm) < SAME_PLANE_MM:
            covered_mm2 += face.area_mm2
    return covered_mm2


def _find_side(part: Part, plane: Floats, covered_mm2: float) -> Floats | None:
    """Find the side (3,) of a part on a plane (4,), in printing pose; None unless upright and hidden."""
    normal = part.rotation @ plane[:3]
    offset_mm = plane[3] - plane[:3] @ part.to_model[:3, 3]
    if abs(normal[2]) > UPRIGHT or covered_mm2 < MIN_SIDE_MM2:
        return None
    vertices, faces = part.solid.arrays()
    corners = vertices[faces[find_cut_faces(vertices, faces, plane[None])]]
    areas_mm2 = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ plane[:3] / 2.0
    outward_mm2, inward_mm2 = areas_mm2[areas_mm2 > 0.0].sum(), -areas_mm2[areas_mm2 < 0.0].sum()
    all_mm2 = outward_mm2 + inward_mm2
    faces_both_ways = min(outward_mm2, inward_mm2) > SEEN_SHARE * all_mm2
    if faces_both_ways or covered_mm2 < (1.0 - SEEN_SHARE) * all_mm2:
        return None
    sign = 1.0 if outward_mm2 > inward_mm2 else -1.0
    return sign * np.array([normal[0], normal[1], offset_mm])
