"""Kernels of `columns`: vertical rays through a mesh, and the supports, mass and islands along them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Bools, Bytes, Floats, Ints
from decompose.geometry.rays import Crossings, Rays, compute_unit_normals, find_crossings
from decompose.jit import jit, jit_inline

MIN_STEP_MM = 0.4
LEVELS = 8  # number of heights at which the growing part is measured
ISLAND_LEVELS = 16  # number of heights at which islands are counted
ISLAND_STRIDE = 2  # step between the columns that are counted
LEVEL_MM = 0.01  # maximum difference of equal heights
STEEPEST = 20.0  # minimum tangent of an upright face
BED_MM = 0.15  # maximum height at which a run begins in the first layer
MIN_GAP_MM = 0.3  # minimum height of a supported face above the bed or the part


class Runs(NamedTuple):
    """Runs of solid in the columns around rays, from the bottom up.

    Attributes
    ----------
    start, counts
        (rays,) int64 index of the first run of each column, and the number of its runs.
    ends
        (runs, 5) float64: bottom and top of a run, height of air and of support below it, all in mm, and the
        slope of its lower face.
    """

    start: Ints
    counts: Ints
    ends: Floats


class Sweep(NamedTuple):
    """Sums over the columns of a mesh.

    Attributes
    ----------
    touched
        Number of marked faces that columns of support touch, with their upper or their lower end.
    levels
        (LEVELS, 4) float64 moments in x, y, z and mass of the solid below each level, per area of a column.
    propped, standing
        (nx, ny) bool: support carries the part from the bed; the part stands on it.
    supports_mm
        (nx, ny) float64 height of support in each column.
    towers_mm, edges_mm2, islands_mm, bodies_mm, holes_mm, island_paths_mm2, hole_paths_mm2
        See `_sum_towers_mm` and `_sum_islands_mm`.
    """

    touched: float
    levels: Floats
    propped: Bools
    supports_mm: Floats
    towers_mm: float
    edges_mm2: float
    islands_mm: float
    bodies_mm: float
    holes_mm: float
    island_paths_mm2: float
    hole_paths_mm2: float
    standing: Bools


@jit
def sweep_columns(
    triangles: Floats, is_marked: Floats, rays: Rays, height: float, overhang_cos: float
) -> Sweep:
    """Send vertical rays through a closed mesh, and sum the solid and the air along them.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm, outward, standing on z = 0.
    is_marked
        (m,) float64: 1 for a face to which no support should stick, else 0.
    rays
        One in the middle of each column.
    height
        Height of the mesh in mm.
    overhang_cos
        Downward component of a face's unit normal above which it gets support.
    """
    origin, step, (nx, ny) = rays.origin_mm, rays.step_mm, rays.shape
    normals = compute_unit_normals(triangles)
    crossings = find_crossings(triangles, normals, rays)
    runs = Runs(crossings.start, np.zeros(nx * ny, np.int64), np.zeros((len(crossings.z_mm), 5)))
    touched_count = 0.0
    supports = np.zeros((nx, ny))
    is_propped = np.zeros((nx, ny), np.bool_)
    passing_sums = np.zeros((LEVELS, 4))  # runs up to each level that continue above it
    ending_sums = np.zeros((LEVELS, 4))  # runs that end below a level, but not below the previous one
    for column in range(nx * ny):
        i, j = column // ny, column % ny
        count = _follow_ray(crossings, column, normals, is_marked, overhang_cos, runs.ends)
        runs.counts[column], supports[i, j], column_touched_count, is_propped[i, j] = count
        touched_count += column_touched_count
        x, y = origin[0] + i * step, origin[1] + j * step
        for run in range(runs.start[column], runs.start[column] + runs.counts[column]):
            _add_run(passing_sums, ending_sums, (x, y), (runs.ends[run, 0], runs.ends[run, 1]), height)
    for level in range(LEVELS):
        for upper_level in range(level, LEVELS):
            passing_sums[upper_level] += ending_sums[level]
    carried_mm = step * np.sqrt(1.0 - overhang_cos * overhang_cos) / overhang_cos
    towers_mm, edges_mm2 = _sum_towers_mm(runs, supports, carried_mm, step)
    paths = _sum_islands_mm(runs, rays.shape, height, step)
    is_standing = _find_standing_columns(runs, rays.shape)
    return Sweep(touched_count, passing_sums, is_propped, supports, towers_mm, edges_mm2, *paths, is_standing)


@jit_inline
def _follow_ray(
    crossings: Crossings, ray: int, normals: Floats, is_marked: Floats, overhang_cos: float, ends: Floats
) -> tuple[int, float, float, bool]:
    """Find the runs of solid along a ray, and the support below them.

    Parameters
    ----------
    normals, is_marked, overhang_cos
        (m, 3) float64 unit normals of all faces; the others as in `sweep_columns`.
    ends
        (runs, 5) float64, of `Runs`, filled in from the first crossing of the ray on.

    Returns
    -------
    tuple
        Number of runs, height of support in mm, number of marked faces that it touches, and whether it
        carries the part from the bed.
    """
    first = crossings.start[ray]
    count, support_mm, touched_count, is_propped = 0, 0.0, 0.0, False
    # Start of a possible support, and the mark of the face there.
    support_start_mm, mark_at_start = 0.0, 0.0
    depth, bottom, air, support, lean = 0, 0.0, 0.0, 0.0, 0.0
    for k in range(first, crossings.start[ray + 1]):
        z, t = crossings.z_mm[k], crossings.face[k]
        up = normals[t, 2]
        if up < 0.0:
            depth += 1
            if depth != 1:
                continue
            bottom, air, support = z, z - support_start_mm, 0.0
            lean = min(STEEPEST, np.sqrt(1.0 - up * up) / -up)
            if -up > overhang_cos and air > MIN_GAP_MM:
                support_mm += air
                air, support = 0.0, air
                touched_count += is_marked[t] + mark_at_start
                is_propped = is_propped or support_start_mm == 0.0
            continue
        depth -= 1
        if depth != 0:
            continue
        support_start_mm, mark_at_start = z, is_marked[t]
        run = first + count
        ends[run, 0], ends[run, 1], ends[run, 2], ends[run, 3], ends[run, 4] = bottom, z, air, support, lean
        count += 1
    return count, support_mm, touched_count, is_propped


@jit_inline
def _add_run(
    passing_sums: Floats,
    ending_sums: Floats,
    place: tuple[float, float],
    run: tuple[float, float],
    height: float,
) -> None:
    """Add a run of a column to the moments and the mass of each level.

    Parameters
    ----------
    passing_sums, ending_sums
        (LEVELS, 4) float64 sums of the runs that continue above a level, and of those that end below it.
    place
        x and y of the column in mm.
    run
        Bottom and top of the run in mm.
    height
        Height of the mesh in mm.
    """
    bottom, top = run
    level = int(bottom / height * LEVELS)
    while level < LEVELS - 1 and height * (level + 1) / LEVELS < top:
        _add(passing_sums, level, place, bottom, height * (level + 1) / LEVELS)
        level += 1
    _add(ending_sums, min(level, LEVELS - 1), place, bottom, top)


@jit_inline
def _add(sums: Floats, level: int, place: tuple[float, float], bottom: float, top: float) -> None:
    """Add the moments and the mass of a part of a column at x, y in mm to sums (LEVELS, 4) float64."""
    x, y = place
    sums[level, 0] += x * (top - bottom)
    sums[level, 1] += y * (top - bottom)
    sums[level, 2] += (top * top - bottom * bottom) / 2.0
    sums[level, 3] += top - bottom


@jit
def _sum_towers_mm(runs: Runs, supports: Floats, carried_mm: float, step: float) -> tuple[float, float]:
    """Sum the height of air under runs of solid that no neighbouring run or support carries.

    Where neighbouring runs begin at about the same height, as along an edge, the first one counts as a
    tower; of the others, both sides of the strip of support below them count.

    Parameters
    ----------
    supports
        (nx, ny) float64 height of support in each column, in mm.
    carried_mm, step
        Height by which a neighbouring run must begin lower to carry a run, and distance between columns, in
        mm.

    Returns
    -------
    tuple
        Height of all towers in mm, and sides of all strips in mm2.
    """
    start, counts, ends = runs.start, runs.counts, runs.ends
    total, sides = 0.0, 0.0
    nx, ny = supports.shape
    for column in range(nx * ny):
        for k in range(start[column], start[column] + counts[column]):
            bottom, air = ends[k, 0], ends[k, 2]
            # A leaning thin wall is carried by a neighbour that is lower by its slope between two columns.
            reached = bottom - ends[k, 4] * step
            if air <= MIN_GAP_MM:
                continue
            begins, edge = True, False
            for i in range(max(0, column // ny - 1), min(nx, column // ny + 2)):
                for j in range(max(0, column % ny - 1), min(ny, column % ny + 2)):
                    neighbour = i * ny + j
                    if supports[i, j] > 0.0:
                        begins = False
                    for m in range(start[neighbour], start[neighbour] + counts[neighbour]):
                        if ends[m, 1] < reached:
                            continue
                        diagonal = abs(i - column // ny) + abs(j - column % ny) == 2
                        lower = bottom - ends[m, 0]
                        least = carried_mm * (1.4142135623730951 if diagonal else 1.0)
                        if lower > least:
                            begins = False
                        elif lower > LEVEL_MM or (lower > -LEVEL_MM and neighbour < column):
                            edge = True
            if begins and edge:
                sides += 2.0 * step * air
            elif begins:
                total += air
    return total, sides


@jit
def _find_standing_columns(runs: Runs, shape: tuple[int, int]) -> Bools:
    """Find the columns (nx, ny) whose lowest run stands on the bed."""
    is_standing = np.zeros(shape, np.bool_)
    for column in range(shape[0] * shape[1]):
        first = runs.start[column]
        is_standing[column // shape[1], column % shape[1]] = (
            runs.counts[column] > 0 and runs.ends[first, 0] < BED_MM
        )
    return is_standing


@jit
def _sum_islands_mm(
    runs: Runs, shape: tuple[int, int], height: float, step: float
) -> tuple[float, float, float, float, float]:
    """Sum over the height: islands of a layer less one, bodies of solid less one, and holes.

    The fourth and the fifth sum, in mm2, multiply islands and holes by their mean distance, taken as the side
    of a square: an equal share of the layer's rectangle for each island, of its solid for each hole.

    Parameters
    ----------
    runs
        Runs of all columns.
    shape
        Number of columns along x and along y.
    height
        Height of the mesh in mm.
    step
        Distance between columns in mm.
    """
    nx, ny = shape
    total, other_bodies, holes, hole_paths, island_paths = 0, 0, 0, 0.0, 0.0
    rows, row = (nx + ISLAND_STRIDE - 1) // ISLAND_STRIDE, (ny + ISLAND_STRIDE - 1) // ISLAND_STRIDE
    kind = np.zeros(rows * row, np.int8)  # kinds of cells: none, solid, support
    parent = np.zeros(rows * row, np.int64)
    for level in range(ISLAND_LEVELS):
        rectangle = _fill_level(runs, ny, height * (level + 0.5) / ISLAND_LEVELS, kind, (rows, row))
        islands, bodies, cells = _count_islands(kind, parent, rows, row)
        if islands > 1:
            total += islands - 1
            island_paths += (islands - 1) * ISLAND_STRIDE * step * np.sqrt(rectangle / islands)
        other_bodies += max(0, bodies - 1)
        hole_count = max(0, bodies - _count_euler(kind, rows, row))
        holes += hole_count
        hole_paths += (
            hole_count * ISLAND_STRIDE * step * np.sqrt(cells / (bodies + hole_count)) if hole_count else 0.0
        )
    level_mm = height / ISLAND_LEVELS
    return (
        total * level_mm,
        other_bodies * level_mm,
        holes * level_mm,
        island_paths * level_mm,
        hole_paths * level_mm,
    )


@jit
def _fill_level(runs: Runs, ny: int, z: float, kind: Bytes, shape: tuple[int, int]) -> int:
    """Fill a raster (rows * row,) from every second column at a height; count the cells of its rectangle.

    kind: 1 for solid, 2 for support, else 0. The columns are (nx, ny), the raster is of `shape`.
    """
    rows, row = shape
    low_i, high_i, low_j, high_j = rows, -1, row, -1
    for i in range(rows):
        for j in range(row):
            index, column = i * row + j, i * ISLAND_STRIDE * ny + j * ISLAND_STRIDE
            kind[index] = 0
            for k in range(runs.start[column], runs.start[column] + runs.counts[column]):
                if runs.ends[k, 0] < z < runs.ends[k, 1]:
                    kind[index] = 1
                elif runs.ends[k, 0] - runs.ends[k, 3] < z <= runs.ends[k, 0]:
                    kind[index] = 2
            if kind[index] > 0:
                low_i, high_i, low_j, high_j = min(low_i, i), max(high_i, i), min(low_j, j), max(high_j, j)
    return max(0, high_i + 1 - low_i) * max(0, high_j + 1 - low_j)


@jit
def _count_islands(kind: Bytes, parent: Ints, rows: int, row: int) -> tuple[int, int, int]:
    """Count the islands of a raster (rows * row,), those of solid, and its cells; parent: (rows * row,)."""
    islands, bodies, cells = 0, 0, 0
    for i in range(rows):
        for j in range(row):
            index = i * row + j
            parent[index] = index
            if kind[index] == 0:
                continue
            solid = 1 if kind[index] == 1 else 0
            islands, bodies, cells = islands + 1, bodies + solid, cells + solid
            for n in range(4):  # the four of the eight neighbours that have been visited
                u, v = (i, j - 1) if n == 3 else (i - 1, j - 1 + n)
                if u < 0 or v < 0 or v >= row or kind[u * row + v] != kind[index]:
                    continue
                a, b = _find_root(parent, index), _find_root(parent, u * row + v)
                if a != b:
                    parent[a] = b
                    islands -= 1
                    bodies -= solid
    return islands, bodies, cells


@jit
def _count_euler(kind: Bytes, rows: int, row: int) -> int:
    """Count the bodies of solid (kind 1) of a raster (rows * row,) less their holes.

    By the patterns of two by two cells (Gray 1971), cells that share a corner being one body.
    """
    quads = 0
    for i in range(-1, rows):
        for j in range(-1, row):
            a = i >= 0 and j >= 0 and kind[i * row + j] == 1
            b = i >= 0 and j + 1 < row and kind[i * row + j + 1] == 1
            c = i + 1 < rows and j >= 0 and kind[(i + 1) * row + j] == 1
            d = i + 1 < rows and j + 1 < row and kind[(i + 1) * row + j + 1] == 1
            filled_count = int(a) + int(b) + int(c) + int(d)
            if filled_count == 1:
                quads += 1
            elif filled_count == 3:
                quads -= 1
            elif filled_count == 2 and a == d:
                quads -= 2
    return quads // 4


@jit
def _find_root(parent: Ints, element: int) -> int:
    """Find the root of an element in a forest of parents (elements,) int64."""
    while parent[element] != element:
        parent[element] = parent[parent[element]]
        element = parent[element]
    return element
