"""Thin walls and sheets of a part, in which infill, inner wall lines or skins do not fit.

Wall lines are the lines that a slicer prints along each outline: an outer one, and inner ones. Between the
wall lines on both sides of a thin wall, the slicer prints a single line at the speed of skin instead of
infill. If the inner wall lines do not fit either, a single line replaces them too. A sheet is a thin level
region, with skins on its upper and lower side.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from decompose.arrays import Floats
from decompose.geometry.rays import (
    Crossings,
    compute_unit_normals,
    find_bounds,
    find_crossings,
    find_stretch,
    place_rays,
)
from decompose.jit import jit

RAY_COUNT = 4_000  # approximate number of rays parallel to each axis
MIN_STEP_MM = 0.05  # minimum distance between rays
MIN_GAP_MM = 0.05  # minimum gap between wall lines that is filled


class WallWidths(NamedTuple):
    """Width of one line; total width of the outer wall lines on both sides; total width of all wall lines."""

    line_width_mm: float
    outer_walls_mm: float
    walls_mm: float


class SheetLimits(NamedTuple):
    """Measures by which a sheet counts as thin.

    Attributes
    ----------
    skins_mm
        Height of the skins on both sides together.
    layer_height_mm
        Height of a layer.
    skin_cos
        Minimum |n| of faces with skin; n is the upward component of a face's unit normal.
    """

    skins_mm: float = 0.0
    layer_height_mm: float = 1.0
    skin_cos: float = 1.0


class ThinWalls(NamedTuple):
    """Areas of both sides of thin walls, and the excess volume of skins in thin sheets.

    Attributes
    ----------
    single_wall_mm2
        Area of walls that are too thin for inner wall lines, so that only the outer ones are printed.
    gap_mm2
        Area of walls with a gap between their wall lines that a single line fills.
    solid_wall_mm2
        Area of walls that are too thin for infill, with or without inner wall lines.
    overlap_mm3
        Volume by which the skins on both sides of sheets exceed the sheets.
    """

    single_wall_mm2: float
    gap_mm2: float
    solid_wall_mm2: float
    overlap_mm3: float


def measure_thin_walls(
    triangles: Floats, widths: WallWidths, sheets: SheetLimits, count: int = RAY_COUNT
) -> ThinWalls:
    """Measure the thin walls and sheets of a closed mesh.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm, facing outward, standing on z = 0.
    widths
        Widths of lines and walls.
    sheets
        Limits of thin sheets.
    count
        Approximate number of rays parallel to each axis.
    """
    sums = np.zeros(3)
    mesh = _Mesh(np.ascontiguousarray(triangles), *find_bounds(triangles), compute_unit_normals(triangles))
    # First x, then y, becomes the last axis; `upright_axis` is the index of z in the new order.
    for upright_axis, order in ((1, (1, 2, 0)), (0, (2, 0, 1))):
        turned_mesh = mesh.permute_axes(order)
        crossings, ray_mm2 = _cast_rays(turned_mesh, count)
        sums += ray_mm2 * _sum_thin_walls(crossings, turned_mesh.normals, upright_axis, widths)
    crossings, ray_mm2 = _cast_rays(mesh, count)
    single_wall_mm2, gap_mm2, solid_wall_mm2 = sums.tolist()
    overlap_mm3 = ray_mm2 * _sum_overlap_mm(crossings, mesh.normals, sheets)
    return ThinWalls(single_wall_mm2, gap_mm2, solid_wall_mm2, overlap_mm3)


class _Mesh(NamedTuple):
    """Triangles (m, 3, 3) and their bounds (3,) in mm, and unit normals (m, 3)."""

    triangles: Floats
    lo_mm: Floats
    hi_mm: Floats
    normals: Floats

    def permute_axes(self, order: tuple[int, int, int]) -> _Mesh:
        """Reorder x, y and z of all arrays; `order` is an even permutation, so that normals stay outward."""
        return _Mesh(*(_permute_columns(array.reshape(-1, 3), order).reshape(array.shape) for array in self))


@jit
def _permute_columns(rows: Floats, order: tuple[int, int, int]) -> Floats:
    """Reorder the columns of an array (n, 3) float64."""
    permuted_rows = np.empty_like(rows)
    for i in range(len(rows)):
        for k in range(3):
            permuted_rows[i, k] = rows[i, order[k]]
    return permuted_rows


def _cast_rays(mesh: _Mesh, count: int) -> tuple[Crossings, float]:
    """Cast rays along the last axis; return the crossings, and the area in mm2 that each ray represents."""
    width_mm, depth_mm = (mesh.hi_mm - mesh.lo_mm)[:2].tolist()
    step_mm = max(MIN_STEP_MM, math.sqrt(width_mm * depth_mm / count))
    crossings = find_crossings(mesh.triangles, mesh.normals, place_rays(mesh.lo_mm, mesh.hi_mm, step_mm))
    return crossings, step_mm**2


@jit
def _sum_thin_walls(crossings: Crossings, normals: Floats, upright_axis: int, widths: WallWidths) -> Floats:
    """Sum the areas of thin walls, as multiples of the area that a ray represents.

    A face counts only if its normal is closer to the rays than to the horizontal axis perpendicular to them.

    Parameters
    ----------
    crossings
        Crossings of the rays with the faces.
    normals
        (m, 3) unit normals of the faces; the rays run along the last axis.
    upright_axis
        Index of the axis that points up on the bed: 0 or 1.
    widths
        Widths of the walls.

    Returns
    -------
    ndarray
        (3,) float64 sums for `single_wall_mm2`, `gap_mm2` and `solid_wall_mm2` of `ThinWalls`.
    """
    sums = np.zeros(3)
    for ray in range(len(crossings.start) - 1):
        k, end = crossings.start[ray], crossings.start[ray + 1]
        while k < end:
            bottom, top = find_stretch(crossings, normals, k, end)
            k = top + 1
            if top == end:
                continue
            chord_mm = crossings.z_mm[top] - crossings.z_mm[bottom]
            for crossing in (bottom, top):
                face = crossings.face[crossing]
                along, across = abs(normals[face, 2]), abs(normals[face, 1 - upright_axis])
                if along < across:
                    continue
                level_cos = np.sqrt(along * along + across * across)
                _add_wall(sums, chord_mm * along / level_cos, level_cos / along, widths)
    return sums


@jit
def _add_wall(sums: Floats, thickness_mm: float, area_share: float, widths: WallWidths) -> None:
    """Add the area of one side of a wall to the sums, if the wall is thin.

    Parameters
    ----------
    sums
        (3,) float64 as in `_sum_thin_walls`, updated in place.
    thickness_mm
        Thickness of the wall.
    area_share
        Area of the side, as a multiple of the area that a ray represents.
    widths
        Widths of the walls.
    """
    line_width_mm, outer_walls_mm, walls_mm = widths
    if thickness_mm < outer_walls_mm + line_width_mm:
        sums[0] += area_share
    if (
        outer_walls_mm + MIN_GAP_MM < thickness_mm < outer_walls_mm + line_width_mm
        or walls_mm + MIN_GAP_MM < thickness_mm < walls_mm + line_width_mm
    ):
        sums[1] += area_share
    if thickness_mm < walls_mm + line_width_mm:
        sums[2] += area_share


@jit
def _sum_overlap_mm(crossings: Crossings, normals: Floats, sheets: SheetLimits) -> float:
    """Sum, over all rays, the height in mm by which the skins on both sides of thin sheets exceed the sheets.

    Parameters
    ----------
    crossings
        Crossings of upright rays with the faces.
    normals
        (m, 3) float64 unit normals of the faces.
    sheets
        Limits of thin sheets.
    """
    skins_mm, layer_height_mm, skin_cos = sheets
    overlap_mm = 0.0
    for ray in range(len(crossings.start) - 1):
        k, end = crossings.start[ray], crossings.start[ray + 1]
        while k < end:
            bottom, top = find_stretch(crossings, normals, k, end)
            k = top + 1
            if top == end:
                continue
            if -normals[crossings.face[bottom], 2] > skin_cos and normals[crossings.face[top], 2] > skin_cos:
                height_mm = crossings.z_mm[top] - crossings.z_mm[bottom]
                layers = np.floor(height_mm / layer_height_mm + 0.5)
                overlap_mm += max(0.0, skins_mm - layer_height_mm * layers)
    return overlap_mm
