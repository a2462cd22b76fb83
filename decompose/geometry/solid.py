"""Closed solids in double precision. Only this module imports manifold3d.

When an operation fails, manifold3d sets a status and returns an empty solid; this module checks the status of
every operation and raises an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import manifold3d
import numpy as np
import numpy.typing as npt

from decompose.arrays import Floats, Ints
from decompose.errors import ModelNotSolid

_BOX_FACES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ],
    dtype=np.uint64,
)  # fmt: skip


def _check_status(manifold: Any, operation: str) -> Any:
    """Raise an error if an operation failed; return its result."""
    status = manifold.status()
    if status != manifold3d.Error.NoError:
        raise ModelNotSolid(f"{operation}: the triangles bound no solid ({status.name}); repair the model")
    return manifold


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Solid:
    """A closed, oriented 2-manifold in mm, with the operations that cutting needs."""

    manifold: Any

    def __reduce__(self) -> tuple[Any, ...]:
        return Solid.from_arrays, self.arrays()

    @classmethod
    def from_arrays(cls, vertices: npt.ArrayLike, faces: npt.ArrayLike) -> Solid:
        """Build a solid from vertices and faces.

        Parameters
        ----------
        vertices
            (n, 3) in mm.
        faces
            (m, 3) indices of vertices; faces point outward by the right-hand rule.

        Raises
        ------
        ModelNotSolid
            An edge is not shared by exactly two triangles that run along it in opposite directions.
        """
        mesh = manifold3d.Mesh64(
            vert_properties=np.ascontiguousarray(vertices, dtype=np.float64),
            tri_verts=np.ascontiguousarray(faces, dtype=np.uint64),
        )
        return cls(_check_status(manifold3d.Manifold(mesh), "building a solid"))

    @classmethod
    def box(cls, lo_mm: npt.ArrayLike, hi_mm: npt.ArrayLike) -> Solid:
        """Build an axis-aligned box with exactly these corners.

        Parameters
        ----------
        lo_mm, hi_mm
            (3,) corners in mm.
        """
        ends = np.array([lo_mm, hi_mm], dtype=np.float64)
        corners = np.array([[ends[i & 1, 0], ends[i >> 1 & 1, 1], ends[i >> 2, 2]] for i in range(8)])
        return cls.from_arrays(corners, _BOX_FACES)

    @classmethod
    def union(cls, solids: list[Solid]) -> Solid:
        """Unite all solids."""
        merged_manifold = manifold3d.Manifold.batch_boolean(
            [s.manifold for s in solids], manifold3d.OpType.Add
        )
        return cls(_check_status(merged_manifold, "joining solids"))

    @classmethod
    def hull(cls, points_mm: Floats) -> Solid:
        """Build the convex hull of points (n, 3) in mm."""
        return cls(_check_status(manifold3d.Manifold.hull_points(points_mm), "building a hull"))

    @classmethod
    def prism(cls, rings_mm: Sequence[Floats], frame: Floats, start_mm: float, end_mm: float) -> Solid:
        """Extrude a flat outline.

        Parameters
        ----------
        rings_mm
            Closed lines (n, 2), in coordinates along u and w, that do not cross; a line inside another one
            bounds a hole.
        frame
            (3, 3) orthonormal rows u, w and n.
        start_mm, end_mm
            Coordinates along n of both ends.
        """
        section = manifold3d.CrossSection(list(rings_mm), manifold3d.FillRule.EvenOdd)
        upright = manifold3d.Manifold.extrude(section, end_mm - start_mm)
        placed_manifold = upright.transform(np.column_stack([frame.T, frame[2] * start_mm]))
        return cls(_check_status(placed_manifold, "extruding an outline"))

    @property
    def is_empty(self) -> bool:
        """True if the solid has no triangles."""
        return bool(self.manifold.is_empty())

    @property
    def volume_mm3(self) -> float:
        """Enclosed volume."""
        return float(self.manifold.volume())

    @property
    def area_mm2(self) -> float:
        """Area of the surface."""
        return float(self.manifold.surface_area())

    @property
    def face_count(self) -> int:
        """Number of triangles."""
        return int(self.manifold.num_tri())

    @property
    def bounds_mm(self) -> Floats:
        """Least and greatest coordinates (2, 3)."""
        return np.array(self.manifold.bounding_box(), dtype=np.float64).reshape(2, 3)

    def arrays(self) -> tuple[Floats, Ints]:
        """Return the vertices (n, 3) in mm, and the faces (m, 3)."""
        mesh = self.manifold.to_mesh64()
        vertices = np.array(mesh.vert_properties, dtype=np.float64)[:, :3]
        return vertices, np.array(mesh.tri_verts, dtype=np.int64)

    def intersect(self, other: Solid) -> Solid:
        """Build the intersection with another solid."""
        return Solid(_check_status(self.manifold ^ other.manifold, "intersecting solids"))

    def subtract(self, other: Solid) -> Solid:
        """Subtract another solid."""
        return Solid(_check_status(self.manifold - other.manifold, "subtracting solids"))

    def clip(self, lo_mm: npt.ArrayLike, hi_mm: npt.ArrayLike) -> Solid:
        """Cut out the part inside an axis-aligned box.

        Parameters
        ----------
        lo_mm, hi_mm
            (3,) corners of the box in mm.
        """
        return self.intersect(Solid.box(lo_mm, hi_mm))

    def rotate(self, rotation: Floats) -> Solid:
        """Rotate every vertex v to ``rotation @ v`` by a rotation (3, 3)."""
        vertices, faces = self.arrays()
        return Solid.from_arrays(vertices @ rotation.T, faces)

    def translate(self, offset_mm: Floats) -> Solid:
        """Move the solid by an offset (3,) in mm."""
        return Solid(self.manifold.translate(tuple(offset_mm.tolist())))

    def simplify(self, *tolerances_mm: float, max_faces: int = 0) -> Solid:
        """Remove edges shorter than a tolerance, and flatten surfaces that are flat within this tolerance.

        Parameters
        ----------
        tolerances_mm
            Tolerances, applied one after the other until there are few enough triangles.
        max_faces
            Number of triangles that is few enough; 0 to apply all tolerances.
        """
        manifold = self.manifold
        for tolerance_mm in tolerances_mm:
            if manifold.num_tri() <= max_faces:
                break
            manifold = _check_status(manifold.simplify(tolerance_mm), "simplifying a solid")
        # Built again, because manifold3d would simplify every part that is cut out of it by this tolerance.
        return self if manifold is self.manifold else Solid.from_arrays(*Solid(manifold).arrays())

    def simplify_if_possible(self, *tolerances_mm: float, max_faces: int = 0) -> Solid:
        """Simplify the solid like `simplify`; return the same solid if nothing would remain of it."""
        try:
            simplified_solid = self.simplify(*tolerances_mm, max_faces=max_faces)
        except ModelNotSolid:
            return self
        return self if simplified_solid.is_empty else simplified_solid

    def measure_gap_mm(self, other: Solid, max_gap_mm: float) -> float:
        """Measure the exact distance to another solid in mm; 0 if they meet.

        Parameters
        ----------
        other
            Solid to which the distance is measured.
        max_gap_mm
            Maximum of the result; a larger distance is not measured.
        """
        return float(self.manifold.min_gap(other.manifold, max_gap_mm))

    def project(self, frame: Floats) -> list[Floats]:
        """Project the solid along the third row of an orthonormal frame (3, 3), onto the other two rows.

        Returns
        -------
        list of Floats
            Rings (n, 2) of the outline; holes have the opposite orientation.
        """
        rotated_manifold = self.manifold.transform(np.column_stack([frame, np.zeros(3)]))
        outline = manifold3d.CrossSection(
            rotated_manifold.project().to_polygons(), manifold3d.FillRule.Positive
        )
        return [np.asarray(ring, dtype=np.float64) for ring in outline.to_polygons()]

    def split(self, axis: int, coordinate_mm: float) -> tuple[Solid, Solid]:
        """Split the solid into the parts below and above a plane perpendicular to an axis.

        Parameters
        ----------
        axis
            Axis perpendicular to the plane, from 0 to 2.
        coordinate_mm
            Coordinate of the plane.
        """
        return self.split_by_plane(np.eye(3)[axis], coordinate_mm)

    def split_by_plane(self, normal: Floats, offset_mm: float) -> tuple[Solid, Solid]:
        """Split the solid into the parts below and above the plane ``normal @ x == offset_mm``.

        Parameters
        ----------
        normal
            (3,) unit normal of the plane.
        offset_mm
            Offset of the plane along its normal.
        """
        manifold_above, manifold_below = self.manifold.split_by_plane(tuple(normal.tolist()), offset_mm)
        return Solid(_check_status(manifold_below, "cutting a solid")), Solid(
            _check_status(manifold_above, "cutting a solid")
        )

    def keep_below(self, normal: Floats, offset_mm: float) -> Solid:
        """Keep the part below the plane ``normal @ x == offset_mm``.

        Parameters
        ----------
        normal
            (3,) unit normal of the plane.
        offset_mm
            Offset of the plane along its normal.
        """
        if self.is_empty:  # its bounds are infinite
            return self
        manifold_below = self.manifold.trim_by_plane(tuple((-normal).tolist()), -offset_mm)
        return Solid(_check_status(manifold_below, "cutting a solid"))

    def cut_section(self, frame: Floats, offset_mm: float) -> list[Floats]:
        """Cut the solid at a plane; return the outlines (n, 2): counterclockwise, or clockwise around holes.

        Parameters
        ----------
        frame
            (3, 3) right-handed unit vectors as rows: two along the plane, in whose coordinates the outlines
            are returned, and its normal.
        offset_mm
            Offset of the plane along its normal.
        """
        return self.cut_sections(frame, np.array([offset_mm]))[0]

    def cut_sections(self, frame: Floats, offsets_mm: Floats) -> list[list[Floats]]:
        """Cut the solid at parallel planes; this rotates the solid only once.

        Parameters
        ----------
        frame
            As in `cut_section`.
        offsets_mm
            (n,) offsets of the planes along their normal.

        Returns
        -------
        list
            Outlines in each plane.
        """
        rotated_manifold = self.manifold.transform(np.hstack([frame, np.zeros((3, 1))]))
        return [
            [np.asarray(ring, dtype=np.float64) for ring in rotated_manifold.slice(offset_mm).to_polygons()]
            for offset_mm in offsets_mm.tolist()
        ]

    def list_pieces(self) -> list[Solid]:
        """List the connected pieces, each with its cavities, in the order of their bounds."""
        if self.is_empty:
            return []
        surfaces = [Solid(_check_status(p, "separating pieces")) for p in self.manifold.decompose()]
        pieces = [s for s in surfaces if s.volume_mm3 > 0.0]
        for cavity in (s._turn_inside_out() for s in surfaces if s.volume_mm3 < 0.0):
            enclosing = [i for i, p in enumerate(pieces) if p._encloses(cavity)]
            if enclosing:  # if pieces are nested, the cavity belongs to the smallest one
                i = min(enclosing, key=lambda i: pieces[i].volume_mm3)
                pieces[i] = pieces[i].subtract(cavity)
        return sorted(pieces, key=lambda p: tuple(p.bounds_mm.ravel()))

    def _turn_inside_out(self) -> Solid:
        """Reverse all triangles."""
        vertices, faces = self.arrays()
        return Solid.from_arrays(vertices, faces[:, ::-1])

    def _encloses(self, other: Solid) -> bool:
        """Check whether another solid lies inside this one."""
        (lo_mm, hi_mm), (other_lo_mm, other_hi_mm) = self.bounds_mm, other.bounds_mm
        if (lo_mm > other_lo_mm).any() or (hi_mm < other_hi_mm).any():
            return False
        return self.intersect(other).volume_mm3 > 0.5 * other.volume_mm3


def triangulate(polygons: list[Floats]) -> Ints:
    """Fill polygons of any shape with triangles, without adding or omitting a point.

    Parameters
    ----------
    polygons
        Corners (n, 2) of each polygon; holes have the opposite orientation.

    Returns
    -------
    ndarray
        (k, 3) int64 indices among the corners of all polygons.
    """
    return np.asarray(manifold3d.triangulate(polygons), dtype=np.int64)
