"""Shifts of groups of faces with the least makespan, by a linear programme.

The print time of a part counts as linear in the positions of its faces. After each move, its slopes are
corrected by the measured time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from decompose.arrays import Floats, Ints

# Moves much shorter than this barely change the slopes: support volume, and so print time, changes in steps.
NOISE_MM = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class ShiftLimits:
    """Limits on the shifts of groups.

    Attributes
    ----------
    max_growth_mm, max_shrinkage_mm
        (n, 3) lengths by which each part may grow and shrink along each axis; inf without a limit.
    min_shift_mm, max_shift_mm
        (groups,) least and greatest shift of each group.
    """

    max_growth_mm: Floats
    max_shrinkage_mm: Floats
    min_shift_mm: Floats
    max_shift_mm: Floats


def solve_plane_shifts(
    seconds: Floats,
    slopes_s_per_mm: Floats,
    groups: Ints,
    limits: ShiftLimits,
    min_gain_s_per_mm: float,
) -> tuple[Floats, float]:
    """Compute the shifts of groups with the least makespan, assuming that times are linear in the shifts.

    Parameters
    ----------
    seconds
        (n,) times of the parts before the shift.
    slopes_s_per_mm
        (n, 2, 3) change of each part's time, in s for each mm by which one of its faces moves up along its
        axis.
    groups
        (n, 2, 3) from `group_faces`.
    limits
        Limits on the shifts.
    min_gain_s_per_mm
        Minimum gain of makespan for each mm of a shift.

    Returns
    -------
    tuple
        (groups,) shifts in mm, and makespan in s; zeros and inf if the linear programme has no solution.
    """
    count = len(limits.min_shift_mm)
    rows = _build_constraints(slopes_s_per_mm, groups, count)
    length_limits_mm = limits.max_growth_mm.ravel(), limits.max_shrinkage_mm.ravel()
    right_sides = np.concatenate([-seconds, *length_limits_mm, np.zeros(2 * count)])
    is_limited = np.isfinite(right_sides)
    solution = linprog(
        np.array([*np.zeros(count), *np.full(count, min_gain_s_per_mm), 1.0]),
        rows[is_limited],
        right_sides[is_limited],
        bounds=[
            *zip(limits.min_shift_mm, limits.max_shift_mm, strict=True),
            *[(0.0, None)] * count,
            (None, None),
        ],
        method="highs-ds",
    )
    if solution.status != 0:
        return np.zeros(count), math.inf
    return np.asarray(solution.x[:count]), float(solution.x[-1])


def _build_constraints(slopes_s_per_mm: Floats, groups: Ints, count: int) -> Floats:
    """Build the left-hand sides of the constraints on the shifts, their absolute values, and the makespan.

    Parameters
    ----------
    slopes_s_per_mm, groups
        As in `solve_plane_shifts`.
    count
        Number of groups.

    Returns
    -------
    ndarray
        (7 n + 2 groups, 2 groups + 1): rows for the time, the growth and the shrinkage of each part, then for
        the absolute values of the shifts; columns for the shifts, their absolute values, and the makespan.
    """
    n = len(slopes_s_per_mm)
    parts, sides, axes = np.nonzero(groups >= 0)
    faces = groups[parts, sides, axes]
    time_coefficients, length_coefficients = np.zeros((n, count)), np.zeros((n * 3, count))
    np.add.at(time_coefficients, (parts, faces), slopes_s_per_mm[parts, sides, axes])
    np.add.at(length_coefficients, (parts * 3 + axes, faces), 2.0 * sides - 1.0)
    identity, zeros = np.eye(count), np.zeros((n * 3, count))
    return np.block(
        [
            [time_coefficients, np.zeros((n, count)), -np.ones((n, 1))],
            [length_coefficients, zeros, np.zeros((n * 3, 1))],
            [-length_coefficients, zeros, np.zeros((n * 3, 1))],
            [identity, -identity, np.zeros((count, 1))],
            [-identity, -identity, np.zeros((count, 1))],
        ]
    )


def update_slopes(slopes_s_per_mm: Floats, moves_mm: Floats, change_s: float) -> None:
    """Correct the slopes of a part by the measured effect of a move (Broyden's update).

    Parameters
    ----------
    slopes_s_per_mm
        (2, 3) change of the part's time as its faces move up along their axes; updated in place.
    moves_mm
        (2, 3) moves of the faces.
    change_s
        Change of the part's time; it is ignored if it is inf, because a piece did not fit.
    """
    squared_length_mm2 = float((moves_mm * moves_mm).sum()) + NOISE_MM * NOISE_MM
    if math.isfinite(change_s):
        slopes_s_per_mm += (
            (change_s - float((slopes_s_per_mm * moves_mm).sum())) / squared_length_mm2 * moves_mm
        )
