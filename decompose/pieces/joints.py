"""Glue joints between pieces: area and width of each, and the pieces that cannot be glued well."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
import shapely

from decompose.arrays import Floats, Ints
from decompose.geometry import Solid, choose_plane_axes, label_components
from decompose.options import MIN_GLUE_MM2
from decompose.pieces.piece import PLANE_TOLERANCE_MM, find_cut_faces

# Minimum thickness of a piece next to a cut: a thinner piece gets lost or bent, or is glued at an angle.
SLIVER_MM = 8.0
TWO_WALLS_MM = 0.8  # two walls of a 0.4 mm nozzle: a thinner piece has no interior
# Minimum share of cut faces in the surface of a flake: a piece that is thinner than two walls on average.
MIN_FLAKE_CUT_SHARE = 0.25
# Maximum difference between the area of triangles and that of their union, as a share; beyond it, the union
# is computed again in a slower way.
AREA_TOLERANCE_SHARE = 1e-9
# Decimal places to which two pieces agree on the normal and the offset of their common plane.
PLANE_DECIMALS = 6


class CutSolid(Protocol):
    """Solid, and the planes at which it was cut, in one frame: a `Piece` or a `results.Part`."""

    @property
    def solid(self) -> Solid:
        """Solid in the frame of the planes, in mm."""

    @property
    def planes(self) -> Floats:
        """Planes (k, 4) at which the solid was cut."""


@dataclass(frozen=True, slots=True, eq=False)
class JointFace:
    """Flat face that two pieces share.

    Attributes
    ----------
    normal, offset_mm
        (3,) unit normal n of the plane, and its offset: ``n @ x == offset_mm``.
    axes
        (2, 3) unit vectors in the plane: the point with the coordinates u and w along them is
        ``(u, w) @ axes + offset_mm * n``.
    outline
        Polygons with coordinates u and w in mm.
    """

    normal: Floats
    offset_mm: float
    axes: Floats
    outline: shapely.Geometry

    @property
    def area_mm2(self) -> float:
        """Area of the face."""
        return float(self.outline.area)

    def measure_width_mm(self) -> float:
        """Measure the diameter of the largest circle inside the face."""
        return max(map(_measure_width_mm, list_polygons(self.outline)))

    def has_width(self, min_width_mm: float) -> bool:
        """Check whether a circle of this diameter fits into the face; measure the width only if necessary."""
        return any(
            _bound_width_mm(polygon) >= min_width_mm or _measure_width_mm(polygon) >= min_width_mm
            for polygon in list_polygons(self.outline)
        )

    def move(self, transform: Floats) -> JointFace:
        """Move the face by a rigid transform (4, 4)."""
        rotation, offset_mm = transform[:3, :3], transform[:3, 3]
        normal, axes = rotation @ self.normal, self.axes @ rotation.T
        outline = shapely.transform(self.outline, lambda corners: corners + axes @ offset_mm)
        return JointFace(normal, self.offset_mm + float(normal @ offset_mm), axes, outline)


@dataclass(frozen=True, slots=True)
class Joint:
    """Contact between two pieces, which is glued.

    Attributes
    ----------
    a, b
        Numbers of the pieces, a < b.
    area_mm2
        Area of the faces that the pieces share.
    faces
        Faces that the pieces share, in their frame.
    """

    a: int
    b: int
    area_mm2: float
    faces: tuple[JointFace, ...] = field(compare=False, repr=False)

    @property
    def width_mm(self) -> float:
        """Diameter of the largest circle in one of the faces; for a long thin joint, its short side."""
        return max(face.measure_width_mm() for face in self.faces)

    def move(self, transform: Floats) -> Joint:
        """Move the joint by a rigid transform (4, 4)."""
        return replace(self, faces=tuple(face.move(transform) for face in self.faces))

    def holds(self, min_glue_mm2: float) -> bool:
        """Check whether the joint has the minimum area, and is two walls wide if the minimum is not 0.

        A narrower joint may act as a hinge, however long it is.
        """
        return self.area_mm2 >= min_glue_mm2 and (
            min_glue_mm2 <= 0.0 or any(face.has_width(TWO_WALLS_MM) for face in self.faces)
        )

    def describe_weakness(self, min_glue_mm2: float) -> str:
        """Describe why the joint does not hold, as the end of a sentence about a piece."""
        if self.area_mm2 < min_glue_mm2:
            return f"is held by {self.area_mm2:.1f} mm2 of glue, less than {min_glue_mm2:g} mm2"
        return f"is held by a joint {self.width_mm:.1f} mm wide, less than {TWO_WALLS_MM:g} mm"


@dataclass(frozen=True, slots=True)
class Fault:
    """Number of a piece that cannot be glued well, and the reason as the end of a sentence."""

    piece_number: int
    reason: str


def find_joints(pieces: Sequence[CutSolid]) -> list[Joint]:
    """Find all joints, in the order of the numbers of their pieces.

    Parameters
    ----------
    pieces
        Pieces in one frame, cut at planes.
    """
    sides: dict[tuple[float, ...], list[tuple[int, _Side]]] = defaultdict(list)
    for number, piece in enumerate(pieces):
        for plane, side in _inspect_cuts(piece).sides.items():
            sides[plane].append((number, side))
    joint_faces: dict[tuple[int, int], list[JointFace]] = defaultdict(list)
    for plane_key, plane_sides in sides.items():
        for i, (a, side) in enumerate(plane_sides):
            for b, other_side in plane_sides[i + 1 :]:
                if a == b or not side.region.intersects(other_side.region):
                    continue
                shared_region = side.region.intersection(other_side.region)
                if shared_region.area > 0.0:
                    normal, offset_mm = side.plane[:3], float(side.plane[3])
                    joint_faces[min(a, b), max(a, b)].append(
                        JointFace(
                            normal, offset_mm, choose_plane_axes(np.array(plane_key[:3])), shared_region
                        )
                    )
    return [
        Joint(a, b, sum(f.area_mm2 for f in faces), tuple(faces))
        for (a, b), faces in sorted(joint_faces.items())
    ]


def find_faults(
    pieces: Sequence[CutSolid], min_glue_mm2: float = MIN_GLUE_MM2, joints: Sequence[Joint] | None = None
) -> list[Fault]:
    """Find all slivers, and one loose piece in each group of pieces that is held weakly.

    Slivers are thinner than `SLIVER_MM` next to a cut, or are flakes thinner than two walls. A body is a set
    of pieces that touch each other, directly or through other pieces. Loose pieces are connected to the rest
    of their body only by joints that do not hold (`Joint.holds`).

    Parameters
    ----------
    pieces
        Pieces in one frame, cut at planes.
    min_glue_mm2
        Minimum area of a joint that counts as holding.
    joints
        Joints from `find_joints`, if they are known already.
    """
    slivers = [_inspect_cuts(piece).sliver_reason for piece in pieces]
    faults = [Fault(i, reason) for i, reason in enumerate(slivers) if reason]
    joints = find_joints(pieces) if joints is None else joints
    return faults + _find_loose_pieces([p.solid.volume_mm3 for p in pieces], joints, min_glue_mm2)


def _find_loose_pieces(
    volumes_mm3: Sequence[float], joints: Sequence[Joint], min_glue_mm2: float
) -> list[Fault]:
    """Find the smallest piece with a weak joint in each loose group.

    A weak joint is one that does not hold, and a group is a set of pieces that other joints connect. All
    groups of a body are loose except the one with the largest volume.
    """
    body = _label_groups(len(volumes_mm3), joints)
    components = _label_groups(len(volumes_mm3), [j for j in joints if j.holds(min_glue_mm2)])
    group_volumes_mm3 = np.bincount(components, weights=volumes_mm3)
    largest_groups = {
        int(b): max(np.unique(components[body == b]), key=lambda g: group_volumes_mm3[g])
        for b in np.unique(body)
    }
    weak_pieces: dict[int, tuple[float, int, Joint]] = {}
    for joint in joints:
        for piece in (joint.a, joint.b):
            group = int(components[piece])
            if components[joint.a] != components[joint.b] and group != largest_groups[int(body[piece])]:
                candidate = (volumes_mm3[piece], piece, joint)
                weak_pieces[group] = min(
                    weak_pieces.get(group, candidate), candidate, key=lambda fault: fault[:2]
                )
    return [Fault(piece, joint.describe_weakness(min_glue_mm2)) for _, piece, joint in weak_pieces.values()]


def _describe_sliver(piece: CutSolid) -> str:
    """Describe why a piece is a sliver; return an empty string if it is not one."""
    vertices, faces = piece.solid.arrays()
    for plane in piece.planes:
        distances_mm = vertices @ plane[:3] - plane[3]
        cut_thickness_mm = float(np.ptp(distances_mm))
        if cut_thickness_mm < SLIVER_MM and (np.abs(distances_mm) < PLANE_TOLERANCE_MM).sum() >= 3:
            return f"is {cut_thickness_mm:.1f} mm thick where it was cut, less than {SLIVER_MM:g} mm"
    thickness_mm = 2.0 * piece.solid.volume_mm3 / piece.solid.area_mm2
    if thickness_mm < TWO_WALLS_MM:
        triangles = vertices[faces[find_cut_faces(vertices, faces, piece.planes)]]
        cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        if np.linalg.norm(cross, axis=1).sum() / 2.0 > MIN_FLAKE_CUT_SHARE * piece.solid.area_mm2:
            return f"is a flake of {thickness_mm:.1f} mm"
    return ""


def _label_groups(count: int, joints: Sequence[Joint]) -> Ints:
    """Label pieces (count,) with the number of their group; joints connect the pieces of a group."""
    pairs = np.array([(j.a, j.b) for j in joints], dtype=np.int64).reshape(-1, 2)
    return label_components(count, pairs[:, 0], pairs[:, 1])


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """Plane (4,), not rounded, and the region that the faces of a solid cover on it."""

    plane: Floats
    region: shapely.Geometry


@dataclass(frozen=True, slots=True, eq=False)
class _Cuts:
    """Cuts at the planes (k, 4) of a piece: its sides there, and why it is a sliver (empty if it is none)."""

    planes: Floats
    sides: dict[tuple[float, ...], _Side]
    sliver_reason: str


# A search checks many partitions that have most of their pieces in common.
_cuts_by_solid: WeakKeyDictionary[Solid, _Cuts] = WeakKeyDictionary()


def _inspect_cuts(piece: CutSolid) -> _Cuts:
    """Inspect the cuts of a piece; the result is kept as long as its solid exists."""
    cuts = _cuts_by_solid.get(piece.solid)
    if cuts is None or not np.array_equal(cuts.planes, piece.planes):
        sides = _find_cut_sides(piece.solid, piece.planes)
        cuts = _cuts_by_solid[piece.solid] = _Cuts(piece.planes, sides, _describe_sliver(piece))
    return cuts


def _find_cut_sides(solid: Solid, planes: Floats) -> dict[tuple[float, ...], _Side]:
    """Find the faces of a solid on each of its planes (k, 4), in the coordinates of the plane.

    Returns
    -------
    dict
        Faces on each plane, by the plane's rounded coefficients.
    """
    vertices, faces = solid.arrays()
    sides: dict[tuple[float, ...], _Side] = {}
    for plane in planes:
        is_on_plane = np.abs(vertices @ plane[:3] - plane[3]) < PLANE_TOLERANCE_MM
        flat_faces = faces[is_on_plane[faces].all(axis=1)]
        if not len(flat_faces):
            continue
        sign = -1.0 if plane[int(np.abs(plane[:3]).argmax())] < 0.0 else 1.0
        plane_key = np.round(sign * plane, PLANE_DECIMALS) + 0.0
        # Coordinates are rounded because shapely divides by them, and the inverse of a denormal is infinite.
        corners = np.round((vertices @ choose_plane_axes(plane_key[:3]).T)[flat_faces], PLANE_DECIMALS)
        triangles = shapely.polygons(np.concatenate([corners, corners[:, :1]], axis=1))
        region = _unite_triangles(triangles[shapely.area(triangles) > 0.0])
        if region.area > 0.0:
            sides[tuple(float(v) for v in plane_key)] = _Side(sign * plane, region)
    return sides


def _unite_triangles(triangles: npt.NDArray[np.object_]) -> shapely.Geometry:
    """Unite the triangles of a flat face.

    Triangles that meet edge to edge, without overlap, are united by their edges alone, which is much faster
    but may fail because corners are rounded.
    """
    area_mm2 = float(shapely.area(triangles).sum())
    with suppress(shapely.GEOSException):
        union = shapely.coverage_union_all(triangles)
        if union.is_valid and math.isclose(union.area, area_mm2, rel_tol=AREA_TOLERANCE_SHARE):
            return union
    return shapely.union_all(triangles)


def _measure_width_mm(polygon: shapely.Polygon) -> float:
    """Measure the diameter of the largest circle inside a polygon, to a thousandth of its size."""
    return max(_bound_width_mm(polygon), 2.0 * float(shapely.maximum_inscribed_circle(polygon).length))


def _bound_width_mm(polygon: shapely.Polygon) -> float:
    """Bound the diameter of the largest circle inside a polygon from below; 0 if it has holes.

    Without holes, the diameter is at least twice the area divided by the perimeter (Bonnesen's inequality).
    """
    return 0.0 if polygon.interiors else 2.0 * float(polygon.area) / float(polygon.length)


def list_polygons(geometry: shapely.Geometry) -> list[shapely.Polygon]:
    """List the polygons of a geometry, without points and lines."""
    return [part for part in shapely.get_parts(geometry) if part.geom_type == "Polygon"]
