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

from decompose.engines.guillotine.partitioner import list_class_states, solve_by_length
from decompose.engines.guillotine.recursion import lower_box_values
from decompose.grid import Box, BoxTables, Shape, count_cuts, find_box, index_box

MAX_SOLUTIONS = 6  # maximum number of prices of a part that are tried
# Maximum price of a part, as a share of the maximum time of a part; the minimum price is its negative.
MAX_PART_PRICE_SHARE = 0.4
_UNREACHABLE_S = np.float32(1e9)

Values = npt.NDArray[np.float32]
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

    def _solve(self, range_s: Range, price_s: float) -> Values:
        """Compute the least total print time (boxes,) of each box's partitions, with prices of parts."""
        tables = self._tables
        values = self._compute_uncut_values(slice(None), range_s, price_s)
        values[tables.trimmed_box < 0] = 0.0
        _, sums = list_class_states([])
        solve_by_length(
            tables.shape[0], self._executor, partial(lower_box_values, values, sums, tables.shape)
        )
        self.sum_count += count_cuts(tables.shape)
        return values

    def _compute_uncut_values(self, indices: slice, range_s: Range, price_s: float) -> Values:
        """Compute the values of uncut boxes at these indices."""
        seconds, piece_counts = self._tables.seconds[indices], self._tables.piece_counts[indices]
        values = seconds + np.float32(price_s) * piece_counts.astype(np.float32)
        is_in_range = (range_s[0] <= seconds) & (seconds <= range_s[1])
        return np.where(is_in_range, values, _UNREACHABLE_S).astype(np.float32)

    def _list_boxes(self, values: Values, range_s: Range, price_s: float) -> list[Box]:
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
            if self._compute_uncut_values(slice(index, index + 1), range_s, price_s)[0] <= values[index]:
                boxes.append(find_box(index, shape))
            else:
                stack.extend(_find_best_cut(values, find_box(index, shape), shape))
        return boxes

    def _count_parts(self, boxes: list[Box]) -> int:
        """Count the pieces in boxes."""
        return sum(int(self._tables.piece_counts[index_box(box, self._tables.shape)]) for box in boxes)


def _find_best_cut(values: Values, box: Box, shape: Shape) -> tuple[Box, Box]:
    """Find the cut of a box whose sides have the least sum of values: its upper and its lower side."""
    x0, y0, z0, x1, y1, z1 = box
    cuts: list[tuple[Box, Box]] = [
        *(((x, y0, z0, x1, y1, z1), (x0, y0, z0, x, y1, z1)) for x in range(x0 + 1, x1)),
        *(((x0, y, z0, x1, y1, z1), (x0, y0, z0, x1, y, z1)) for y in range(y0 + 1, y1)),
        *(((x0, y0, z, x1, y1, z1), (x0, y0, z0, x1, y1, z)) for z in range(z0 + 1, z1)),
    ]
    return min(cuts, key=lambda sides: sum(float(values[index_box(side, shape)]) for side in sides))
