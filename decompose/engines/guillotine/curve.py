"""Curve of the makespan over the number of printers, and the number of printers that suits a goal.

One search serves all numbers of printers. A search for a time limit finds the fewest parts that meet it, and
so shows for every number of printers whether it is enough. Thus each search narrows the bounds on the
makespans of many numbers of printers. The same holds for classes of printers: a search finds the fewest
printers of the first class for any numbers of printers of the other classes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Bools, Ints
from decompose.engines.guillotine.partitioner import OtherClass, Partitioner
from decompose.grid import BoxTables

TOLERANCE = 0.005  # accuracy of a makespan, as a share of it
# Number of parallel searches; it is fixed, so that the result does not depend on the machine.
PARALLEL_SEARCH_COUNT = 2
CLEARING_S = 120.0
"""Estimate of the time that a person needs to take a part off the bed, and to clean the bed."""
ASSEMBLY_S = 216.0
"""Time that a person needs to clean and glue a part: 3.6 min in the literature on such models."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """A number of printers, and the least makespan in seconds that a search found for it."""

    printer_count: int
    makespan_s: float


class _MakespanBounds:
    """Bounds on the makespan of each fleet (see `compute_makespan_curve`)."""

    def __init__(self, tables: Sequence[BoxTables], fleets: Ints) -> None:
        max_counts = fleets.max(axis=0)
        self._first_tables = tables[0]
        self._other_classes = [
            OtherClass(table, int(count)) for table, count in zip(tables[1:], max_counts[1:], strict=True)
        ]
        self._fleets = fleets
        self.upper_bounds_s = np.full(len(fleets), np.inf)
        self.lower_bounds_s = np.zeros(len(fleets))

    def solve_for_limit(self, limit_s: float) -> tuple[float, Bools, float]:
        """Find the fleets that meet a time limit.

        Returns
        -------
        tuple
            The limit, whether each fleet (n,) meets it, and the time in s at which the last print ends at the
            latest: the limit itself if there are several classes.
        """
        solver = Partitioner(self._first_tables, self._other_classes)
        solver.solve(limit_s)
        states, fewest_printers = solver.list_class_counts()
        fewest_by_state = {
            tuple(state): int(fewest_count)
            for state, fewest_count in zip(states.tolist(), fewest_printers, strict=True)
        }
        is_feasible = np.array(
            [
                first_count >= fewest_by_state[tuple(other_counts)]
                for first_count, *other_counts in self._fleets.tolist()
            ]
        )
        end_s = solver.find_longest_time_s() if is_feasible.any() and not self._other_classes else limit_s
        return limit_s, is_feasible, end_s

    def narrow_bounds(self, limit_s: float, is_feasible: Bools, end_s: float) -> None:
        """Narrow the bounds of every fleet by a result of `solve_for_limit`."""
        self.upper_bounds_s[is_feasible] = np.minimum(self.upper_bounds_s[is_feasible], end_s)
        self.lower_bounds_s[~is_feasible] = np.maximum(self.lower_bounds_s[~is_feasible], limit_s)

    def choose_limits_s(self) -> list[float]:
        """Choose the next limits to solve for, in the widest gaps between bounds; none if all are narrow."""
        is_reached = np.isfinite(self.upper_bounds_s)
        gaps: dict[tuple[float, float], float] = {}
        for low_s, high_s in zip(
            self.lower_bounds_s[is_reached].tolist(), self.upper_bounds_s[is_reached].tolist(), strict=True
        ):
            if high_s - low_s > TOLERANCE * high_s:
                gaps[low_s, high_s] = (high_s - low_s) / high_s
        widest_gaps = sorted(gaps, key=lambda gap: (-gaps[gap], gap))[:PARALLEL_SEARCH_COUNT]
        return [(low_s + high_s) / 2.0 for low_s, high_s in widest_gaps]


def compute_makespan_curve(
    tables: Sequence[BoxTables], fleets: Ints, executor: Executor | None = None
) -> tuple[CurvePoint, ...]:
    """Compute the least makespan of guillotine partitions for each of several fleets (sets of printers).

    Each makespan is accurate to `TOLERANCE`. Fleets that are too small for any partition are omitted.

    Parameters
    ----------
    tables
        Tables of each class of printers, whose times include the speed of the class; the class with the
        most printers is the first.
    fleets
        (n, classes) int64 number of printers of each class, one row for each fleet; no two rows have the
        same sum.
    executor
        Threads for parallel searches; None to search for one limit after the other.
    """
    finite_times_s = [table.seconds[np.isfinite(table.seconds)] for table in tables]
    if not any(len(times_s) for times_s in finite_times_s):
        return ()
    bounds = _MakespanBounds(tables, fleets)
    limits_s = [max(float(times_s.max()) for times_s in finite_times_s if len(times_s))]
    run = map if executor is None else executor.map
    while limits_s:
        for result in run(bounds.solve_for_limit, limits_s):
            bounds.narrow_bounds(*result)
        limits_s = bounds.choose_limits_s()
    counts, makespans_s = fleets.sum(axis=1).tolist(), bounds.upper_bounds_s.tolist()
    return tuple(CurvePoint(n, s) for n, s in zip(counts, makespans_s, strict=True) if math.isfinite(s))


def find_least_total_time(
    points: Sequence[CurvePoint], clearing_s: float = CLEARING_S, assembly_s: float = ASSEMBLY_S
) -> CurvePoint:
    """Find the point with the least time for printing plus a person's handling of every part.

    Parameters
    ----------
    points
        Points from `compute_makespan_curve`, at least one.
    clearing_s, assembly_s
        Time in seconds that a person needs for each part: to take it off the bed, and to glue it.
    """
    return min(
        points, key=lambda p: (p.makespan_s + p.printer_count * (clearing_s + assembly_s), p.printer_count)
    )


def find_fewest_printers_in_time(
    points: Sequence[CurvePoint], time_limit_s: float, handling_s: float = 0.0
) -> CurvePoint:
    """Find the point with the fewest printers that finish within a time limit.

    If no number of printers does, the point that finishes first is returned.

    Parameters
    ----------
    points
        Points from `compute_makespan_curve`, at least one.
    time_limit_s
        Seconds from the first print command until the last part is printed and all parts are handled.
    handling_s
        Time in seconds that a person needs for each part after the last part is printed; a single part needs
        none.
    """

    def compute_end_s(point: CurvePoint) -> float:
        return point.makespan_s + (handling_s * point.printer_count if point.printer_count > 1 else 0.0)

    feasible_points = [point for point in points if compute_end_s(point) <= time_limit_s]
    if feasible_points:
        return min(feasible_points, key=lambda point: point.printer_count)
    return min(points, key=lambda point: (compute_end_s(point), point.printer_count))
