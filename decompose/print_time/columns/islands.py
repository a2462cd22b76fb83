"""Islands of a part and its supports, from the stretches of solid in upright columns.

A run is a stretch of a column in which the part is solid. An island is a connected region of a layer, of the
part or of its support. A body is an island of the part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Bytes, Floats, Ints
from decompose.jit import jit
from decompose.print_time.columns.rasters import count_islands

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
) -> tuple[float, float, float, float]:
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
        of holes. Then, in mm2, the integral of the length of the travel between islands.
    """
    nx, ny = shape
    extra_island_count, extra_body_count, total_hole_count, tour_cells = 0, 0, 0, 0.0
    rows, row_length = (nx + ISLAND_STRIDE - 1) // ISLAND_STRIDE, (ny + ISLAND_STRIDE - 1) // ISLAND_STRIDE
    kinds = _fill_levels(runs, ny, height_mm, (rows, row_length))
    for level in range(ISLAND_LEVEL_COUNT):
        counts = count_islands(kinds[level])
        extra_island_count += max(0, counts.islands - 1)
        tour_cells += counts.tour_cells
        extra_body_count += max(0, counts.bodies - 1)
        total_hole_count += counts.holes
    level_mm = height_mm / ISLAND_LEVEL_COUNT
    return (
        extra_island_count * level_mm,
        extra_body_count * level_mm,
        total_hole_count * level_mm,
        tour_cells * ISLAND_STRIDE * step_mm * level_mm,
    )


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
