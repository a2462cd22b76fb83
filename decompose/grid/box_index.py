"""Axis-aligned boxes of a grid: their indices, and sums of the values of their cells."""

from __future__ import annotations

from decompose.arrays import Ints
from decompose.jit import jit

Box = tuple[int, int, int, int, int, int]  # x0, y0, z0, x1, y1, z1 in cells, half-open
Shape = tuple[int, int, int]  # shape of a grid, in cells


@jit
def index_interval(lo: int, hi: int, n: int) -> int:
    """Compute the index of the interval [lo, hi) among all intervals on an axis of n cells.

    There are n (n + 1) / 2 intervals, in the order of their lengths.

    Parameters
    ----------
    lo, hi
        First cell, and the cell after the last one.
    n
        Number of cells along the axis.
    """
    length = hi - lo
    return (length - 1) * n - (length - 1) * (length - 2) // 2 + lo


@jit
def compute_index(box: Box, shape: Shape) -> int:
    """Compute the index of a box in the tables of `BoxTables`, for compiled code; see `index_box`.

    Parameters
    ----------
    box, shape
        As in `index_box`.
    """
    x0, y0, z0, x1, y1, z1 = box
    nx, ny, nz = shape
    y_interval_count, z_interval_count = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    base_index = index_interval(x0, x1, nx) * y_interval_count + index_interval(y0, y1, ny)
    return base_index * z_interval_count + index_interval(z0, z1, nz)


@jit
def sum_box(sums: Ints, box: Box) -> int:
    """Sum the values of the cells in a box by a summed-area table.

    Parameters
    ----------
    sums
        (nx + 1, ny + 1, nz + 1) int64 summed-area table.
    box
        Box in cells, half-open.
    """
    x0, y0, z0, x1, y1, z1 = box
    total = sums[x1, y1, z1] - sums[x0, y1, z1] - sums[x1, y0, z1] + sums[x0, y0, z1]
    return int(total - sums[x1, y1, z0] + sums[x0, y1, z0] + sums[x1, y0, z0] - sums[x0, y0, z0])


def index_box(box: Box, shape: Shape) -> int:
    """Compute the index of a box in the tables of `BoxTables`, over all boxes of a grid.

    Parameters
    ----------
    box
        x0, y0, z0, x1, y1, z1 in cells, half-open.
    shape
        Shape of the grid, in cells.
    """
    return int(compute_index(box, shape))


def find_box(index: int, shape: Shape) -> Box:
    """Find the box with an index, the inverse of `index_box`.

    Parameters
    ----------
    index
        Index in the tables.
    shape
        Shape of the grid, in cells.
    """
    _, ny, nz = shape
    index, iz = divmod(index, nz * (nz + 1) // 2)
    ix, iy = divmod(index, ny * (ny + 1) // 2)
    (x0, x1), (y0, y1), (z0, z1) = (
        find_interval_ends(i, n) for i, n in zip((ix, iy, iz), shape, strict=True)
    )
    return x0, y0, z0, x1, y1, z1


@jit
def find_interval_ends(interval: int, n: int) -> tuple[int, int]:
    """Find the ends of an interval on an axis of n cells by its index, the inverse of `index_interval`.

    Parameters
    ----------
    interval
        Index of the interval.
    n
        Number of cells along the axis.

    Returns
    -------
    tuple
        First cell, and the cell after the last one.
    """
    length = 1
    while interval >= n - length + 1:
        interval -= n - length + 1
        length += 1
    return interval, interval + length
