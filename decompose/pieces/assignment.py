"""Assignment of cut parts to printers with different build volumes and speeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from decompose.arrays import Bools, Floats
from decompose.print_time import Pose
from decompose.printers import TargetPrinter


def assign_printers(poses: Sequence[Pose], printers: Sequence[TargetPrinter]) -> list[TargetPrinter] | None:
    """Assign a printer to each part so that the last part ends as soon as possible.

    The pose of a part decides whether the part fits. The price of a pose does not include the speed of a
    printer.

    Parameters
    ----------
    poses
        Poses of the parts.
    printers
        Free printers, each of which gets at most one part.

    Returns
    -------
    list or None
        The printer of each part; None if not all parts fit.
    """
    seconds = [
        [pose.price_s * p.time_factor if p.fits(*pose.size_mm) else np.inf for p in printers]
        for pose in poses
    ]
    assignment = solve_bottleneck_assignment(np.array(seconds))
    return None if assignment is None else [printers[i] for i in assignment]


def solve_bottleneck_assignment(seconds: Floats) -> list[int] | None:
    """Assign parts to printers with the lowest maximum time and, among such assignments, the lowest sum.

    Bisection finds the lowest maximum time for which a matching exists.

    Parameters
    ----------
    seconds
        (parts, printers) float64 time of each part on each printer; +inf if it does not fit.

    Returns
    -------
    list or None
        Index of the printer of each part. No printer is used twice, and of equally good printers the first
        one is used. None if there is no assignment.
    """
    times_s = np.unique(seconds[np.isfinite(seconds)])
    if not len(times_s) or not _has_matching(seconds <= times_s[-1]):
        return None
    low, high = 0, len(times_s) - 1
    while low < high:
        middle = (low + high) // 2
        if _has_matching(seconds <= times_s[middle]):
            high = middle
        else:
            low = middle + 1
    is_allowed = seconds <= times_s[high]
    order_costs = 1e-6 * np.arange(seconds.shape[1])
    forbidden_cost = 1.0 + float((times_s[high] + order_costs[-1]) * len(seconds))
    _, columns = linear_sum_assignment(
        np.where(is_allowed, np.where(is_allowed, seconds, 0.0) + order_costs, forbidden_cost)
    )
    return [int(column) for column in columns]


def _has_matching(is_allowed: Bools) -> bool:
    """Check whether a mask (n, m) allows a distinct column for each row."""
    return bool((maximum_bipartite_matching(csr_array(is_allowed), perm_type="column") >= 0).all())
