"""Pieces into which an engine cuts the model, and the faces that the cuts leave on them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Floats, Ints
from decompose.geometry import Solid
from decompose.grid import Box, Grid
from decompose.jit import jit
from decompose.printers import TargetPrinter

PLANE_TOLERANCE_MM = 1e-7  # maximum distance of a vertex from its cut plane, due to rounding


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Connected piece of a model, without a pose.

    Attributes
    ----------
    solid
        Solid in the frame of the cut, in mm.
    planes
        (k, 4) planes ``n @ x == d`` at which the solid was cut: rows nx, ny, nz, d with a unit normal n.
    boxes_mm
        (b, 2, 3) corners of the axis-aligned boxes out of which the piece was cut; empty if it was cut in
        another way. Solid outside all boxes was left out.
    printer
        Printer for which the piece is cut; None if it has to fit all printers.
    time_ratio
        Ratio of the sliced time (the time that the slicer computes) to the price; 1 if it is not known.
    """

    solid: Solid
    planes: Floats
    boxes_mm: Floats
    printer: TargetPrinter | None = None
    time_ratio: float = 1.0

    @property
    def time_factor(self) -> float:
        """Ratio of the expected print time on the printer to the price."""
        return self.time_ratio * (1.0 if self.printer is None else self.printer.time_factor)


def sort_pieces(pieces: Iterable[Piece]) -> list[Piece]:
    """Sort pieces from the bottom up, which is the order in which parts are numbered."""
    return sorted(pieces, key=lambda p: tuple(np.round(p.solid.bounds_mm.mean(axis=0)[::-1], 3)))


def copy_printers(pieces: Sequence[Piece], old_pieces: Sequence[Piece]) -> list[Piece]:
    """Copy the printers and time ratios of old pieces to as many new ones, in the same order."""
    return [
        replace(piece, printer=old_piece.printer, time_ratio=old_piece.time_ratio)
        for piece, old_piece in zip(pieces, old_pieces, strict=True)
    ]


def cut_box(solid: Solid, lo_mm: npt.ArrayLike, hi_mm: npt.ArrayLike) -> list[Piece]:
    """Cut out the connected pieces of a solid in an axis-aligned box, in double precision.

    Parameters
    ----------
    solid
        Solid to cut; it is not changed.
    lo_mm, hi_mm
        (3,) corners of the box.
    """
    box = np.array([lo_mm, hi_mm], dtype=np.float64)
    planes = list_box_planes(box)
    return [Piece(piece, planes, box[None]) for piece in solid.clip(*box).list_pieces()]


def cut_cells(solid: Solid, grid: Grid, box: Box) -> list[Piece]:
    """Cut out the connected pieces of a solid in a box of cells.

    Parameters
    ----------
    solid
        Solid to cut; it is not changed.
    grid
        Grid over the solid; its outermost planes lie outside the solid.
    box
        Box in cells of the grid, half-open.
    """
    return cut_box(solid, *grid.find_bounds_mm(box))


def list_box_planes(box_mm: Floats) -> Floats:
    """List the planes (6, 4) of the sides of a box (2, 3)."""
    return np.array([[*np.eye(3)[axis], box_mm[side, axis]] for side in range(2) for axis in range(3)])


def find_face_planes(vertices: Floats, faces: Ints, planes: Floats) -> Ints:
    """Find the plane on which each face lies.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3).
    planes
        (k, 4) planes ``n @ x == d``: rows nx, ny, nz, d with a unit normal n.

    Returns
    -------
    ndarray
        (m,) number of the first plane that contains the face; -1 if there is none.
    """
    return _find_face_planes(
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(faces, np.int64),
        np.ascontiguousarray(planes, np.float64),
    )


@jit
def _find_face_planes(vertices: Floats, faces: Ints, planes: Floats) -> Ints:
    """Find the plane on which each face lies; see `find_face_planes`."""
    is_on_plane = np.zeros((len(planes), len(vertices)), np.bool_)
    for k in range(len(planes)):
        for i in range(len(vertices)):
            distance_mm = -planes[k, 3]
            for axis in range(3):
                distance_mm += vertices[i, axis] * planes[k, axis]
            is_on_plane[k, i] = abs(distance_mm) < PLANE_TOLERANCE_MM
    face_planes = np.full(len(faces), -1, np.int64)
    for i in range(len(faces)):
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        for k in range(len(planes)):
            if is_on_plane[k, a] and is_on_plane[k, b] and is_on_plane[k, c]:
                face_planes[i] = k
                break
    return face_planes


def find_cut_faces(vertices: Floats, faces: Ints, planes: Floats) -> Bools:
    """Find the faces (m,) that lie on one of several planes; see `find_face_planes`."""
    return find_face_planes(vertices, faces, planes) >= 0


def rotate_planes(planes: Floats, rotation: Floats) -> Floats:
    """Rotate planes.

    Parameters
    ----------
    planes
        (k, 4) planes ``n @ x == d``: rows nx, ny, nz, d.
    rotation
        (3, 3) rotation, ``v_new = rotation @ v``.

    Returns
    -------
    ndarray
        (k, 4) planes.
    """
    return np.hstack([planes[:, :3] @ rotation.T, planes[:, 3:]])
