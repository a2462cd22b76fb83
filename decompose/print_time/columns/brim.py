"""Kernel of `columns`: the area of a brim around everything that stands on the bed."""

from __future__ import annotations

import numpy as np

from decompose.arrays import Bools, Bytes
from decompose.jit import jit

OUTSIDE, BRIM = 1, 2


@jit
def count_brim_columns(is_standing: Bools, width_mm: float, step_mm: float) -> int:
    """Count the columns that a brim covers; holes get no brim.

    Parameters
    ----------
    is_standing
        (nx, ny) bool, true where something stands on the bed; around it is a margin wider than the brim.
    width_mm, step_mm
        Width of the brim, and distance between columns.
    """
    kind = _mark_outer_columns(is_standing)
    # The outline lies half a column beyond the middle of the last column inside.
    reach = int(np.ceil(width_mm / step_mm + 0.5))
    count = 0
    for i in range(1, len(kind) - 1):
        for j in range(1, kind.shape[1] - 1):
            if kind[i, j] == 0 and _is_at_outline(kind, i, j):
                count += _cover_nearby_columns(kind, i, j, reach, width_mm / step_mm + 0.5)
    return count


@jit
def _is_at_outline(kind: Bytes, i: int, j: int) -> bool:
    """Check whether a neighbour of a column is outside, whether or not the brim covers it already."""
    return bool(max(kind[i - 1, j], kind[i + 1, j], kind[i, j - 1], kind[i, j + 1]) > 0)


@jit
def _cover_nearby_columns(kind: Bytes, i: int, j: int, reach: int, radius: float) -> int:
    """Mark the outside columns close to a column as brim; return the number of newly marked ones.

    Parameters
    ----------
    kind
        (nx, ny) int8 from `_mark_outer_columns`, updated in place.
    i, j
        Column.
    reach, radius
        Maximum difference of indices, and maximum distance, from the column, in columns.
    """
    count = 0
    for x in range(max(0, i - reach), min(len(kind), i + reach + 1)):
        for y in range(max(0, j - reach), min(kind.shape[1], j + reach + 1)):
            if kind[x, y] == OUTSIDE and (x - i) ** 2 + (y - j) ** 2 <= radius**2:
                kind[x, y] = BRIM
                count += 1
    return count


@jit
def _mark_outer_columns(is_standing: Bools) -> Bytes:
    """Mark the columns that are connected to the first one through empty neighbours.

    Parameters
    ----------
    is_standing
        (nx, ny) bool; the first column is empty.

    Returns
    -------
    ndarray
        (nx, ny) int8: `OUTSIDE` for a marked column, else 0.
    """
    nx, ny = is_standing.shape
    kind = np.zeros((nx, ny), np.int8)
    stack, depth = np.zeros(nx * ny, np.int64), 1
    kind[0, 0] = OUTSIDE
    while depth:
        depth -= 1
        i, j = stack[depth] // ny, stack[depth] % ny
        for k in range(4):
            x, y = i + (k == 0) - (k == 1), j + (k == 2) - (k == 3)
            if 0 <= x < nx and 0 <= y < ny and kind[x, y] == 0 and not is_standing[x, y]:
                kind[x, y] = OUTSIDE
                stack[depth] = x * ny + y
                depth += 1
    return kind
