"""Kernel of the grid: each triangle clipped to the cells that it crosses, and what it adds to them."""

from __future__ import annotations

import numpy as np

from decompose.arrays import Floats
from decompose.jit import jit

# Columns of `Grid.sums`, each a sum over a cell. The pose indices are those of `decompose.cost`.
VOLUME = 0


LATERAL = 1  # 3 columns, one for each axis as up


SKIN = 4  # 3 columns


SLOPE = 7  # 3 columns: lateral area of the faces that have skin


OVERHANG = 10  # 6 columns: projected area of faces that look down in a pose


MOMENT = 16  # 6 columns: the same times coordinate along the axis


SUMS = 22


@jit
def clip_into_cells(
    triangles: Floats, px: Floats, py: Floats, pz: Floats, skin_cos: float, overhang_cos: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Clip every triangle to the cells it crosses and add up.

    Returns area (nx, ny, nz), flux (nx, ny, nz, 4) = A n and the moment A nx (x - x0), sums without the
    volume, extents of the surface.
    """
    nx, ny, nz = len(px) - 1, len(py) - 1, len(pz) - 1
    area = np.zeros((nx, ny, nz))
    flux = np.zeros((nx, ny, nz, 4))
    sums = np.zeros((nx, ny, nz, SUMS))
    extents = np.full((nx, ny, nz, 6), np.inf)
    extents[:, :, :, 3:] = -np.inf
    planes = (px, py, pz)
    poly = np.zeros((4, 12, 3))  # the polygon after 0, 1, 2, 3 axes
    half = np.zeros((12, 3))
    count = np.zeros(4, np.int64)
    first = np.zeros(3, np.int64)
    last = np.zeros(3, np.int64)
    at = np.zeros(3, np.int64)
    normal = np.zeros(3)
    for t in range(len(triangles)):
        poly[0, :3] = triangles[t]
        count[0] = 3
        e1 = triangles[t, 1] - triangles[t, 0]
        e2 = triangles[t, 2] - triangles[t, 0]
        normal[0] = e1[1] * e2[2] - e1[2] * e2[1]
        normal[1] = e1[2] * e2[0] - e1[0] * e2[2]
        normal[2] = e1[0] * e2[1] - e1[1] * e2[0]
        length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        if length == 0.0:
            continue
        normal /= length
        axis = 0
        entering = True
        while axis >= 0:  # walk the slabs of x, within each those of y, within each those of z
            p = planes[axis]
            if entering:
                lo = np.inf
                hi = -np.inf
                for i in range(count[axis]):
                    lo = min(lo, poly[axis, i, axis])
                    hi = max(hi, poly[axis, i, axis])
                first[axis] = max(0, int(np.searchsorted(p, lo, side="right")) - 1)
                last[axis] = min(len(p) - 2, int(np.searchsorted(p, hi, side="left")) - 1)
                last[axis] = max(last[axis], first[axis])
                at[axis] = first[axis]
                entering = False
            if at[axis] > last[axis]:
                axis -= 1
                if axis >= 0:
                    at[axis] += 1
                continue
            # Clip by the two planes of the slab (Sutherland-Hodgman).
            n = count[axis]
            m = 0
            low = p[at[axis]]
            for i in range(n):
                a = poly[axis, i]
                b = poly[axis, (i + 1) % n]
                if a[axis] >= low:
                    half[m] = a
                    m += 1
                if (a[axis] > low and b[axis] < low) or (a[axis] < low and b[axis] > low):
                    s = (low - a[axis]) / (b[axis] - a[axis])
                    half[m] = a + s * (b - a)
                    half[m, axis] = low
                    m += 1
            n = m
            m = 0
            high = p[at[axis] + 1]
            for i in range(n):
                a = half[i]
                b = half[(i + 1) % n]
                if a[axis] <= high:
                    poly[axis + 1, m] = a
                    m += 1
                if (a[axis] > high and b[axis] < high) or (a[axis] < high and b[axis] > high):
                    s = (high - a[axis]) / (b[axis] - a[axis])
                    poly[axis + 1, m] = a + s * (b - a)
                    poly[axis + 1, m, axis] = high
                    m += 1
            if m < 3:
                at[axis] += 1
                continue
            count[axis + 1] = m
            if axis < 2:
                axis += 1
                entering = True
                continue
            # A fragment in one cell: its area and centroid by a fan of triangles.
            piece = poly[3]
            whole = 0.0
            centre = np.zeros(3)
            for i in range(1, m - 1):
                u = piece[i] - piece[0]
                v = piece[i + 1] - piece[0]
                a2 = (
                    (u[1] * v[2] - u[2] * v[1]) * normal[0]
                    + (u[2] * v[0] - u[0] * v[2]) * normal[1]
                    + (u[0] * v[1] - u[1] * v[0]) * normal[2]
                ) / 2.0
                whole += a2
                centre += a2 * (piece[0] + piece[i] + piece[i + 1]) / 3.0
            if whole > 1e-12:
                centre /= whole
                x, y, z = at[0], at[1], at[2]
                area[x, y, z] += whole
                for i in range(m):
                    for k in range(3):
                        extents[x, y, z, k] = min(extents[x, y, z, k], piece[i, k])
                        extents[x, y, z, k + 3] = max(extents[x, y, z, k + 3], piece[i, k])
                flux[x, y, z, 3] += whole * normal[0] * (centre[0] - px[x])
                for k in range(3):
                    c = normal[k]
                    flux[x, y, z, k] += whole * c
                    upright = whole * np.sqrt(max(0.0, 1.0 - c * c))
                    sums[x, y, z, LATERAL + k] += upright
                    if abs(c) > skin_cos:
                        sums[x, y, z, SKIN + k] += whole * abs(c)
                        sums[x, y, z, SLOPE + k] += upright
                    if abs(c) > overhang_cos:
                        pose = 2 * k if c < 0.0 else 2 * k + 1
                        sums[x, y, z, OVERHANG + pose] += whole * abs(c)
                        sums[x, y, z, MOMENT + pose] += whole * abs(c) * centre[k]
            at[2] += 1
    return area, flux, sums, extents
