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


class RasterCounts(NamedTuple):
    """Counts in the raster of one level.

    Attributes
    ----------
    islands, bodies, holes
        Number of islands, of bodies, and of holes of the bodies. Cells that share a corner are connected.
    solid_cells
        Number of cells of solid.
    rectangle_cells
        Number of cells of the smallest rectangle around all cells that are not empty.
    """

    islands: int
    bodies: int
    holes: int
    solid_cells: int
    rectangle_cells: int


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
    for level in range(ISLAND_LEVEL_COUNT):
        counts = count_islands(kinds[level])
        if counts.islands > 1:
            extra_island_count += counts.islands - 1
            island_paths_mm += _estimate_paths_mm(
                counts.islands - 1, counts.islands, counts.rectangle_cells, step_mm
            )
        extra_body_count += max(0, counts.bodies - 1)
        if counts.holes > 0:
            total_hole_count += counts.holes
            hole_paths_mm += _estimate_paths_mm(
                counts.holes, counts.bodies + counts.holes, counts.solid_cells, step_mm
            )
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
        (ISLAND_LEVEL_COUNT, rows, row_length) int8: 1 for solid, 2 for support, else 0.
    """
    rows, row_length = shape
    kinds = np.zeros((ISLAND_LEVEL_COUNT, rows, row_length), np.int8)
    for i in range(rows):
        for j in range(row_length):
            column = i * ISLAND_STRIDE * ny + j * ISLAND_STRIDE
            for k in range(runs.start[column], runs.start[column] + runs.counts[column]):
                bottom_mm, top_mm = runs.ends[k, 0], runs.ends[k, 1]
                support_bottom_mm = bottom_mm - runs.ends[k, 3]
                # The last level below the support or the run, or an earlier one.
                level = max(0, int(support_bottom_mm / height_mm * ISLAND_LEVEL_COUNT - 1.0))
                z_mm = height_mm * (level + 0.5) / ISLAND_LEVEL_COUNT
                while level < ISLAND_LEVEL_COUNT and z_mm < top_mm:
                    if z_mm > support_bottom_mm:
                        kinds[level, i, j] = 1 if z_mm > bottom_mm else 2
                    level += 1
                    z_mm = height_mm * (level + 0.5) / ISLAND_LEVEL_COUNT
    return kinds


@jit
def count_islands(kinds: Bytes) -> RasterCounts:
    """Count the islands, the bodies and their holes in a raster.

    Each row is divided into stretches of cells of one kind. The number of bodies minus the number of holes is
    the number of their stretches minus the number of contacts between stretches in neighbouring rows.

    Parameters
    ----------
    kinds
        (rows, row_length) int8: 1 for solid, 2 for support, else 0.
    """
    rows, row_length = kinds.shape
    # Kind, first and last cell of each stretch, row after row.
    stretches = np.zeros((rows * row_length, 3), np.int64)
    parent = np.arange(rows * row_length)
    island_count, body_count, body_contact_count, body_stretch_count, solid_cell_count = 0, 0, 0, 0, 0
    low_i, high_i, low_j, high_j = rows, -1, row_length, -1
    row_start, count = 0, 0  # first stretch of the previous row, and number of stretches before this row
    for i in range(rows):
        previous, previous_end = row_start, count
        row_start, j = count, 0
        while j < row_length:
            kind = kinds[i, j]
            first = j
            j += 1
            if kind == 0:
                continue
            while j < row_length and kinds[i, j] == kind:
                j += 1
            stretches[count, 0], stretches[count, 1], stretches[count, 2] = kind, first, j - 1
            low_i, high_i, low_j, high_j = min(low_i, i), i, min(low_j, first), max(high_j, j - 1)
            is_body = 1 if kind == 1 else 0
            island_count += 1
            body_count += is_body
            body_stretch_count += is_body
            solid_cell_count += is_body * (j - first)
            while previous < previous_end and stretches[previous, 2] < first - 1:
                previous += 1
            k = previous
            while k < previous_end and stretches[k, 1] <= j:
                if stretches[k, 0] == kind:
                    joined_count = join_sets(parent, count, k)
                    island_count -= joined_count
                    body_count -= is_body * joined_count
                    body_contact_count += is_body
                k += 1
            count += 1
    hole_count = body_count + body_contact_count - body_stretch_count
    rectangle_cell_count = max(0, high_i + 1 - low_i) * max(0, high_j + 1 - low_j)
    return RasterCounts(island_count, body_count, hole_count, solid_cell_count, rectangle_cell_count)
