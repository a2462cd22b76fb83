"""Kernels that clip triangles to the cells of a grid, and add their fragments to the sums of the cells."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.geometry.rays import compute_unit_normals
from decompose.jit import jit, jit_inline

# Columns of `Grid.sums`, each a sum over a cell. The pose indices are those of `print_time.pose_prices`.
VOLUME = 0  # in mm3
LATERAL_AREA = 1  # 3 columns in mm2, one for each axis that may point up
SKIN = 4  # 3 columns: projected area in mm2 of the faces that have skin
SLOPE = 7  # 3 columns: lateral area in mm2 of the faces that have skin
OVERHANG = 10  # 6 columns: projected area in mm2 of the faces that overhang in a pose
MOMENT = 16  # 6 columns in mm3: the area of `OVERHANG` times its coordinate along the axis of the pose
SUM_COUNT = 22

MIN_FRAGMENT_MM2 = 1e-12  # smaller fragments are ignored

Planes = tuple[Floats, Floats, Floats]


class CellContents(NamedTuple):
    """Sums over the surface in each cell, float64.

    Attributes
    ----------
    area_mm2
        (nx, ny, nz) area of the surface in mm2.
    flux
        (nx, ny, nz, 4). Columns 0 to 2: sums of area times unit normal, in mm2. Column 3: sum of area times
        the x component of the normal times the distance in x from the lower side of the cell, in mm3.
    sums
        (nx, ny, nz, SUM_COUNT) as in `Grid`, but the column `VOLUME` is 0; (0, 0, 0, SUM_COUNT) if they are
        not needed.
    bounds_mm
        (nx, ny, nz, 6) least and greatest x, y, z of the surface in mm; +inf, -inf if there is none.
    """

    area_mm2: Floats
    flux: Floats
    sums: Floats
    bounds_mm: Floats


@jit
def _allocate_contents(shape: tuple[int, int, int], has_sums: bool) -> CellContents:
    """Allocate the contents of a grid of empty cells.

    Parameters
    ----------
    shape
        Shape of the grid, in cells.
    has_sums
        Whether `CellContents.sums` are needed.
    """
    bounds_mm = np.full((*shape, 6), np.inf)
    bounds_mm[:, :, :, 3:] = -np.inf
    sums = np.zeros((*shape, SUM_COUNT) if has_sums else (0, 0, 0, SUM_COUNT))
    return CellContents(np.zeros(shape), np.zeros((*shape, 4)), sums, bounds_mm)


@jit
def _find_slabs(planes: Floats, polygon: Floats, axis: int) -> tuple[int, int]:
    """Find the first and the last slab that a polygon crosses along an axis.

    Parameters
    ----------
    planes
        (n + 1,) float64 ascending coordinates of the planes between slabs, in mm.
    polygon
        (k, 3) float64 corners in mm.
    axis
        Axis perpendicular to the planes.
    """
    lo, hi = np.inf, -np.inf
    for i in range(len(polygon)):
        lo = min(lo, polygon[i, axis])
        hi = max(hi, polygon[i, axis])
    first = max(0, int(np.searchsorted(planes, lo, side="right")) - 1)
    last = min(len(planes) - 2, int(np.searchsorted(planes, hi, side="left")) - 1)
    return first, max(last, first)


@jit
def _clip_polygon(
    polygon: Floats, axis: int, at_mm: float, keeps_above: bool, clipped_polygon: Floats
) -> int:
    """Clip a polygon by a plane perpendicular to an axis (Sutherland and Hodgman 1974).

    Parameters
    ----------
    polygon
        (k, 3) float64 corners in mm.
    axis, at_mm
        Axis perpendicular to the plane, and the coordinate of the plane.
    keeps_above
        Whether the side above the plane is kept.
    clipped_polygon
        (12, 3) float64, filled in with the corners of that side.

    Returns
    -------
    int
        Number of corners.
    """
    count = 0
    for i in range(len(polygon)):
        a, b = polygon[i], polygon[(i + 1) % len(polygon)]
        if a[axis] >= at_mm if keeps_above else a[axis] <= at_mm:
            clipped_polygon[count] = a
            count += 1
        if (a[axis] > at_mm and b[axis] < at_mm) or (a[axis] < at_mm and b[axis] > at_mm):
            s = (at_mm - a[axis]) / (b[axis] - a[axis])
            clipped_polygon[count] = a + s * (b - a)
            clipped_polygon[count, axis] = at_mm
            count += 1
    return count


@jit_inline
def _clip_to_slab(
    polygon: Floats, axis: int, slab_mm: tuple[float, float], half_polygon: Floats, clipped_polygon: Floats
) -> int:
    """Clip a polygon to the slab between two planes.

    Parameters
    ----------
    polygon
        (k, 3) float64 corners in mm.
    axis, slab_mm
        Axis perpendicular to the planes, and the coordinates of the planes.
    half_polygon
        (12, 3) float64 buffer; it is overwritten.
    clipped_polygon
        (12, 3) float64, filled in with the corners in the slab.

    Returns
    -------
    int
        Number of corners.
    """
    lower_mm, upper_mm = slab_mm
    corner_count = _clip_polygon(polygon, axis, lower_mm, True, half_polygon)
    return _clip_polygon(half_polygon[:corner_count], axis, upper_mm, False, clipped_polygon)


@jit
def _measure_polygon(polygon: Floats, normal: Floats, moment_mm3: Floats) -> float:
    """Measure the area of a flat polygon in mm2, and its moment, by a fan of triangles.

    Parameters
    ----------
    polygon
        (k, 3) float64 corners in mm.
    normal
        (3,) float64 unit normal.
    moment_mm3
        (3,) float64, filled in with the centroid times the area.
    """
    area_mm2 = 0.0
    moment_mm3[:] = 0.0
    for i in range(1, len(polygon) - 1):
        u = polygon[i] - polygon[0]
        v = polygon[i + 1] - polygon[0]
        triangle_mm2 = (
            (u[1] * v[2] - u[2] * v[1]) * normal[0]
            + (u[2] * v[0] - u[0] * v[2]) * normal[1]
            + (u[0] * v[1] - u[1] * v[0]) * normal[2]
        ) / 2.0
        area_mm2 += triangle_mm2
        moment_mm3 += triangle_mm2 * (polygon[0] + polygon[i] + polygon[i + 1]) / 3.0
    return area_mm2


@jit
def _add_fragment(
    contents: CellContents,
    cell: Ints,
    polygon: Floats,
    normal: Floats,
    lower_side_mm: float,
    cosines: tuple[float, float],
) -> None:
    """Add a fragment of a triangle to the sums of its cell.

    Parameters
    ----------
    contents
        Sums of all cells, updated in place.
    cell
        (3,) int64 index of the cell.
    polygon, normal
        (k, 3) float64 corners of the fragment in mm, and its (3,) float64 unit normal.
    lower_side_mm
        x coordinate of the lower side of the cell.
    cosines
        `skin_cos` and `overhang_cos`, as in `clip_into_cells`.
    """
    area, flux, sums, bounds_mm = contents.area_mm2, contents.flux, contents.sums, contents.bounds_mm
    skin_cos, overhang_cos = cosines
    x, y, z = cell[0], cell[1], cell[2]
    moment_mm3 = np.zeros(3)
    area_mm2 = _measure_polygon(polygon, normal, moment_mm3)
    if not area_mm2 > MIN_FRAGMENT_MM2:
        return
    centroid_mm = moment_mm3
    centroid_mm /= area_mm2  # in place, which is faster
    area[x, y, z] += area_mm2
    for i in range(len(polygon)):
        for k in range(3):
            bounds_mm[x, y, z, k] = min(bounds_mm[x, y, z, k], polygon[i, k])
            bounds_mm[x, y, z, k + 3] = max(bounds_mm[x, y, z, k + 3], polygon[i, k])
    flux[x, y, z, 3] += area_mm2 * normal[0] * (centroid_mm[0] - lower_side_mm)
    for k in range(3):
        cosine = normal[k]
        flux[x, y, z, k] += area_mm2 * cosine
        if len(sums) == 0:
            continue
        lateral_mm2 = area_mm2 * np.sqrt(max(0.0, 1.0 - cosine * cosine))
        sums[x, y, z, LATERAL_AREA + k] += lateral_mm2
        if abs(cosine) > skin_cos:
            sums[x, y, z, SKIN + k] += area_mm2 * abs(cosine)
            sums[x, y, z, SLOPE + k] += lateral_mm2
        if abs(cosine) > overhang_cos:
            pose = 2 * k if cosine < 0.0 else 2 * k + 1
            sums[x, y, z, OVERHANG + pose] += area_mm2 * abs(cosine)
            sums[x, y, z, MOMENT + pose] += area_mm2 * abs(cosine) * centroid_mm[k]


@jit
def clip_into_cells(
    triangles: Floats, planes: Planes, skin_cos: float, overhang_cos: float, has_sums: bool
) -> CellContents:
    """Clip every triangle to the cells that it crosses, and add up its fragments by cell.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm, between the outermost planes; the faces point outward by the right-hand rule.
    planes
        (n + 1,) float64 ascending coordinates of the planes perpendicular to each axis, in mm.
    skin_cos, overhang_cos
        Limits of the component of a unit normal along an axis. Above them, a face has skin, or counts as an
        overhang.
    has_sums
        Whether `CellContents.sums` are needed.
    """
    shape = (len(planes[0]) - 1, len(planes[1]) - 1, len(planes[2]) - 1)
    contents = _allocate_contents(shape, has_sums)
    polygons = np.zeros((4, 12, 3))  # the triangle after clipping along 0, 1, 2, 3 axes
    half_polygon = np.zeros((12, 3))
    count, last, cell = np.zeros(4, np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64)
    normals = compute_unit_normals(triangles)
    for t in range(len(triangles)):
        normal = normals[t]
        if not normal.any():  # a triangle without area
            continue
        polygons[0, :3] = triangles[t]
        count[0] = 3
        axis = 0
        is_entering = True
        while axis >= 0:  # nested loops over the slabs along x, y and z
            polygon = polygons[axis, : count[axis]]
            if is_entering:
                cell[axis], last[axis] = _find_slabs(planes[axis], polygon, axis)
                is_entering = False
            if cell[axis] > last[axis]:
                axis -= 1
                if axis >= 0:
                    cell[axis] += 1
                continue
            slab_mm = planes[axis][cell[axis]], planes[axis][cell[axis] + 1]
            corner_count = _clip_to_slab(polygon, axis, slab_mm, half_polygon, polygons[axis + 1])
            count[axis + 1] = corner_count
            if corner_count >= 3 and axis < 2:
                axis += 1
                is_entering = True
                continue
            if corner_count >= 3:
                lower_side_mm = planes[0][cell[0]]
                _add_fragment(
                    contents,
                    cell,
                    polygons[3, :corner_count],
                    normal,
                    lower_side_mm,
                    (skin_cos, overhang_cos),
                )
            cell[axis] += 1
    return contents
