"""Counts of islands, bodies and holes in the raster of one level of a part and its supports."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from decompose.arrays import Bytes
from decompose.disjoint_sets import join_sets
from decompose.jit import jit
from decompose.print_time.columns.tours import measure_tour_cells

MAX_TOUR_COUNT = 128  # maximum number of islands between which distances are measured


class RasterCounts(NamedTuple):
    """Counts in the raster of one level.

    Attributes
    ----------
    islands, bodies, holes
        Number of islands, of bodies, and of holes of the bodies. Cells that share a corner are connected.
    tour_cells
        Length of the travel between islands, in cells.
    """

    islands: int
    bodies: int
    holes: int
    tour_cells: float


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
    # Kind, first and last cell, and row of each stretch, row after row.
    stretches = np.zeros((rows * row_length, 4), np.int64)
    parent = np.arange(rows * row_length)
    island_count, body_count, body_contact_count, body_stretch_count = 0, 0, 0, 0
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
            stretches[count, 3] = i
            low_i, high_i, low_j, high_j = min(low_i, i), i, min(low_j, first), max(high_j, j - 1)
            is_body = 1 if kind == 1 else 0
            island_count += 1
            body_count += is_body
            body_stretch_count += is_body
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
    tour_cells = 0.0
    if island_count > MAX_TOUR_COUNT:
        # The islands are taken to be spread evenly over the rectangle around them.
        rectangle_cell_count = (high_i + 1 - low_i) * (high_j + 1 - low_j)
        tour_cells = (island_count - 1) * np.sqrt(rectangle_cell_count / island_count)
    elif island_count > 1:
        support_count = island_count - body_count
        tour_cells = measure_tour_cells(stretches[:count], parent[:count], support_count, island_count)
    return RasterCounts(island_count, body_count, hole_count, tour_cells)
