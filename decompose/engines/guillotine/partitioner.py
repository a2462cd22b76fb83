"""Exact solver of the engine `guillotine`: the partition by recursive cuts with the least makespan.

For a time limit T, each box has a minimum number of parts that cover all its needed cells: those that must be
printed. The number is 0 if the box has no needed cell. Otherwise it is the smaller of two numbers. One is the
number of pieces of the uncut box, if the box takes at most T. For the other one, the minimum numbers of the
two sides are added for each cut of the box; the least of these sums counts. Bisection over T gives the least
makespan for a number of printers. This is the hierarchical bipartition HIER-OPT of Saule, Bas and Catalyurek
(2012), in three dimensions, with a cost that is not additive.

Among partitions with equally few parts, the solver takes the one with the least sum of times and, among
those, the one with the least area of cuts. These three quantities are digits of one whole number
(`recursion.make_key`), and the sum of these numbers is minimised.

Printers that differ are grouped into classes. For a time limit T, the number of printers of the first class
that a box needs depends on how many printers of each other class it may use. For a cut, the numbers of both
sides are added for each way to divide the printers of the other classes between the sides; the least sum
counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from decompose.arrays import Ints
from decompose.engines.guillotine.recursion import (
    PART_WEIGHT,
    UNREACHABLE_COUNT,
    Table,
    fill_counts,
    fill_keys,
    lower_box_values,
)
from decompose.engines.guillotine.ties import find_tied_keys
from decompose.grid import (
    SHARE_COUNT,
    Box,
    BoxTables,
    count_cuts,
    find_box,
    index_box,
    index_interval,
    run_shares,
)

# A range whose limits have a greater ratio than this is bisected at the geometric mean of the limits.
WIDE_RATIO = 2.0
LIMIT_STEP_RATIO = 4.0  # factor by which the next step of a limit grows as long as there is no solution
# With several classes, ties are broken only if all states together have at most this many values, because of
# the memory.
MAX_TIE_VALUES = 120_000_000


@dataclass(frozen=True, slots=True)
class OtherClass:
    """Class of printers other than the first.

    The search minimises the number of printers of the first class.

    Attributes
    ----------
    tables
        Tables for a printer of the class; `trimmed_box` and `piece_counts` are the same for all classes.
    count
        Number of printers of the class.
    """

    tables: BoxTables
    count: int


class Partitioner:
    """Exact solver for the tables of one grid; it keeps its last solution.

    If there are several classes of printers, a state says how many printers of each class but the first are
    usable. For each box and state, the solver finds the minimum number of printers of the first class that
    are needed in addition. So the search is exact over all ways to distribute the parts. Its time grows with
    the square of the number of states. The value of a box in a state is this minimum number, or the least key
    (see `recursion.make_key`).

    Parameters
    ----------
    tables
        Tables of the first class of printers.
    other_classes
        The other classes of printers.
    executor
        Threads that solve half of the boxes; None to solve all of them in this thread.
    """

    def __init__(
        self, tables: BoxTables, other_classes: Sequence[OtherClass] = (), executor: Executor | None = None
    ) -> None:
        self.tables = tables
        self.other_classes = tuple(other_classes)
        self._executor = executor
        self._states, self._sums = list_class_states([other_class.count for other_class in other_classes])
        self._value: Table = np.zeros(0, np.int16)
        self._breaks_ties = False  # whether ties are broken when the boxes are listed
        self._keys: dict[int, int] | None = None  # keys of the boxes that may be chosen, if ties are broken
        self._limit_s = 0.0
        self._root: Box = (0, 0, 0, *tables.shape)
        self.sum_count = 0  # number of additions of the values of both sides of a cut, in all searches so far

    def solve(self, limit_s: float, break_ties: bool = False) -> int:
        """Find the minimum number of printers of the first class with which no part exceeds a time limit.

        Parameters
        ----------
        limit_s
            Maximum print time of a part.
        break_ties
            Whether to choose, among the solutions with this number, the one with the least total print
            time and, among those, the one with the least area of cuts.

        Returns
        -------
        int
            Number of printers, which is the number of parts if there are no other classes;
            `UNREACHABLE_COUNT` if there is no such partition.
        """
        self._limit_s, self._keys = limit_s, None
        # With several classes, different states can give equally good partitions, so the values of all boxes
        # are keys.
        has_all_keys = break_ties and bool(self.other_classes)
        total = len(self._states) * len(self.tables.seconds)
        self._value = np.empty(total, np.int64) if has_all_keys else np.empty(total, np.int16)
        solve_by_length(self.tables.shape[0], self._executor, self._solve_boxes)
        self.sum_count += len(self._sums) * count_cuts(self.tables.shape)
        self._breaks_ties = break_ties and not has_all_keys
        return min(int(self.list_class_counts()[1][-1]), UNREACHABLE_COUNT)

    def _solve_boxes(self, length: int, first: int, end: int) -> None:
        """Solve the boxes of one length along x that begin at a cell in the range [`first`, `end`)."""
        nx, ny, nz = self.tables.shape
        size, layer = len(self.tables.seconds), ny * (ny + 1) // 2 * (nz * (nz + 1) // 2)
        start = index_interval(0, length, nx)
        indices = slice((start + first) * layer, (start + end) * layer)
        for state in range(len(self._states)):
            value = self._value[state * size : (state + 1) * size]
            self._fill_uncut_values(state, indices, value[indices])
        lower_box_values(self._value, self._sums, self.tables.shape, length, first, end)

    @property
    def can_break_ties(self) -> bool:
        """True if there is enough memory to choose among partitions with equally few parts."""
        return not self.other_classes or len(self._states) * len(self.tables.seconds) <= MAX_TIE_VALUES

    def _fill_uncut_values(self, state: int, indices: slice, value: npt.NDArray[Any]) -> None:
        """Fill in the values (boxes,) of the uncut boxes at these indices in a state."""
        seconds, piece_counts = self.tables.seconds[indices], self.tables.piece_counts[indices]
        for other_class, count in zip(self.other_classes, self._states[state].tolist(), strict=True):
            if count:
                class_s = other_class.tables.seconds[indices]
                piece_counts = np.where(
                    class_s <= self._limit_s, np.maximum(piece_counts - count, 0), piece_counts
                )
                seconds = np.minimum(seconds, class_s)
        if self.other_classes:  # the remaining pieces of a box have to be fast enough on the first class
            is_fast_enough = (self.tables.seconds[indices] <= self._limit_s) | (piece_counts == 0)
            seconds = np.where(is_fast_enough, seconds, np.float32(np.inf))
        tables = (
            self._limit_s,
            seconds,
            self.tables.trimmed_box[indices],
            piece_counts.astype(np.int16, copy=False),
        )
        if value.dtype == np.int64:
            fill_keys(*tables, self.tables.cut_mm2[indices], value)
        else:
            fill_counts(*tables, value)

    @property
    def counts(self) -> npt.NDArray[np.int16]:
        """Minimum number of parts (boxes,) of each box in the last solution, by the index of the box.

        Parts that printers of other classes print are not counted.
        """
        value = self._value[-len(self.tables.seconds) :]
        if value.dtype == np.int64:
            return (value // PART_WEIGHT).astype(np.int16)
        return np.asarray(value)

    def list_class_counts(self) -> tuple[Ints, Ints]:
        """List the states of the last solution, and the fewest printers of the first class in each.

        Returns
        -------
        tuple
            (states, classes) usable printers of the other classes, and (states,) fewest printers of the first
            class, `UNREACHABLE_COUNT` or more if there is no solution.
        """
        index = index_box(self._root, self.tables.shape)
        value = self._value[index :: len(self.tables.seconds)]
        fewest = value // PART_WEIGHT if value.dtype == np.int64 else value
        return self._states, fewest.astype(np.int64)

    def list_chosen_boxes(self, region: Box | None = None) -> list[Box]:
        """List the boxes of the last solution, or only those in one region, in the order of the cuts."""
        chosen_boxes: list[Box] = []
        root = region or self._root
        if self._breaks_ties:
            self._keys = find_tied_keys(
                self.tables, self.counts, self._limit_s, index_box(root, self.tables.shape)
            )
        stack = [(root, len(self._states) - 1)]
        while stack:
            untrimmed_box, state = stack.pop()
            box = self._trim_box(untrimmed_box)
            if box is None:
                continue
            if self._find_value(box, state) == self._compute_uncut_value(box, state):
                chosen_boxes.append(box)
            else:
                stack.extend(self._find_cut(box, state))
        return chosen_boxes

    def _find_value(self, box: Box, state: int) -> int:
        """Find the value of a box in the last solution; an unknown value counts as unreachable."""
        index = index_box(box, self.tables.shape)
        if self._keys is not None:
            return self._keys.get(int(self.tables.trimmed_box[index]), UNREACHABLE_COUNT * PART_WEIGHT)
        return int(self._value[state * len(self.tables.seconds) + index])

    def _compute_uncut_value(self, box: Box, state: int) -> int:
        """Compute the value of a box as one part."""
        index = index_box(box, self.tables.shape)
        value = np.empty(1, self._value.dtype if self._keys is None else np.int64)
        self._fill_uncut_values(state, slice(index, index + 1), value)
        return int(value[0])

    def _find_cut(self, box: Box, state: int) -> tuple[tuple[Box, int], tuple[Box, int]]:
        """Find the first cut that attains the value of a box: its upper and lower side, with their states."""
        value = self._find_value(box, state)
        state_pairs = self._sums[self._sums[:, 0] == state, 1:].tolist()
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                lower_ends, upper_ends = list(box), list(box)
                lower_ends[axis + 3] = upper_ends[axis] = plane
                lower, upper = _make_box(lower_ends), _make_box(upper_ends)
                for a, b in state_pairs:
                    if self._find_value(lower, a) + self._find_value(upper, b) == value:
                        return (upper, b), (lower, a)
        raise LookupError(f"no solution for {box}: no cut attains its value at this limit")

    def _trim_box(self, box: Box) -> Box | None:
        """Trim a box to its needed cells; None if it has no needed cell."""
        index = int(self.tables.trimmed_box[index_box(box, self.tables.shape)])
        return None if index < 0 else find_box(index, self.tables.shape)

    def find_min_makespan_s(
        self,
        printer_count: int,
        min_s: float,
        tolerance_s: float = 1.0,
        max_s: float = math.inf,
        guess_s: float | None = None,
    ) -> float | None:
        """Find the lowest time limit for which the printers are enough; keep its solution.

        Parameters
        ----------
        printer_count
            Number of printers of the first class.
        min_s, max_s
            Limits between which to search.
        tolerance_s
            Accuracy of the result.
        guess_s
            Estimate of the lowest limit: it is tried first, then others in growing steps from it. None if
            there is none.

        Returns
        -------
        float or None
            Limit in seconds; None if no limit up to `max_s` is enough.
        """
        low_s, high_s = max(0.0, min_s), min(max_s, self._find_slowest_box_s())
        step_s = tolerance_s
        limit_s = 0.0 if guess_s is None else max(guess_s, low_s + step_s)
        is_reached = is_missed = False
        while low_s < limit_s < high_s and not (is_reached and is_missed):
            if self.solve(limit_s) <= printer_count:
                is_reached, high_s = True, self._find_reached_limit_s(limit_s)
                limit_s = high_s - step_s
            else:
                is_missed, low_s = True, limit_s
                limit_s = low_s + step_s
            step_s *= LIMIT_STEP_RATIO
        if high_s < 0.0 or (not is_reached and self.solve(high_s) > printer_count):
            return None
        while high_s - low_s > (1.0 + 1e-9) * tolerance_s:  # steps often leave the tolerance, up to rounding
            # In a range over several orders of magnitude, the result is more likely to be near the lower end.
            middle_s = (
                math.sqrt(low_s * high_s) if high_s > WIDE_RATIO * low_s > 0.0 else (low_s + high_s) / 2.0
            )
            if self.solve(middle_s) <= printer_count:
                high_s = self._find_reached_limit_s(middle_s)
            else:
                low_s = middle_s
        self.solve(high_s, break_ties=self.can_break_ties)
        return high_s

    def _find_slowest_box_s(self) -> float:
        """Find the time of the slowest box that fits a printer of any class; -inf if no box fits."""
        tables = (self.tables, *(other_class.tables for other_class in self.other_classes))
        finite_times_s = [table.seconds[np.isfinite(table.seconds)] for table in tables]
        return max((float(times_s.max()) for times_s in finite_times_s if len(times_s)), default=-math.inf)

    def _find_reached_limit_s(self, limit_s: float) -> float:
        """Find the lowest limit that the last solution meets; with several classes, the given limit."""
        return limit_s if self.other_classes else min(limit_s, self.find_longest_time_s())

    def find_longest_time_s(self) -> float:
        """Find the time of the slowest box of the last solution on a printer of the first class."""
        return self.tables.find_longest_time_s(self.list_chosen_boxes())


def solve_by_length(
    cell_count: int, executor: Executor | None, solve_boxes: Callable[[int, int, int], None]
) -> None:
    """Solve the boxes of each length along x, shorter ones first, because longer ones depend on them.

    Parameters
    ----------
    cell_count
        Number of cells of the grid along x.
    executor
        Threads that solve half of the boxes of a length; None to solve all of them in this thread.
    solve_boxes
        Function that solves the boxes of a length that begin at a cell in a half-open range; its arguments
        are the length and the ends of the range.
    """

    def solve_share(length: int, count: int, share: int) -> None:
        solve_boxes(length, share * count // SHARE_COUNT, (share + 1) * count // SHARE_COUNT)

    for length in range(1, cell_count + 1):
        count = cell_count - length + 1
        if count < SHARE_COUNT:
            solve_boxes(length, 0, count)
        else:
            run_shares(executor, partial(solve_share, length, count))


def list_class_states(counts: Sequence[int]) -> tuple[Ints, Ints]:
    """List the states (numbers of usable printers), and all pairs of states with their sum.

    Parameters
    ----------
    counts
        Number of printers of each class but the first.

    Returns
    -------
    tuple
        (states, classes) int64 numbers; all printers are usable in the last state. (m, 3) int64 for each pair
        of states: the index of their sum, and the indices of the two states.
    """
    states = list(np.ndindex(*(count + 1 for count in counts)))
    index = {state: i for i, state in enumerate(states)}
    sums = [
        (index[whole], index[part], index[tuple(w - p for w, p in zip(whole, part, strict=True))])
        for whole in states
        for part in np.ndindex(*(w + 1 for w in whole))
    ]
    return np.array(states, dtype=np.int64).reshape(len(states), len(counts)), np.array(sums, dtype=np.int64)


def _make_box(ends: list[int]) -> Box:
    """Make a box from the list of its six ends."""
    x0, y0, z0, x1, y1, z1 = ends
    return x0, y0, z0, x1, y1, z1
