"""Kernels of `columns`: vertical rays through a mesh, and the supports and the mass along these rays.

A run is a stretch of a ray, or of the column around it, in which the part is solid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Bools, Floats
from decompose.geometry.rays import Crossings, Rays, compute_unit_normals, find_crossings, find_stretch
from decompose.jit import jit, jit_inline
from decompose.print_time.columns.islands import Runs, sum_islands_mm

MIN_STEP_MM = 0.4  # minimum distance between columns
LEVEL_COUNT = 8  # number of heights at which the growing part is measured
SAME_HEIGHT_MM = 0.01  # maximum difference between heights that count as equal
MAX_SLOPE = 20.0  # maximum slope (height over horizontal distance) of a face; a steeper one counts as upright
MAX_BED_GAP_MM = 0.15  # a run that begins below this height counts as standing on the bed
MIN_GAP_MM = 0.3  # minimum height of the air below a face that gets support


class Supports(NamedTuple):
    """Runs of solid in the columns of a mesh, and the supports below them.

    Attributes
    ----------
    runs
        Runs of all columns.
    touched_count
        Number of faces in `is_marked` (to which no support should stick) that columns of support touch, with
        their upper or their lower end.
    supports_mm
        (nx, ny) float64 height of support in each column.
    is_bed_support
        (nx, ny) bool, true where support stands on the bed.
    towers_mm, strip_sides_mm2
        See `_sum_towers_mm`.
    """

    runs: Runs
    touched_count: float
    supports_mm: Floats
    is_bed_support: Bools
    towers_mm: float
    strip_sides_mm2: float


class Sweep(NamedTuple):
    """Sums over the columns of a mesh.

    Attributes
    ----------
    supports
        Runs of solid, and the supports below them.
    level_moments
        (LEVEL_COUNT, 4) float64 of the solid below each level: first moments in x, y and z, and volume; all
        are divided by the area of a column.
    is_standing
        (nx, ny) bool, true where the part itself stands on the bed.
    islands_mm, bodies_mm, holes_mm, island_paths_mm2
        See `sum_islands_mm`.
    """

    supports: Supports
    level_moments: Floats
    is_standing: Bools
    islands_mm: float
    bodies_mm: float
    holes_mm: float
    island_paths_mm2: float


@jit
def sweep_columns(
    triangles: Floats, is_marked: Floats, rays: Rays, height_mm: float, overhang_cos: float
) -> Sweep:
    """Cast vertical rays through a closed mesh, and sum the solid and the air along them.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm, facing outward, standing on z = 0.
    is_marked
        (m,) float64: 1 for a face to which no support should stick, else 0.
    rays
        Rays along z, one in the middle of each column.
    height_mm
        Height of the mesh in mm.
    overhang_cos
        Downward component of a face's unit normal above which the face gets support.
    """
    supports = sweep_supports(triangles, is_marked, rays, overhang_cos)
    runs = supports.runs
    island_sums = sum_islands_mm(runs, rays.shape, height_mm, rays.step_mm)
    return Sweep(
        supports,
        _sum_level_moments(runs, rays, height_mm),
        _find_standing_columns(runs, rays.shape),
        *island_sums,
    )


@jit
def sweep_supports(triangles: Floats, is_marked: Floats, rays: Rays, overhang_cos: float) -> Supports:
    """Cast vertical rays through a closed mesh, and find the runs of solid and the supports along them.

    Parameters
    ----------
    triangles, is_marked, rays, overhang_cos
        As in `sweep_columns`.
    """
    nx, ny = rays.shape
    normals = compute_unit_normals(triangles)
    crossings = find_crossings(triangles, normals, rays)
    runs = Runs(crossings.start, np.zeros(nx * ny, np.int64), np.zeros((len(crossings.z_mm), 5)))
    touched_count = 0.0
    supports_mm = np.zeros((nx, ny))
    is_bed_support = np.zeros((nx, ny), np.bool_)
    for column in range(nx * ny):
        i, j = column // ny, column % ny
        ray_sums = _follow_ray(crossings, column, normals, is_marked, overhang_cos, runs.ends)
        runs.counts[column], supports_mm[i, j], column_touched_count, is_bed_support[i, j] = ray_sums
        touched_count += column_touched_count
    min_carrier_drop_mm = rays.step_mm * np.sqrt(1.0 - overhang_cos * overhang_cos) / overhang_cos
    towers_mm, strip_sides_mm2 = _sum_towers_mm(runs, supports_mm, min_carrier_drop_mm, rays.step_mm)
    return Supports(runs, touched_count, supports_mm, is_bed_support, towers_mm, strip_sides_mm2)


@jit_inline
def _follow_ray(
    crossings: Crossings, ray: int, normals: Floats, is_marked: Floats, overhang_cos: float, ends: Floats
) -> tuple[int, float, float, bool]:
    """Find the runs of solid along a ray, and the support below them.

    Parameters
    ----------
    crossings, ray
        Crossings of all rays with the faces, and index of the ray.
    normals
        (m, 3) float64 unit normals of the faces.
    is_marked, overhang_cos
        As in `sweep_columns`.
    ends
        (runs, 5) float64, `ends` of `Runs`; rows are filled in from the first crossing of the ray on.

    Returns
    -------
    tuple
        Number of runs, height of support in mm, number of faces in `is_marked` that it touches, and whether
        support stands on the bed.
    """
    first = crossings.start[ray]
    count, support_mm, touched_count, is_bed_support = 0, 0.0, 0.0, False
    support_start_mm, mark_at_start = 0.0, 0.0  # bottom of a possible support, and mark of the face there
    k, end = first, crossings.start[ray + 1]
    while k < end:
        bottom, top = find_stretch(crossings, normals, k, end)
        k = top + 1
        if bottom == end:
            continue
        bottom_mm, lower_face = crossings.z_mm[bottom], crossings.face[bottom]
        n = normals[lower_face, 2]
        air_mm, run_support_mm = bottom_mm - support_start_mm, 0.0
        if -n > overhang_cos and air_mm > MIN_GAP_MM:
            support_mm += air_mm
            air_mm, run_support_mm = 0.0, air_mm
            touched_count += is_marked[lower_face] + mark_at_start
            is_bed_support = is_bed_support or support_start_mm == 0.0
        if top == end:
            continue
        support_start_mm, mark_at_start = crossings.z_mm[top], is_marked[crossings.face[top]]
        run = first + count
        ends[run, 0], ends[run, 1] = bottom_mm, support_start_mm
        ends[run, 2], ends[run, 3] = air_mm, run_support_mm
        ends[run, 4] = min(MAX_SLOPE, np.sqrt(1.0 - n * n) / -n)
        count += 1
    return count, support_mm, touched_count, is_bed_support


@jit
def _sum_level_moments(runs: Runs, rays: Rays, height_mm: float) -> Floats:
    """Sum the moments and the mass of the solid below each level.

    Between two levels there is a slab. A run begins in one slab, fills the slabs above it, and ends in
    another. The runs that fill a slab are counted by differences between slabs, to take the same time for
    long runs.

    Parameters
    ----------
    runs, rays
        Runs of all columns, and their rays.
    height_mm
        Height of the mesh in mm.

    Returns
    -------
    ndarray
        (LEVEL_COUNT, 4) float64 `level_moments` of `Sweep`.
    """
    moments = np.zeros((LEVEL_COUNT, 4))  # of the runs that begin or end in a slab
    filled = np.zeros((LEVEL_COUNT + 1, 3))  # runs that fill it, and their x and y: differences between slabs
    slab_mm, ny = height_mm / LEVEL_COUNT, rays.shape[1]
    for column in range(len(runs.counts)):
        x = rays.origin_mm[0] + column // ny * rays.step_mm
        y = rays.origin_mm[1] + column % ny * rays.step_mm
        for run in range(runs.start[column], runs.start[column] + runs.counts[column]):
            bottom_mm, top_mm = runs.ends[run, 0], runs.ends[run, 1]
            first = min(int(bottom_mm / slab_mm), LEVEL_COUNT - 1)
            last = min(int(top_mm / slab_mm), LEVEL_COUNT - 1)
            if first == last:
                _add_moments(moments, first, (x, y), bottom_mm, top_mm)
                continue
            _add_moments(moments, first, (x, y), bottom_mm, slab_mm * (first + 1))
            _add_moments(moments, last, (x, y), slab_mm * last, top_mm)
            for slab, sign in ((first + 1, 1.0), (last, -1.0)):
                filled[slab, 0] += sign
                filled[slab, 1] += sign * x
                filled[slab, 2] += sign * y
    for slab in range(LEVEL_COUNT):
        moments[slab, 0] += filled[slab, 1] * slab_mm
        moments[slab, 1] += filled[slab, 2] * slab_mm
        moments[slab, 2] += filled[slab, 0] * slab_mm * slab_mm * (slab + 0.5)
        moments[slab, 3] += filled[slab, 0] * slab_mm
        filled[slab + 1] += filled[slab]
        if slab:
            moments[slab] += moments[slab - 1]
    return moments


@jit_inline
def _add_moments(
    sums: Floats, slab: int, position_mm: tuple[float, float], bottom_mm: float, top_mm: float
) -> None:
    """Add the moments and the mass of a section of a column to the sums of a slab.

    Parameters
    ----------
    sums
        (LEVEL_COUNT, 4) float64 moments in x, y, z and mass, updated in place.
    slab
        Index of the slab.
    position_mm
        x and y of the column.
    bottom_mm, top_mm
        Heights between which the section of the column lies.
    """
    x, y = position_mm
    sums[slab, 0] += x * (top_mm - bottom_mm)
    sums[slab, 1] += y * (top_mm - bottom_mm)
    sums[slab, 2] += (top_mm * top_mm - bottom_mm * bottom_mm) / 2.0
    sums[slab, 3] += top_mm - bottom_mm


@jit
def _sum_towers_mm(
    runs: Runs, supports_mm: Floats, min_carrier_drop_mm: float, step_mm: float
) -> tuple[float, float]:
    """Sum the height of the air below runs of solid that no neighbouring run or support carries.

    The slicer fills this air with support. Along an edge, neighbouring runs begin at about the same height:
    the support below the first run counts as a tower, and the support below the others as a strip. A tower
    counts by its height, a strip by the area of both its sides.

    Parameters
    ----------
    runs
        Runs of all columns.
    supports_mm
        (nx, ny) float64 height of support in each column.
    min_carrier_drop_mm, step_mm
        Minimum height by which a neighbouring run begins lower than a run that it carries, and distance
        between columns.

    Returns
    -------
    tuple
        Height of all towers in mm, and sides of all strips in mm2.
    """
    towers_mm, sides_mm2 = 0.0, 0.0
    for column in range(supports_mm.size):
        for k in range(runs.start[column], runs.start[column] + runs.counts[column]):
            air_mm = runs.ends[k, 2]
            if air_mm <= MIN_GAP_MM:
                continue
            is_tower, is_edge = _search_carriers(runs, supports_mm, column, k, min_carrier_drop_mm, step_mm)
            if is_tower and is_edge:
                sides_mm2 += 2.0 * step_mm * air_mm
            elif is_tower:
                towers_mm += air_mm
    return towers_mm, sides_mm2


@jit_inline
def _search_carriers(
    runs: Runs,
    supports_mm: Floats,
    column: int,
    run: int,
    min_carrier_drop_mm: float,
    step_mm: float,
) -> tuple[bool, bool]:
    """Search the columns around a run for runs and supports that carry it.

    Parameters
    ----------
    runs, supports_mm, min_carrier_drop_mm, step_mm
        As in `_sum_towers_mm`.
    column, run
        Index of the run's column, and of the run.

    Returns
    -------
    tuple
        Whether nothing carries the run, and whether a run next to it begins slightly lower, or at about the
        same height in an earlier column.
    """
    start, counts, ends = runs.start, runs.counts, runs.ends
    nx, ny = supports_mm.shape
    bottom_mm = ends[run, 0]
    # The neighbour that carries a leaning thin wall may end lower, by the rise of the wall between two
    # columns.
    carrier_top_mm = bottom_mm - ends[run, 4] * step_mm
    is_tower, is_edge = True, False
    for i in range(max(0, column // ny - 1), min(nx, column // ny + 2)):
        for j in range(max(0, column % ny - 1), min(ny, column % ny + 2)):
            neighbour = i * ny + j
            if supports_mm[i, j] > 0.0:
                is_tower = False
            for m in range(start[neighbour], start[neighbour] + counts[neighbour]):
                if ends[m, 1] < carrier_top_mm:
                    continue
                is_diagonal = abs(i - column // ny) + abs(j - column % ny) == 2
                drop_mm = bottom_mm - ends[m, 0]
                min_drop_mm = min_carrier_drop_mm * (1.4142135623730951 if is_diagonal else 1.0)
                if drop_mm > min_drop_mm:
                    is_tower = False
                elif drop_mm > SAME_HEIGHT_MM or (drop_mm > -SAME_HEIGHT_MM and neighbour < column):
                    is_edge = True
    return is_tower, is_edge


@jit
def _find_standing_columns(runs: Runs, shape: tuple[int, int]) -> Bools:
    """Find the columns whose lowest run stands on the bed.

    Parameters
    ----------
    runs
        Runs of all columns.
    shape
        Number of columns along x and along y.

    Returns
    -------
    ndarray
        (nx, ny) bool.
    """
    is_standing = np.zeros(shape, np.bool_)
    for column in range(shape[0] * shape[1]):
        first = runs.start[column]
        is_standing[column // shape[1], column % shape[1]] = (
            runs.counts[column] > 0 and runs.ends[first, 0] < MAX_BED_GAP_MM
        )
    return is_standing


@jit
def sum_steps_mm(heights_mm: Floats) -> float:
    """Sum the differences in height between neighbouring columns; a slope counts as steps.

    Parameters
    ----------
    heights_mm
        (nx, ny) float64 heights of the columns, which are surrounded by columns of height 0.
    """
    nx, ny = heights_mm.shape
    steps_mm = 0.0
    for i in range(nx + 1):
        for j in range(ny + 1):
            height_mm = heights_mm[i, j] if i < nx and j < ny else 0.0
            before_x_mm = heights_mm[i - 1, j] if i > 0 and j < ny else 0.0
            before_y_mm = heights_mm[i, j - 1] if j > 0 and i < nx else 0.0
            steps_mm += abs(height_mm - before_x_mm) + abs(height_mm - before_y_mm)
    return steps_mm
