"""Islands of a part and its supports, from the stretches of solid in upright columns.

A run is a stretch of a column in which the part is solid. An island is a connected region of a layer, of the
part or of its support. A body is an island of the part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Bytes, Floats, Ints
from decompose.disjoint_sets import join_sets
from decompose.jit import jit

ISLAND_LEVEL_COUNT = 16  # number of heights at which islands are counted
ISLAND_STRIDE = 2  # islands are counted in every second column along x and y


class Runs(NamedTuple):
    """Runs of solid in the columns around rays, from the bottom up.

    Attributes
    ----------
    start, counts
        (rays,) int64 index of the first run of each column, and the number of its runs.
    ends
        (runs, 5) float64. Columns 0 to 3 in mm: bottom of a run, its top, height of the air below it, and
        height of the support below it (one of these two is 0). Column 4: slope of its lower face (height over
        horizontal distance).
    """

    start: Ints
    counts: Ints
    ends: Floats


@jit
def sum_islands_mm(
    runs: Runs, shape: tuple[int, int], height_mm: float, step_mm: float
) -> tuple[float, float, float, float, float]:
    """Count islands, bodies and holes at several heights, and integrate their numbers over the height.

    Parameters
    ----------
    runs
        Runs of all columns.
    shape
        Number of columns along x and along y.
    height_mm
        Height of the mesh in mm.
    step_mm
        Distance between columns in mm.

    Returns
    -------
    tuple
        Integrals over the height, in mm: number of islands minus one, number of bodies minus one, and number
        of holes. Then, in mm2, the integrals of the travel to islands and to holes (`_estimate_paths_mm`).
    """
    nx, ny = shape
    extra_island_count, extra_body_count, total_hole_count, hole_paths_mm, island_paths_mm = 0, 0, 0, 0.0, 0.0
    rows, row_length = (nx + ISLAND_STRIDE - 1) // ISLAND_STRIDE, (ny + ISLAND_STRIDE - 1) // ISLAND_STRIDE
    kinds = _fill_levels(runs, ny, height_mm, (rows, row_length))
    parent = np.zeros(rows * row_length, np.int64)
    for level in range(ISLAND_LEVEL_COUNT):
        kind = kinds[level]
        island_count, body_count, cell_count = _count_islands(kind, parent, rows, row_length)
        if island_count > 1:
            rectangle_cell_count = _count_rectangle_cells(kind, rows, row_length)
            extra_island_count += island_count - 1
            island_paths_mm += _estimate_paths_mm(
                island_count - 1, island_count, rectangle_cell_count, step_mm
            )
        extra_body_count += max(0, body_count - 1)
        hole_count = max(0, body_count - _compute_euler_number(kind, rows, row_length))
        if hole_count > 0:
            total_hole_count += hole_count
            hole_paths_mm += _estimate_paths_mm(hole_count, body_count + hole_count, cell_count, step_mm)
    level_mm = height_mm / ISLAND_LEVEL_COUNT
    return (
        extra_island_count * level_mm,
        extra_body_count * level_mm,
        total_hole_count * level_mm,
        island_paths_mm * level_mm,
        hole_paths_mm * level_mm,
    )


@jit
def _estimate_paths_mm(count: int, total: int, cells: int, step_mm: float) -> float:
    """Estimate the travel to the islands or the holes of a layer: their number times their mean distance.

    The mean distance is estimated as the side of a square. For islands, the area of this square is that of
    the rectangle around all islands, divided by their number. For holes, it is the area of the solid divided
    by the number of bodies and holes.

    Parameters
    ----------
    count
        Number of islands minus one, or number of holes.
    total
        Number by which the area is divided.
    cells
        Area in cells of the raster.
    step_mm
        Distance between columns in mm.
    """
    path_mm: float = count * ISLAND_STRIDE * step_mm * np.sqrt(cells / total)
    return path_mm


@jit
def _fill_levels(runs: Runs, ny: int, height_mm: float, shape: tuple[int, int]) -> Bytes:
    """Fill a raster from every second column for each height at which islands are counted (a level).

    Parameters
    ----------
    runs
        Runs of all columns.
    ny
        Number of columns along y.
    height_mm
        Height of the mesh in mm.
    shape
        Number of rows of a raster, and number of cells in each row.

    Returns
    -------
    ndarray
        (ISLAND_LEVEL_COUNT, rows * row_length) int8: 1 for solid, 2 for support, else 0.
    """
    rows, row_length = shape
    kinds = np.zeros((ISLAND_LEVEL_COUNT, rows * row_length), np.int8)
    for index in range(rows * row_length):
        column = index // row_length * ISLAND_STRIDE * ny + index % row_length * ISLAND_STRIDE
        for k in range(runs.start[column], runs.start[column] + runs.counts[column]):
            bottom_mm, top_mm = runs.ends[k, 0], runs.ends[k, 1]
            support_bottom_mm = bottom_mm - runs.ends[k, 3]
            for level in range(ISLAND_LEVEL_COUNT):
                z_mm = height_mm * (level + 0.5) / ISLAND_LEVEL_COUNT
                if bottom_mm < z_mm < top_mm:
                    kinds[level, index] = 1
                elif support_bottom_mm < z_mm <= bottom_mm:
                    kinds[level, index] = 2
    return kinds


@jit
def _count_rectangle_cells(kind: Bytes, rows: int, row_length: int) -> int:
    """Count the cells of the smallest rectangle around the cells of a raster that are not empty.

    Parameters
    ----------
    kind
        (rows * row_length,) int8, 0 for an empty cell.
    rows, row_length
        Number of rows of the raster, and number of cells in each row.
    """
    low_i, high_i, low_j, high_j = rows, -1, row_length, -1
    for i in range(rows):
        for j in range(row_length):
            if kind[i * row_length + j] > 0:
                low_i, high_i, low_j, high_j = min(low_i, i), max(high_i, i), min(low_j, j), max(high_j, j)
    return max(0, high_i + 1 - low_i) * max(0, high_j + 1 - low_j)


@jit
def _count_islands(kind: Bytes, parent: Ints, rows: int, row_length: int) -> tuple[int, int, int]:
    """Count the islands, the bodies, and the cells of solid in a raster.

    Parameters
    ----------
    kind
        (rows * row_length,) int8: 1 for solid, 2 for support, else 0.
    parent
        (rows * row_length,) int64 buffer for the forest of connected cells; it is overwritten.
    rows, row_length
        Number of rows of the raster, and number of cells in each row.
    """
    island_count, body_count, cell_count = 0, 0, 0
    for i in range(rows):
        for j in range(row_length):
            index = i * row_length + j
            parent[index] = index
            if kind[index] == 0:
                continue
            solid_count = 1 if kind[index] == 1 else 0
            island_count, body_count, cell_count = (
                island_count + 1,
                body_count + solid_count,
                cell_count + solid_count,
            )
            for n in range(4):  # the four neighbours that have been visited
                u, v = (i, j - 1) if n == 3 else (i - 1, j - 1 + n)
                if u < 0 or v < 0 or v >= row_length or kind[u * row_length + v] != kind[index]:
                    continue
                joined_count = join_sets(parent, index, u * row_length + v)
                island_count -= joined_count
                body_count -= solid_count * joined_count
    return island_count, body_count, cell_count


@jit
def _compute_euler_number(kind: Bytes, rows: int, row_length: int) -> int:
    """Compute the Euler number of a raster: the number of bodies minus the number of holes.

    The number follows from the patterns of two by two cells (Gray 1971). Cells that share a corner are one
    body.

    Parameters
    ----------
    kind
        (rows * row_length,) int8: 1 for solid.
    rows, row_length
        Number of rows of the raster, and number of cells in each row.
    """
    quads = 0
    for i in range(-1, rows):
        for j in range(-1, row_length):
            a = i >= 0 and j >= 0 and kind[i * row_length + j] == 1
            b = i >= 0 and j + 1 < row_length and kind[i * row_length + j + 1] == 1
            c = i + 1 < rows and j >= 0 and kind[(i + 1) * row_length + j] == 1
            d = i + 1 < rows and j + 1 < row_length and kind[(i + 1) * row_length + j + 1] == 1
            filled_count = int(a) + int(b) + int(c) + int(d)
            if filled_count == 1:
                quads += 1
            elif filled_count == 3:
                quads -= 1
            elif filled_count == 2 and a == d:
                quads -= 2
    return quads // 4
