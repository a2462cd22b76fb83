"""Partitions with the least total print time into a given number of parts, within limits on each part.

Once planes have moved off the grid, all parts take about the same time: the total print time divided by their
number. So the total matters more than the slowest part on the grid, as long as planes can still balance the
parts. Planes cannot balance a part that takes far less time than the others, so there may also be a minimum.
A price on each part (a Lagrange multiplier) makes the search over all guillotine cuts find partitions into
fewer or more parts.
"""

from __future__ import annotations

from concurrent.futures import Executor
from functools import partial

import numpy as np
import numpy.typing as npt

from decompose.arrays import Float32s
from decompose.engines.guillotine.partitioner import list_class_states, solve_by_length
from decompose.engines.guillotine.recursion import lower_box_values
from decompose.grid import Box, BoxTables, Shape, count_cuts, find_box, index_box
from decompose.jit import jit

MAX_SOLUTIONS = 6  # maximum number of prices of a part that are tried
# Maximum price of a part, as a share of the maximum time of a part; the minimum price is its negative.
MAX_PART_PRICE_SHARE = 0.4
_UNREACHABLE_S = np.float32(1e9)

Range = tuple[float, float]  # minimum and maximum


class LeastWorkSearch:
    """Search for the partition of a grid with the least total print time.

    Parameters
    ----------
    tables
        Prices of all boxes.
    executor
        Threads that solve half of the boxes; None to solve all of them in this thread.
    """

    def __init__(self, tables: BoxTables, executor: Executor | None = None) -> None:
        self._tables, self._executor = tables, executor
        self.sum_count = 0  # number of additions of the values of both sides of a cut, in all searches so far

    def find_boxes(self, range_s: Range, part_count: int) -> list[Box]:
        """Find boxes with about the least total print time among partitions into at most a number of parts.

        Parameters
        ----------
        range_s
            Minimum and maximum print time of a box in the tables.
        part_count
            Number of parts; there are fewer only if no tried price gives as many.

        Returns
        -------
        list of Box
            Empty if there is no such partition.
        """
        low_s, high_s = (share * MAX_PART_PRICE_SHARE * range_s[1] for share in (-1.0, 1.0))
        best_boxes: list[Box] = []
        price_s = 0.0
        for _ in range(MAX_SOLUTIONS):
            values = self._solve(range_s, price_s)
            boxes = self._list_boxes(values, range_s, price_s)
            if not boxes:
                break
            count = self._count_parts(boxes)
            if count == part_count:
                return boxes
            if count < part_count:
                best_boxes, high_s = boxes, price_s
            else:
                low_s = price_s
            price_s = (low_s + high_s) / 2.0
        return best_boxes

    def _solve(self, range_s: Range, price_s: float) -> Float32s:
        """Compute the least total print time (boxes,) of each box's partitions, with prices of parts."""
        tables = self._tables
        values = np.empty(len(tables.seconds), np.float32)
        _fill_uncut_values(tables.seconds, tables.piece_counts, tables.trimmed_box, range_s, price_s, values)
        _, sums = list_class_states([])
        solve_by_length(
            tables.shape[0], self._executor, partial(lower_box_values, values, sums, tables.shape)
        )
        self.sum_count += count_cuts(tables.shape)
        return values

    def _list_boxes(self, values: Float32s, range_s: Range, price_s: float) -> list[Box]:
        """List the boxes of a solution in the order of the cuts; none if there is no solution."""
        shape, trimmed_box = self._tables.shape, self._tables.trimmed_box
        if values[index_box((0, 0, 0, *shape), shape)] >= _UNREACHABLE_S / 2:
            return []
        boxes: list[Box] = []
        stack: list[Box] = [(0, 0, 0, *shape)]
        while stack:
            index = int(trimmed_box[index_box(stack.pop(), shape)])
            if index < 0:
                continue
            seconds, piece_count = self._tables.seconds[index], self._tables.piece_counts[index]
            if _compute_uncut_value(seconds, piece_count, range_s, price_s) <= values[index]:
                boxes.append(find_box(index, shape))
            else:
                stack.extend(_find_best_cut(values, find_box(index, shape), shape))
        return boxes

    def _count_parts(self, boxes: list[Box]) -> int:
        """Count the pieces in boxes."""
        return sum(int(self._tables.piece_counts[index_box(box, self._tables.shape)]) for box in boxes)


@jit
def _compute_uncut_value(
    seconds: np.float32, piece_count: np.int16, range_s: Range, price_s: float
) -> np.float32:
    """Compute the value of an uncut box: its time and the price of its pieces."""
    if seconds < range_s[0] or seconds > range_s[1]:
        return _UNREACHABLE_S
    return np.float32(seconds + np.float32(price_s) * np.float32(piece_count))


@jit
def _fill_uncut_values(
    seconds: Float32s,
    piece_counts: npt.NDArray[np.int16],
    trimmed_box: npt.NDArray[np.int32],
    range_s: Range,
    price_s: float,
    values: Float32s,
) -> None:
    """Fill in the values (boxes,) of all uncut boxes; those without needed cells are 0."""
    for box in range(len(values)):
        values[box] = 0.0
        if trimmed_box[box] >= 0:
            values[box] = _compute_uncut_value(seconds[box], piece_counts[box], range_s, price_s)


def _find_best_cut(values: Float32s, box: Box, shape: Shape) -> tuple[Box, Box]:
    """Find the cut of a box whose sides have the least sum of values: its upper and its lower side."""
    x0, y0, z0, x1, y1, z1 = box
    cuts: list[tuple[Box, Box]] = [
        *(((x, y0, z0, x1, y1, z1), (x0, y0, z0, x, y1, z1)) for x in range(x0 + 1, x1)),
        *(((x0, y, z0, x1, y1, z1), (x0, y0, z0, x1, y, z1)) for y in range(y0 + 1, y1)),
        *(((x0, y0, z, x1, y1, z1), (x0, y0, z0, x1, y1, z)) for z in range(z0 + 1, z1)),
    ]
    return min(cuts, key=lambda sides: sum(float(values[index_box(side, shape)]) for side in sides))
