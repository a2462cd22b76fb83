"""Binary STL, the file format of parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from decompose.arrays import Floats, Ints
from decompose.files.triangle_limit import STL_COUNT_BYTES, STL_FACE_BYTES, STL_HEADER_BYTES
from decompose.geometry.weld import count_edge_uses, number_rows

_FACE_DTYPE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])


def round_triangles(vertices: Floats, faces: Ints) -> npt.NDArray[np.float32] | None:
    """Round triangles to the precision of the format, and leave out those that collapse.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh.

    Returns
    -------
    ndarray or None
        (k, 3, 3) float32; None if the surface would not stay closed, because features that are thinner than
        the precision touch each other.
    """
    points = vertices.astype(np.float32)
    f = _number_points(points)[faces]
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    uses = count_edge_uses(f)
    return points[f] if len(f) and uses.is_closed and not uses.repeated_count else None


def _number_points(points: npt.NDArray[np.float32]) -> Ints:
    """Number points (n, 3); equal points have the number (n,) of the first of them."""
    bits = (points + np.float32(0.0)).view(np.int32).astype(np.int64)  # the sum makes -0.0 equal to 0.0
    numbers, first_points = number_rows(bits, 1.0)
    return first_points[numbers]


def separate_touching_surfaces(vertices: Floats, faces: Ints, distance_mm: float) -> Floats:
    """Move vertices at the same position towards their own faces, to separate surfaces that touch there.

    Where two bodies or two hollows touch, each of them has a vertex of its own, to which only its own faces
    belong. Positions are the same if they are equal after rounding to single precision.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh; surfaces that touch do not share vertices.
    distance_mm
        Distance by which a vertex is moved.

    Returns
    -------
    ndarray
        (n, 3) vertices in mm, in the same order.
    """
    position = _number_points(vertices.astype(np.float32))
    touches = np.bincount(position, minlength=len(vertices))[position] > 1
    to_middles = vertices[faces].mean(axis=1, keepdims=True) - vertices[faces]  # (m, 3 corners, 3)
    lengths_mm = np.linalg.norm(to_middles, axis=2, keepdims=True)
    directions = np.zeros_like(vertices)
    np.add.at(directions, faces, to_middles / np.maximum(lengths_mm, np.finfo(np.float64).tiny))
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    moves_mm = distance_mm * directions / np.maximum(lengths, np.finfo(np.float64).tiny)
    return vertices + np.where(touches[:, None], moves_mm, 0.0)


def write_stl(path: Path, corners: npt.NDArray[np.float32]) -> None:
    """Write triangles, unchanged, to a binary STL.

    Parameters
    ----------
    path
        File to write.
    corners
        (m, 3, 3) float32 in mm, from `round_triangles`.
    """
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    mesh: Any = trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
    path.write_bytes(mesh.export(file_type="stl"))


def parse_triangles(data: bytes) -> Floats:
    """Parse the triangles (m, 3, 3) float64 of a complete binary STL, without copying its other fields."""
    begin = STL_HEADER_BYTES + STL_COUNT_BYTES
    faces = np.frombuffer(data, dtype=_FACE_DTYPE, count=(len(data) - begin) // STL_FACE_BYTES, offset=begin)
    with np.errstate(all="ignore"):  # NaN is refused later
        return faces["corners"].astype(np.float64)


def count_stored_faces(data: bytes) -> float:
    """Compute the number of faces for which a binary STL has bytes; a fraction if a face is incomplete."""
    return max(0, len(data) - STL_HEADER_BYTES - STL_COUNT_BYTES) / STL_FACE_BYTES
