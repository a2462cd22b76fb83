"""Triangles of a binary STL, read and written by trimesh; what cannot be sliced is refused."""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt
import trimesh
from trimesh.exchange.stl import HeaderError, export_stl, load_stl_binary

from slicing.errors import Rule, SliceRejected

Floats = npt.NDArray[np.float64]


def read_triangles(stl: bytes) -> Floats:
    """Read a binary STL.

    `trimesh.load_mesh` gives an empty mesh for a file that is cut short, so its reader is called directly.

    Parameters
    ----------
    stl
        The whole file.

    Returns
    -------
    ndarray
        (n, 3 corners, xyz) Triangles in mm.

    Raises
    ------
    SliceRejected
        `BROKEN_MESH` where it is no binary STL, cut short, without facets, or with a number not finite.
    """
    try:
        corners = load_stl_binary(io.BytesIO(stl))["vertices"]
    except HeaderError as error:
        raise SliceRejected(Rule.BROKEN_MESH, f"not a binary STL, or cut short: {error}") from error
    except KeyError:  # from trimesh's reader, for 0 facets
        raise SliceRejected(Rule.BROKEN_MESH, "the STL has no facets") from None
    if not np.isfinite(corners).all():
        raise SliceRejected(Rule.BROKEN_MESH, "the STL has a coordinate that is not a finite number")
    return np.asarray(corners, np.float64).reshape(-1, 3, 3)


def write_triangles(corners: npt.NDArray[np.floating]) -> bytes:
    """Write triangles (n, 3 corners, xyz) in mm as a binary STL."""
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
    return bytes(export_stl(mesh))
