"""Choice among partitions with equally few parts: by total print time, then by area of cuts.

Only a few boxes occur in a partition into the fewest parts. They are listed from the whole box down to its
smallest parts: a cut of a box is followed if the fewest parts of its two sides add up to the fewest parts of
the box. Then their keys (`recursion.make_key`) are added up in the opposite order, and the least are kept.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decompose.arrays import Ints
from decompose.engines.guillotine.recursion import PART_WEIGHT, UNREACHABLE_COUNT, make_key
from decompose.grid import BoxTables, Shape, find_interval_ends, index_interval
from decompose.jit import jit


@jit
def _fill_sides(box: int, shape: Shape, sides: Ints) -> int:
    """Fill in the lower and the upper side of every cut of a box, and return the number of cuts.

    Parameters
    ----------
    box
        Index of the box.
    shape
        Shape of the grid, in cells.
    sides
        (k, 2) int64, filled in with the indices of both sides of each cut; k is at least the number of cuts.
    """
    _, ny, nz = shape
    y_interval_count, z_interval_count = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    strides = (y_interval_count * z_interval_count, z_interval_count, 1)
    intervals = (
        box // (y_interval_count * z_interval_count),
        box // z_interval_count % y_interval_count,
        box % z_interval_count,
    )
    count = 0
    for axis in range(3):
        low, high = find_interval_ends(intervals[axis], shape[axis])
        base_index = box - intervals[axis] * strides[axis]
        for plane in range(low + 1, high):
            sides[count, 0] = base_index + index_interval(low, plane, shape[axis]) * strides[axis]
            sides[count, 1] = base_index + index_interval(plane, high, shape[axis]) * strides[axis]
            count += 1
    return count


@jit
def _list_tied_boxes(
    counts: npt.NDArray[np.int16], trimmed_box: npt.NDArray[np.int32], shape: Shape, root: int
) -> Ints:
    """List the tied boxes: those that occur in at least one partition of a box into the fewest parts.

    Parameters
    ----------
    counts
        (boxes,) int16 minimum number of parts of each box.
    trimmed_box
        (boxes,) int32 of `BoxTables`.
    shape
        Shape of the grid, in cells.
    root
        Index of the box that is partitioned; it must be trimmed to its needed cells (`Grid.is_needed`).

    Returns
    -------
    ndarray
        (k,) int64 indices in ascending order, so that the sides of a box come before the box.
    """
    sides = np.empty((shape[0] + shape[1] + shape[2], 2), np.int64)
    stack, indices = [root], {root}
    while stack:
        box = stack.pop()
        if counts[box] < 2:
            continue
        for cut in range(_fill_sides(box, shape, sides)):
            lower, upper = sides[cut]
            if counts[lower] + counts[upper] == counts[box]:
                for side in (int(trimmed_box[lower]), int(trimmed_box[upper])):
                    if side not in indices:
                        indices.add(side)
                        stack.append(side)
    return np.sort(np.array(list(indices)))  # a box has a higher index than its sides


@jit
def _compute_least_keys(
    limit_s: float,
    tables: tuple[
        npt.NDArray[np.float32], npt.NDArray[np.int32], npt.NDArray[np.int16], npt.NDArray[np.float32]
    ],
    counts: npt.NDArray[np.int16],
    shape: Shape,
    tied_boxes: Ints,
) -> Ints:
    """Compute the least key of each tied box.

    Parameters
    ----------
    limit_s
        Maximum print time of a part.
    tables
        (boxes,) `seconds`, `trimmed_box`, `piece_counts` and `cut_mm2` of `BoxTables`.
    counts
        (boxes,) int16 minimum number of parts of each box.
    shape
        Shape of the grid, in cells.
    tied_boxes
        (k,) int64 of `_list_tied_boxes`.

    Returns
    -------
    ndarray
        (k,) int64 keys.
    """
    seconds, trimmed_box, piece_counts, cut_mm2 = tables
    sides = np.empty((shape[0] + shape[1] + shape[2], 2), np.int64)
    keys = np.full(len(tied_boxes), UNREACHABLE_COUNT * PART_WEIGHT)
    for i in range(len(tied_boxes)):
        box = tied_boxes[i]
        if seconds[box] <= limit_s:
            keys[i] = make_key(seconds[box], piece_counts[box], cut_mm2[box] if len(cut_mm2) else 0.0)
        if counts[box] < 2:
            continue
        for cut in range(_fill_sides(box, shape, sides)):
            lower, upper = sides[cut]
            if counts[lower] + counts[upper] == counts[box]:
                key = keys[np.searchsorted(tied_boxes, trimmed_box[lower])]
                keys[i] = min(keys[i], key + keys[np.searchsorted(tied_boxes, trimmed_box[upper])])
    return keys


def find_tied_keys(
    tables: BoxTables, counts: npt.NDArray[np.int16], limit_s: float, root: int
) -> dict[int, int]:
    """Find the least key of every box that occurs in a partition into the fewest parts, by the box's index.

    Parameters
    ----------
    tables
        Tables of the grid.
    counts
        (boxes,) minimum number of parts of each box.
    limit_s
        Maximum print time of a part.
    root
        Index of the box that is partitioned.

    Returns
    -------
    dict
        Key of each box; empty if the box at the root cannot be partitioned, or has no needed cells.
    """
    if not 0 < counts[root] < UNREACHABLE_COUNT:
        return {}
    tied_boxes = _list_tied_boxes(counts, tables.trimmed_box, tables.shape, int(tables.trimmed_box[root]))
    arrays = (tables.seconds, tables.trimmed_box, tables.piece_counts, tables.cut_mm2)
    keys = _compute_least_keys(limit_s, arrays, counts, tables.shape, tied_boxes)
    return dict(zip(tied_boxes.tolist(), keys.tolist(), strict=True))
