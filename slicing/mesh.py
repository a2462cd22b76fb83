"""Binary STL of a part, and waves in its flat sides where CuraEngine would lose a corner.

CuraEngine 4.13 loses a corner if the product of the lengths of its two sides is 2**32 um2 (see
`slicing.plate`). Where a part widens slowly with its height, some layer always has such a corner, whatever
the expansion of the part. A wave of hundredths of a mm divides each long flat side, so that no corner has two
long sides.
"""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt
import trimesh
from trimesh.exchange.stl import HeaderError, export_stl, load_stl_binary

from slicing.errors import Rule, SliceRejected

Floats = npt.NDArray[np.float64]

# Distances along x and y from crest to trough: the product of two sides stays below 2**32 um2.
HALF_PERIODS_MM = (29.0, 23.0)
WAVE_HEIGHT_MM = 0.03  # CuraEngine may flatten a smaller wave
POINT_TOLERANCE_MM = 1e-6


def read_triangles(stl: bytes) -> Floats:
    """Read a binary STL.

    `trimesh.load_mesh` gives an empty mesh for a truncated file, so its reader is called directly.

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
        `BROKEN_MESH` if it is not a binary STL, is cut short, has no facets, or a coordinate is not finite.
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


def add_waves(corners: Floats) -> Floats:
    """Add a wave to long flat sides: cut triangles at its crests, and move each point along x and y.

    The wave is linear between the cuts: flat areas between them stay flat, and a closed mesh stays closed.

    Parameters
    ----------
    corners
        (n, 3 corners, xyz) Triangles in mm.

    Returns
    -------
    ndarray
        (m, 3, 3) Triangles in mm.
    """
    for axis, half_period_mm in enumerate(HALF_PERIODS_MM):
        first, last = corners[..., axis].min() / half_period_mm, corners[..., axis].max() / half_period_mm
        for multiple in range(int(np.ceil(first)), int(np.floor(last)) + 1):
            corners = _cut_triangles(corners, axis, multiple * half_period_mm)
    result = corners.copy()
    for axis, other_axis in ((0, 1), (1, 0)):
        phase = corners[..., other_axis] / HALF_PERIODS_MM[other_axis]
        result[..., axis] += WAVE_HEIGHT_MM * np.abs(phase % 2.0 - 1.0)
    return result


def _cut_triangles(corners: Floats, axis: int, plane_mm: float) -> Floats:
    """Cut triangles (n, 3, 3) at a plane; none of the results lies on both of its sides.

    Both triangles of an edge are cut at exactly the same point.
    """
    side = np.sign(
        np.where(
            np.abs(corners[..., axis] - plane_mm) < POINT_TOLERANCE_MM, 0.0, corners[..., axis] - plane_mm
        )
    )
    is_crossed = (side.max(axis=1) > 0.0) & (side.min(axis=1) < 0.0)
    has_corner_on_plane = is_crossed & (side == 0.0).any(axis=1)
    is_cut_twice = is_crossed & ~has_corner_on_plane
    on_plane, a, b = _roll_corners(corners[has_corner_on_plane], side[has_corner_on_plane] == 0.0)
    middle = _interpolate_edges(a, b, axis, plane_mm)
    tip, c, d = _roll_corners(
        corners[is_cut_twice], side[is_cut_twice] == -np.sign(side[is_cut_twice].sum(axis=1))[:, None]
    )
    p, q = _interpolate_edges(tip, c, axis, plane_mm), _interpolate_edges(tip, d, axis, plane_mm)
    new_triangles = [(on_plane, a, middle), (on_plane, middle, b), (tip, p, q), (p, c, d), (p, d, q)]
    return np.concatenate(
        [corners[~is_crossed], *(np.stack(corner_set, axis=1) for corner_set in new_triangles)]
    )


def _roll_corners(corners: Floats, is_first: npt.NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
    """Rotate the order of each triangle's corners to begin with the one that a mask (n, 3) marks."""
    rows, start = np.arange(len(corners)), is_first.argmax(axis=1)
    return corners[rows, start], corners[rows, (start + 1) % 3], corners[rows, (start + 2) % 3]


def _interpolate_edges(a: Floats, b: Floats, axis: int, plane_mm: float) -> Floats:
    """Find the points (n, 3) at which edges meet a plane; the ends may come in either order."""
    is_swapped = (a[:, axis] > b[:, axis])[:, None]
    low, high = np.where(is_swapped, b, a), np.where(is_swapped, a, b)
    share = (plane_mm - low[:, axis]) / (high[:, axis] - low[:, axis])
    points: Floats = low + share[:, None] * (high - low)
    points[:, axis] = plane_mm
    return points
