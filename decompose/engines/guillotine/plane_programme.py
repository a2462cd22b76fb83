"""Linear programme of the shifts of cut planes with the least makespan."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import linprog

from decompose.arrays import Floats, Ints

MOVE_S_MM = 0.05  # what a move has to save, so that nothing moves in vain


def solve_plane_shifts(
    seconds: Floats,
    slopes: Floats,
    groups: Ints,
    longer_mm: Floats,
    shorter_mm: Floats,
    low_mm: Floats,
    high_mm: Floats,
) -> tuple[Floats, float]:
    """Solve for the shift of each group with the least makespan, were every part's time linear.

    Parameters
    ----------
    seconds
        (n,) of the parts where they are.
    slopes
        (n, 2, 3) by how many seconds a part changes for each mm that one of its faces moves up its axis.
    groups
        (n, 2, 3) the number of the group that each face moves with; -1 where it is fixed.
    longer_mm, shorter_mm
        (n, 3) by how much each part may get longer and shorter; inf where nothing forbids it.
    low_mm, high_mm
        (groups,) how far each group may move down (at most 0) and up.

    Returns
    -------
    tuple
        Moves (groups,) in mm, and seconds; no moves and inf where the programme has no solution.
    """
    count, n = len(low_mm), len(seconds)
    parts, sides, axes = np.nonzero(groups >= 0)
    faces = groups[parts, sides, axes]
    times, lengths = np.zeros((n, count)), np.zeros((n * 3, count))
    np.add.at(times, (parts, faces), slopes[parts, sides, axes])
    np.add.at(lengths, (parts * 3 + axes, faces), 2.0 * sides - 1.0)
    each, none = np.eye(count), np.zeros((n * 3, count))
    rows = np.block(  # of the moves, how far they are either way, and the makespan
        [
            [times, np.zeros((n, count)), -np.ones((n, 1))],
            [lengths, none, np.zeros((n * 3, 1))],
            [-lengths, none, np.zeros((n * 3, 1))],
            [each, -each, np.zeros((count, 1))],
            [-each, -each, np.zeros((count, 1))],
        ]
    )
    limits = np.concatenate([-seconds, longer_mm.ravel(), shorter_mm.ravel(), np.zeros(2 * count)])
    known = np.isfinite(limits)
    solved = linprog(
        np.array([*np.zeros(count), *np.full(count, MOVE_S_MM), 1.0]),
        rows[known],
        limits[known],
        bounds=[*zip(low_mm, high_mm, strict=True), *[(0.0, None)] * count, (None, None)],
        method="highs-ds",
    )
    if solved.status != 0:
        return np.zeros(count), math.inf
    return np.asarray(solved.x[:count]), float(solved.x[-1])
