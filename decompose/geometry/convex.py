"""Convex outline of points in a plane, compiled because every pose of every part needs it."""

from __future__ import annotations

import numpy as np

from decompose.arrays import Floats
from decompose.jit import jit

COLLINEARITY_TOLERANCE_MM2 = 1e-9  # corners are collinear if twice the area of their triangle is less
MIN_FILTERED_POINTS = 64  # minimum number of points for which it is worthwhile to drop inner points first
MIN_INSIDE_MM2 = 1e-6  # points with a smaller cross product with an edge of the octagon are kept


@jit
def find_convex_outline(points: Floats) -> Floats:
    """Find the corners of the convex outline around points, counterclockwise.

    Source: A. M. Andrew, "Another efficient algorithm for convex hulls in two dimensions", 1979.

    Parameters
    ----------
    points
        (n, 2) float64 in mm.

    Returns
    -------
    ndarray
        (k, 2) float64 in mm; (0, 2) if the points span no area.
    """
    points = _drop_inner_points(points)
    order = np.argsort(points[:, 1], kind="mergesort")
    order = order[np.argsort(points[order, 0], kind="mergesort")]
    n = len(order)
    chain = np.zeros((2 * n + 1, 2))
    count = 0
    for half in range(2):  # the lower side from left to right, the upper one back
        begin = count
        for k in range(n):
            x, y = points[order[k if half == 0 else n - 1 - k]]
            while count >= begin + 2:
                ax, ay = chain[count - 2]
                bx, by = chain[count - 1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > COLLINEARITY_TOLERANCE_MM2:
                    break
                count -= 1
            chain[count, 0], chain[count, 1] = x, y
            count += 1
        count -= 1  # the last point begins the other half
    return chain[:count].copy() if count >= 3 else np.zeros((0, 2))


@jit
def _drop_inner_points(points: Floats) -> Floats:
    """Drop most points inside the convex outline, which takes less time than sorting them.

    The dropped points lie inside an octagon, whose corners are the points furthest in eight directions.

    Source: S. G. Akl, G. T. Toussaint, "A fast convex hull algorithm", 1978.

    Parameters
    ----------
    points
        (n, 2) float64 in mm.

    Returns
    -------
    ndarray
        (k, 2) float64 in mm, in the same order.
    """
    if len(points) < MIN_FILTERED_POINTS:
        return points
    furthest, furthest_mm = np.zeros(8, np.int64), np.full(8, -np.inf)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        for k, along_mm in enumerate((x, x + y, y, y - x, -x, -x - y, -y, x - y)):
            if along_mm > furthest_mm[k]:
                furthest[k], furthest_mm[k] = i, along_mm
    kept, count = np.zeros((len(points), 2)), 0
    for i in range(len(points)):
        is_inside = True
        for k in range(8):
            a, b = furthest[k], furthest[(k + 1) % 8]
            if a == b:
                continue
            side_mm2 = (points[b, 0] - points[a, 0]) * (points[i, 1] - points[a, 1])
            side_mm2 -= (points[b, 1] - points[a, 1]) * (points[i, 0] - points[a, 0])
            if side_mm2 <= MIN_INSIDE_MM2:
                is_inside = False
                break
        if not is_inside:
            kept[count] = points[i]
            count += 1
    return kept[:count].copy()


@jit
def find_half_planes(outline: Floats) -> Floats:
    """Find the half-planes of an outline.

    Parameters
    ----------
    outline
        (k, 2) float64 in mm, counterclockwise, from `find_convex_outline`.

    Returns
    -------
    ndarray
        (k, 3) float64 half-planes h, rows of an outward unit normal and an offset in mm: points p inside the
        outline have ``h[:, :2] @ p + h[:, 2] <= 0``.
    """
    edges = np.zeros((len(outline), 3))
    for i in range(len(outline)):
        a, b = outline[i], outline[(i + 1) % len(outline)]
        length_mm = np.hypot(b[0] - a[0], b[1] - a[1])
        nx, ny = (b[1] - a[1]) / length_mm, (a[0] - b[0]) / length_mm
        edges[i, 0], edges[i, 1], edges[i, 2] = nx, ny, -(nx * a[0] + ny * a[1])
    return edges


@jit
def measure_rectangles(outline: Floats, angles_rad: Floats) -> Floats:
    """Measure the bounding rectangle of an outline that is rotated clockwise by each of n angles.

    Parameters
    ----------
    outline
        (k, 2) float64 in mm, from `find_convex_outline`.
    angles_rad
        (n,) float64 in radians.

    Returns
    -------
    ndarray
        (n, 2) float64 width and depth in mm.
    """
    sides = np.zeros((len(angles_rad), 2))
    for i in range(len(angles_rad)):
        ux, uy = np.cos(angles_rad[i]), np.sin(angles_rad[i])
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        for k in range(len(outline)):
            u = outline[k, 0] * ux + outline[k, 1] * uy
            v = outline[k, 1] * ux - outline[k, 0] * uy
            low[0], high[0] = min(low[0], u), max(high[0], u)
            low[1], high[1] = min(low[1], v), max(high[1], v)
        sides[i] = high - low
    return sides


@jit
def find_smallest_rectangle_angle_rad(outline: Floats) -> float:
    """Find the angle of the long side of the smallest rectangle around an outline.

    Parameters
    ----------
    outline
        (k, 2) float64 in mm, from `find_convex_outline`.

    Returns
    -------
    float
        Angle in radians.
    """
    best_mm2, angle_rad = np.inf, 0.0
    for i in range(len(outline)):
        a, b = outline[i], outline[(i + 1) % len(outline)]
        side_mm = np.hypot(b[0] - a[0], b[1] - a[1])
        ux, uy = (b[0] - a[0]) / side_mm, (b[1] - a[1]) / side_mm
        low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
        for k in range(len(outline)):
            along_edge = outline[k, 0] * ux + outline[k, 1] * uy
            across = outline[k, 1] * ux - outline[k, 0] * uy
            low_u, high_u = min(low_u, along_edge), max(high_u, along_edge)
            low_v, high_v = min(low_v, across), max(high_v, across)
        u, v = high_u - low_u, high_v - low_v
        if u * v < best_mm2 - 1e-6:  # of rectangles of equal size, the first one is taken
            best_mm2 = u * v
            angle_rad = np.arctan2(uy, ux) if u >= v else np.arctan2(ux, -uy)
    return float(angle_rad)
