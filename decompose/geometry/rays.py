"""Vertical rays through a mesh: the heights at which they cross faces, and their stretches in the solid."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.jit import jit, jit_inline


class Rays(NamedTuple):
    """Vertical rays on a square grid.

    Attributes
    ----------
    origin_mm
        (2,) float64 x and y of the first ray.
    step_mm
        Distance between neighbours.
    shape
        Number of rays along x and along y.
    """

    origin_mm: Floats
    step_mm: float
    shape: tuple[int, int]


class Crossings(NamedTuple):
    """Crossings of rays with the faces of a mesh, ray after ray, from the bottom up.

    Attributes
    ----------
    start
        (rays + 1,) int64 index of the first crossing of each ray.
    z_mm
        (crossings,) float64 heights.
    face
        (crossings,) int64 indices of the faces.
    """

    start: Ints
    z_mm: Floats
    face: Ints


def place_rays(lo_mm: Floats, hi_mm: Floats, step_mm: float) -> Rays:
    """Place rays over a rectangle, at an irregular offset from its corner.

    The offset avoids rays through edges of a mesh, which could count twice or not at all.

    Parameters
    ----------
    lo_mm, hi_mm
        Corners of the rectangle; only x and y are used.
    step_mm
        Distance between rays.
    """
    width_mm, depth_mm = (hi_mm - lo_mm)[:2].tolist()
    origin_mm = lo_mm[:2] + step_mm * (0.5 + np.array([0.0123, 0.0271]))
    return Rays(origin_mm, step_mm, (math.ceil(width_mm / step_mm), math.ceil(depth_mm / step_mm)))


@jit
def find_bounds(corners: Floats) -> tuple[Floats, Floats]:
    """Find the bounds of triangles, or of points.

    Parameters
    ----------
    corners
        (m, k, 3) float64 in mm; k is 3 for triangles, and 1 for points.

    Returns
    -------
    tuple
        (3,) float64 least x, y and z, and (3,) float64 greatest x, y and z, in mm.
    """
    lo_mm, hi_mm = np.full(3, np.inf), np.full(3, -np.inf)
    for t in range(len(corners)):
        for corner in range(corners.shape[1]):
            for axis in range(3):
                coordinate = corners[t, corner, axis]
                if coordinate < lo_mm[axis]:
                    lo_mm[axis] = coordinate
                if coordinate > hi_mm[axis]:
                    hi_mm[axis] = coordinate
    return lo_mm, hi_mm


@jit
def compute_unit_normals(triangles: Floats) -> Floats:
    """Compute the unit normals of triangles.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64.

    Returns
    -------
    ndarray
        (m, 3) float64; 0 for a triangle without area.
    """
    normals = np.zeros((len(triangles), 3))
    for t in range(len(triangles)):
        ax, ay, az = triangles[t, 0, 0], triangles[t, 0, 1], triangles[t, 0, 2]
        ux, uy, uz = triangles[t, 1, 0] - ax, triangles[t, 1, 1] - ay, triangles[t, 1, 2] - az
        vx, vy, vz = triangles[t, 2, 0] - ax, triangles[t, 2, 1] - ay, triangles[t, 2, 2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 0.0:
            normals[t, 0], normals[t, 1], normals[t, 2] = nx / length, ny / length, nz / length
    return normals


@jit
def find_crossings(triangles: Floats, normals: Floats, rays: Rays) -> Crossings:
    """Find the crossings of rays with the triangles of a mesh.

    A ray through the common edge of two triangles crosses only one of them: an edge belongs to the triangle
    on its side of greater y.

    Parameters
    ----------
    triangles, normals
        (m, 3, 3) float64 in mm, and their (m, 3) float64 unit normals.
    rays
        Vertical rays.
    """
    ny = rays.shape[1]
    rows, counts = _find_crossed_rows(triangles, normals, rays)
    crossings = _allocate_crossings(counts)
    fill_counts = np.zeros(len(counts) - 1, np.int64)
    (x0, y0), step_mm = rays.origin_mm, rays.step_mm
    for k in range(len(rows)):
        t, i = rows[k, 0], rows[k, 1]
        (ax, ay, az), slope_x, slope_y, (lowest, highest) = _compute_plane(triangles, normals, t)
        row_z = az + (x0 + i * step_mm - ax) * slope_x
        for j in range(rows[k, 2], rows[k, 3]):
            z = row_z + (y0 + j * step_mm - ay) * slope_y
            column = i * ny + j
            _insert_crossing(crossings, column, fill_counts[column], min(max(z, lowest), highest), t)
            fill_counts[column] += 1
    return crossings


@jit
def _find_crossed_rows(triangles: Floats, normals: Floats, rays: Rays) -> tuple[Ints, Ints]:
    """Find the rays of constant x that cross each triangle.

    Parameters
    ----------
    triangles, normals, rays
        As in `find_crossings`.

    Returns
    -------
    tuple
        (rows, 4) int64: triangle, index along x, and half-open range of the indices along y. Then 0 and the
        number of crossings of each ray, (rays + 1,) int64.
    """
    x0, y0, step_mm = rays.origin_mm[0], rays.origin_mm[1], rays.step_mm
    nx, ny = rays.shape
    counts = np.zeros(nx * ny + 1, np.int64)
    rows, row_count = np.zeros((len(triangles) + 4 * nx, 4), np.int64), 0
    edges = np.zeros((3, 4))
    for t in range(len(triangles)):
        if normals[t, 2] == 0.0:
            continue
        (first_x, end_x), (first_y, end_y) = _find_ray_rectangle(triangles, t, rays)
        if first_x >= end_x or first_y >= end_y:  # most triangles of a fine mesh are between the rays
            continue
        _set_edges(triangles, t, edges)
        if row_count + end_x - first_x > len(rows):
            more_rows = np.zeros((2 * len(rows) + end_x - first_x, 4), np.int64)
            more_rows[:row_count] = rows[:row_count]
            rows = more_rows
        for i in range(first_x, end_x):
            low, high = _find_edge_span(edges, x0 + i * step_mm)
            if low > high:
                continue
            begin, end = _find_ray_range(low, high, y0, step_mm, ny)
            if begin >= end:
                continue
            rows[row_count, 0], rows[row_count, 1] = t, i
            rows[row_count, 2], rows[row_count, 3] = begin, end
            row_count += 1
            for column in range(i * ny + begin, i * ny + end):
                counts[column + 1] += 1
    return rows[:row_count], counts


@jit_inline
def find_stretch(crossings: Crossings, normals: Floats, first: int, end: int) -> tuple[int, int]:
    """Find the first stretch of a ray within the solid.

    Parameters
    ----------
    crossings
        Crossings of all rays.
    normals
        (m, 3) float64 unit normals of the faces.
    first, end
        Half-open range of the crossings that are searched; the ray is outside the solid before the first.

    Returns
    -------
    tuple
        Indices of the crossings at which the ray enters and leaves; `end` for a crossing that does not exist.
    """
    depth, entry = 0, end
    for k in range(first, end):
        if normals[crossings.face[k], 2] < 0.0:
            depth += 1
            if depth == 1:
                entry = k
        else:
            depth -= 1
            if depth == 0:
                return entry, k
    return entry, end


@jit
def _allocate_crossings(counts: Ints) -> Crossings:
    """Allocate the crossings of all rays.

    Parameters
    ----------
    counts
        (rays + 1,) int64: 0, then the number of crossings of each ray; becomes `start` of the crossings.
    """
    for ray in range(len(counts) - 1):
        counts[ray + 1] += counts[ray]
    return Crossings(counts, np.zeros(counts[-1], np.float64), np.zeros(counts[-1], np.int64))


@jit_inline
def _find_ray_rectangle(triangles: Floats, t: int, rays: Rays) -> tuple[tuple[int, int], tuple[int, int]]:
    """Find the half-open ranges, along x and along y, of the rays through the bounding box of a triangle.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm.
    t
        Index of the triangle.
    rays
        Vertical rays.
    """
    left_x = min(triangles[t, 0, 0], triangles[t, 1, 0], triangles[t, 2, 0])
    right_x = max(triangles[t, 0, 0], triangles[t, 1, 0], triangles[t, 2, 0])
    low_y = min(triangles[t, 0, 1], triangles[t, 1, 1], triangles[t, 2, 1])
    high_y = max(triangles[t, 0, 1], triangles[t, 1, 1], triangles[t, 2, 1])
    return (
        _find_ray_range(left_x, right_x, rays.origin_mm[0], rays.step_mm, rays.shape[0]),
        _find_ray_range(low_y, high_y, rays.origin_mm[1], rays.step_mm, rays.shape[1]),
    )


@jit_inline
def _find_ray_range(
    low_mm: float, high_mm: float, origin_mm: float, step_mm: float, count: int
) -> tuple[int, int]:
    """Find the half-open range of the rays between two coordinates along an axis.

    Parameters
    ----------
    low_mm, high_mm
        Coordinates.
    origin_mm, step_mm, count
        Coordinate of the first ray, distance between rays, and number of rays.
    """
    begin = max(0, int(np.ceil((low_mm - origin_mm) / step_mm)))
    return begin, min(count, int(np.ceil((high_mm - origin_mm) / step_mm)))


@jit_inline
def _set_edges(triangles: Floats, t: int, edges: Floats) -> None:
    """Describe the edges of a triangle as seen from above.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm.
    t
        Index of the triangle.
    edges
        (3, 4) float64, filled in: x of the left and of the right end, y of the left end, and slope.
    """
    for k in range(3):
        p, q = k, (k + 1) % 3
        if triangles[t, p, 0] > triangles[t, q, 0]:
            p, q = q, p  # so that both triangles of an edge compute the same y
        px, qx = triangles[t, p, 0], triangles[t, q, 0]
        edges[k, 0], edges[k, 1], edges[k, 2] = px, qx, triangles[t, p, 1]
        edges[k, 3] = (triangles[t, q, 1] - triangles[t, p, 1]) / (qx - px) if qx > px else 0.0


@jit_inline
def _find_edge_span(edges: Floats, x: float) -> tuple[float, float]:
    """Find the least and the greatest y at which a line of constant x crosses the edges of a triangle.

    Parameters
    ----------
    edges
        (3, 4) float64 from `_set_edges`.
    x
        Coordinate of the line in mm.

    Returns
    -------
    tuple
        y in mm; +inf and -inf if the line crosses no edge.
    """
    low, high = np.inf, -np.inf
    for k in range(3):
        if edges[k, 0] < x <= edges[k, 1]:
            y = edges[k, 2] + (x - edges[k, 0]) * edges[k, 3]
            low, high = min(low, y), max(high, y)
    return low, high


@jit_inline
def _compute_plane(
    triangles: Floats, normals: Floats, t: int
) -> tuple[tuple[float, float, float], float, float, tuple[float, float]]:
    """Compute the plane of a triangle.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm.
    normals
        (m, 3) float64 unit normals of the triangles.
    t
        Index of the triangle.

    Returns
    -------
    tuple
        A corner in mm, the slopes of z along x and y, and the least and the greatest z of the corners.
    """
    ax, ay, az = triangles[t, 0, 0], triangles[t, 0, 1], triangles[t, 0, 2]
    lowest = min(az, triangles[t, 1, 2], triangles[t, 2, 2])
    highest = max(az, triangles[t, 1, 2], triangles[t, 2, 2])
    up = normals[t, 2]
    return (ax, ay, az), -normals[t, 0] / up, -normals[t, 1] / up, (lowest, highest)


@jit_inline
def _insert_crossing(crossings: Crossings, ray: int, count: int, z_mm: float, face: int) -> None:
    """Insert a crossing among those of a ray, in the order of heights.

    Parameters
    ----------
    crossings
        Crossings of all rays; updated in place.
    ray, count
        Index of the ray, and number of its crossings so far.
    z_mm, face
        Height in mm, and index of the face.
    """
    first = crossings.start[ray]
    index = first + count
    while index > first and crossings.z_mm[index - 1] > z_mm:
        crossings.z_mm[index], crossings.face[index] = crossings.z_mm[index - 1], crossings.face[index - 1]
        index -= 1
    crossings.z_mm[index], crossings.face[index] = z_mm, face
