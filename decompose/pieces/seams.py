"""Seams: the lines on the outer surface at which two parts meet, and the thin rims of parts along them.

The rim of a part on a cut plane consists of the edges between its cut face and the surface of the model.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from decompose.arrays import Bools, Floats, Ints
from decompose.geometry import Solid
from decompose.pieces.joints import TWO_WALLS_MM, CutSolid, Joint, JointFace
from decompose.pieces.piece import PLANE_TOLERANCE_MM, find_cut_faces

# Minimum width of a strip of a cut face behind which a part counts as thin; narrower strips are ignored.
MIN_THIN_WIDTH_MM = 3.0
MIN_REPORTED_LENGTH_MM = 5.0  # minimum total length of thin rims that is reported; less is ignored
LINE_TOLERANCE_MM = 1e-3  # tolerance when lines are compared, because rounding moves the corners of outlines


@dataclass(frozen=True, slots=True)
class Seam:
    """The seam of a joint.

    Attributes
    ----------
    length_mm
        Length on the surface of the model. Edges between two cut faces do not count, as around a space that
        the parts leave out.
    thin_length_mm
        Length along which one of the parts has a thin rim: behind a strip of the joint that is wider than
        `MIN_THIN_WIDTH_MM`, the part is thinner than two walls. Such a rim breaks off, or is not printed.
    """

    length_mm: float = 0.0
    thin_length_mm: float = 0.0


def describe_thin_rims(names: Sequence[str], joints: Sequence[Joint], seams: Sequence[Seam]) -> str:
    """Describe thin rims in a sentence; return an empty string if they are too short to report.

    Parameters
    ----------
    names
        Names of the parts.
    joints, seams
        Joints, and the seam of each.
    """
    total_mm = sum(seam.thin_length_mm for seam in seams)
    if total_mm < MIN_REPORTED_LENGTH_MM:
        return ""
    joint, seam = max(zip(joints, seams, strict=True), key=lambda pair: pair[1].thin_length_mm)
    return (
        f"the rim is thinner than two walls on {total_mm:.0f} mm of the seams, the greatest length between "
        f"{names[joint.a]} and {names[joint.b]} ({seam.thin_length_mm:.0f} mm): it may break off"
    )


def measure_seams(pieces: Sequence[CutSolid], joints: Iterable[Joint]) -> list[Seam]:
    """Measure the seam of each joint.

    Parameters
    ----------
    pieces
        All pieces in one frame. A face of the model that lies in a cut plane counts as a cut face.
    joints
        Joints from `find_joints`, in the same frame.
    """
    rims = _Rims(pieces)
    return [rims.measure_seam(joint) for joint in joints]


class _Rims:
    """Rims of cut faces; each rim is found once for each piece and plane."""

    def __init__(self, pieces: Sequence[CutSolid]) -> None:
        self._solids = [piece.solid for piece in pieces]
        self._arrays = [piece.solid.arrays() for piece in pieces]
        self._edges = [_list_edges(faces) for _, faces in self._arrays]
        extents = _Extents(self._arrays)
        self._cut_faces = [
            find_cut_faces(*arrays, extents.drop_outermost_planes(piece.planes))
            for piece, arrays in zip(pieces, self._arrays, strict=True)
        ]
        self._rims: dict[tuple[int, bytes, float], tuple[shapely.Geometry, shapely.Geometry]] = {}

    def measure_seam(self, joint: Joint) -> Seam:
        """Measure the seam of a joint."""
        length_mm = thin_length_mm = 0.0
        for face in joint.faces:
            near_area = face.outline.buffer(LINE_TOLERANCE_MM)
            both_rims = [self._find_rim(number, face) for number in (joint.a, joint.b)]
            length_mm += max(float(rim.intersection(near_area).length) for rim, _ in both_rims)
            thin_length_mm += max(float(thin.intersection(near_area).length) for _, thin in both_rims)
        return Seam(length_mm, thin_length_mm)

    def _find_rim(self, number: int, face: JointFace) -> tuple[shapely.Geometry, shapely.Geometry]:
        """Find the rim of a piece on the plane of a face, and the thin part of the rim."""
        key = number, face.normal.tobytes(), face.offset_mm
        if key not in self._rims:
            vertices, faces = self._arrays[number]
            is_flat = find_cut_faces(vertices, faces, np.append(face.normal, face.offset_mm)[None])
            corners, pairs = self._edges[number]
            is_outer = ~self._cut_faces[number][pairs]
            is_on_rim = (is_flat[pairs] & is_outer[:, ::-1]).any(axis=1)
            lines = (vertices @ face.axes.T)[corners[is_on_rim]]
            rim = shapely.union_all(shapely.linestrings(lines))
            thin_region = _find_thin_region(self._solids[number], vertices, faces[is_flat], face)
            self._rims[key] = rim, rim.intersection(thin_region.buffer(LINE_TOLERANCE_MM))
        return self._rims[key]


def _find_thin_region(solid: Solid, vertices: Floats, flat_faces: Ints, face: JointFace) -> shapely.Geometry:
    """Find the region where a solid is thinner than two walls behind faces (m, 3) on the plane of a joint."""
    a, b, c = np.moveaxis(vertices[flat_faces], 1, 0)
    outward_sign = np.sign(float((np.cross(b - a, c - a) @ face.normal).sum()))
    rings = (vertices @ face.axes.T)[flat_faces]
    cut_area = shapely.union_all(shapely.polygons(np.concatenate([rings, rings[:, :1]], axis=1)))
    frame = np.vstack([face.axes, face.normal])
    area_behind = solid.cut_section(frame, face.offset_mm - outward_sign * TWO_WALLS_MM)
    thin_region = cut_area.difference(_build_region(area_behind))
    opened_area: shapely.Geometry = thin_region.buffer(-MIN_THIN_WIDTH_MM / 2.0).buffer(
        MIN_THIN_WIDTH_MM / 2.0 * 1.01
    )
    return opened_area


def _build_region(rings: Sequence[Floats]) -> shapely.Geometry:
    """Build the region inside rings (n, 2); rings around holes are clockwise."""
    outlines = [ring for ring in rings if len(ring) > 2]
    filled_areas = [_build_valid_region(ring) for ring in outlines if _measure_ring_area_mm2(ring) > 0.0]
    holes = [_build_valid_region(ring) for ring in outlines if _measure_ring_area_mm2(ring) < 0.0]
    return shapely.union_all(filled_areas).difference(shapely.union_all(holes))


def _build_valid_region(ring: Floats) -> shapely.Geometry:
    """Build the valid region inside a ring, without the parts of it that collapse to lines."""
    return shapely.make_valid(shapely.Polygon(ring), method="structure", keep_collapsed=False)


def _measure_ring_area_mm2(ring: Floats) -> float:
    """Measure the area of a ring (n, 2), negative if it is clockwise; spikes of the ring are allowed."""
    x, y = (ring - ring[0]).T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2.0


def _list_edges(faces: Ints) -> tuple[Ints, Ints]:
    """List the edges of a closed surface: their corners (e, 2), and the two faces (e, 2) at each."""
    corners = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    order = np.lexsort((corners[:, 1], corners[:, 0]))
    return corners[order[::2]], (order % len(faces)).reshape(-1, 2)


class _Extents:
    """Least and greatest coordinate of all pieces along normals; they are found once for each normal."""

    def __init__(self, arrays: Sequence[tuple[Floats, Ints]]) -> None:
        self._arrays = arrays
        self._extents: dict[bytes, tuple[float, float]] = {}

    def drop_outermost_planes(self, planes: Floats) -> Floats:
        """Drop the planes (k, 4) that cut nothing, because all pieces lie on one side of them."""
        is_cut: Bools = np.array([self._is_cut(plane) for plane in planes], dtype=np.bool_)
        return planes[is_cut]

    def _is_cut(self, plane: Floats) -> bool:
        """Check whether there are pieces on both sides of a plane (4,)."""
        normal = plane[:3]
        key = normal.tobytes()
        if key not in self._extents:
            coordinates_mm = [vertices @ normal for vertices, _ in self._arrays]
            self._extents[key] = (
                min(float(a.min()) for a in coordinates_mm),
                max(float(a.max()) for a in coordinates_mm),
            )
        low_mm, high_mm = self._extents[key]
        return (
            low_mm < float(plane[3]) - PLANE_TOLERANCE_MM and float(plane[3]) + PLANE_TOLERANCE_MM < high_mm
        )
