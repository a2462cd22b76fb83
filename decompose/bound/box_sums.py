"""Sums over cells and boxes, by summed-area tables.

The values of the cells in each box are added, and for each cell the shares of the boxes that cover it. The
share of a box is the fraction of it that a covering uses (`bound.covering`).
"""

from __future__ import annotations

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.jit import jit


@jit
def sum_in_boxes(cells: Floats, corners: Ints, sums: Floats, box_sums: Floats) -> None:
    """Sum the values of cells in each box, by a summed-area table.

    Parameters
    ----------
    cells
        (nx, ny, nz) float64 values.
    corners
        (k, 8) int64 from `find_corners`.
    sums
        (nx + 1, ny + 1, nz + 1) float64 workspace for the summed-area table; 0 where any index is 0.
    box_sums
        (k,) float64 sums, filled in.
    """
    nx, ny, nz = cells.shape
    for x in range(nx):
        for y in range(ny):
            row_sum = 0.0
            for z in range(nz):
                row_sum += cells[x, y, z]
                sums[x + 1, y + 1, z + 1] = (
                    row_sum + sums[x, y + 1, z + 1] + sums[x + 1, y, z + 1] - sums[x, y, z + 1]
                )
    s = sums.ravel()
    for k in range(len(corners)):
        c = corners[k]
        added = s[c[0]] + s[c[1]] + s[c[2]] + s[c[3]]
        box_sums[k] = added - s[c[4]] - s[c[5]] - s[c[6]] - s[c[7]]


@jit
def sum_over_cells(shares: Floats, corners: Ints, differences: Floats, cell_sums: Floats) -> None:
    """Sum, for each cell, the shares of the boxes that cover it.

    Parameters
    ----------
    shares
        (k,) float64 shares of the boxes.
    corners
        (k, 8) int64 from `find_corners`.
    differences
        (nx + 1, ny + 1, nz + 1) float64 workspace for the differences where boxes begin and end.
    cell_sums
        (nx, ny, nz) float64 sums, filled in.
    """
    s = differences.ravel()
    s[:] = 0.0
    for k in range(len(corners)):
        if shares[k] == 0.0:
            continue
        for i in range(4):
            s[corners[k, i]] -= shares[k]
            s[corners[k, i + 4]] += shares[k]
    nx, ny, nz = cell_sums.shape
    for x in range(nx):
        for y in range(ny):
            row_sum = 0.0
            for z in range(nz):
                row_sum += differences[x, y, z]
                total = row_sum
                if x > 0:
                    total += cell_sums[x - 1, y, z]
                if y > 0:
                    total += cell_sums[x, y - 1, z]
                if x > 0 and y > 0:
                    total -= cell_sums[x - 1, y - 1, z]
                cell_sums[x, y, z] = total


def find_corners(boxes: Ints, shape: tuple[int, int, int]) -> Ints:
    """Find the corners of boxes in a summed-area table.

    Parameters
    ----------
    boxes
        (k, 6) int64 in cells, half-open.
    shape
        Number of cells of the grid along each axis.

    Returns
    -------
    ndarray
        (k, 8) int64 indices in the flat table, the four that are added first, then the four that are
        subtracted.
    """
    _, ny, nz = shape
    x0, y0, z0, x1, y1, z1 = boxes.T

    def compute_index(x: Ints, y: Ints, z: Ints) -> Ints:
        return (x * (ny + 1) + y) * (nz + 1) + z

    positive = (
        compute_index(x1, y1, z1),
        compute_index(x0, y0, z1),
        compute_index(x0, y1, z0),
        compute_index(x1, y0, z0),
    )
    negative = (
        compute_index(x0, y1, z1),
        compute_index(x1, y0, z1),
        compute_index(x1, y1, z0),
        compute_index(x0, y0, z0),
    )
    return np.ascontiguousarray(np.stack([*positive, *negative], axis=1))
