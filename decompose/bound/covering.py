"""Fractional covering of cells with the fewest boxes whose print time is within a limit: a linear programme.

A fractional covering uses a share of each box. Over each cell, the shares of the boxes add up to at least 1.

Boxes that a larger box within the limit can replace are not used (`largest_boxes`). Tens of thousands of
boxes remain. They contain too many cells for a simplex method, but a summed-area table gives the sum
over a box in constant time. So the programme is solved by the primal-dual hybrid gradient method (Chambolle
and Pock 2011), with averages, restarts and a balance of primal and dual steps (the primal weight) as in PDLP
(Applegate et al. 2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Floats, Ints
from decompose.bound.box_sums import find_corners, sum_in_boxes, sum_over_cells
from decompose.bound.largest_boxes import find_largest_boxes
from decompose.grid import BoxTables
from decompose.jit import jit

MAX_RESTARTS, RESTART_STEPS = 60, 100  # maximum number of restarts, and number of steps between them
# A box with a share of 0 is left out of the steps until the next restart if the weight in it is below this
# fraction of the maximum (its number of pieces).
MIN_ACTIVE_FRACTION = 0.9
# The search stops when the lower bound on the number of pieces exceeds the number of printers by this share.
TOLERANCE = 1e-4
# The search stops when the bounds on the minimum number of pieces differ by less than this fraction.
BOUND_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Covering:
    """Fractional covering of cells by boxes, and the weights that bound it from below.

    Attributes
    ----------
    weights
        (nx, ny, nz) float64 weights of needed cells, at least 0. The total weight in a box within the limit
        is at most the number of pieces of the box (except for rounding). So the sum of all weights is a lower
        bound on the number of pieces of any covering.
    boxes
        (k, 6) int16 boxes within the limit that no larger box can replace.
    shares
        (k,) float64 share of each box in the covering. The sum of share times number of pieces over all
        boxes is near its minimum.
    """

    weights: Floats
    boxes: npt.NDArray[np.int16]
    shares: Floats


class _Programme(NamedTuple):
    """Linear programme: cover the needed cells with the fewest pieces, each box counted by its share.

    Attributes
    ----------
    is_needed
        (nx, ny, nz) bool, true for cells to be covered.
    corners
        (k, 8) int64 from `find_corners`.
    piece_counts
        (k,) float64 number of pieces of each box.
    needed_counts
        (k,) float64 number of needed cells in each box.
    overlap
        (nx, ny, nz) float64 number of boxes that contain each cell.
    """

    is_needed: Bools
    corners: Ints
    piece_counts: Floats
    needed_counts: Floats
    overlap: Floats


class _Iterate(NamedTuple):
    """Shares (k,) float64 of the boxes, and weights (nx, ny, nz) float64 of the cells."""

    shares: Floats
    weights: Floats


class _Workspace(NamedTuple):
    """Arrays that every step overwrites, float64.

    Attributes
    ----------
    sums, differences
        (nx + 1, ny + 1, nz + 1), see `sum_in_boxes` and `sum_over_cells`.
    box_sums
        (k,) weight in each box.
    cell_sums
        (nx, ny, nz) sum of the shares over each cell.
    extrapolated_shares
        (k,) shares extrapolated by one step.
    """

    sums: Floats
    differences: Floats
    box_sums: Floats
    cell_sums: Floats
    extrapolated_shares: Floats


@jit
def _take_step(p: _Programme, work: _Workspace, balance: float, iterate: _Iterate, mean: _Iterate) -> None:
    """Take one step of the method, and add the new iterate to the mean.

    Parameters
    ----------
    p
        Linear programme.
    work
        Workspace.
    balance
        Factor of the step sizes of the shares; the step sizes of the weights are divided by it.
    iterate, mean
        Iterate, and mean of the iterates of `RESTART_STEPS` steps; both are updated in place.
    """
    shares, weights = iterate.shares, iterate.weights
    sum_in_boxes(weights, p.corners, work.sums, work.box_sums)
    for k in range(len(shares)):
        share = max(0.0, shares[k] + balance / p.needed_counts[k] * (work.box_sums[k] - p.piece_counts[k]))
        work.extrapolated_shares[k] = 2.0 * share - shares[k]
        shares[k] = share
        mean.shares[k] += share / RESTART_STEPS
    sum_over_cells(work.extrapolated_shares, p.corners, work.differences, work.cell_sums)
    nx, ny, nz = p.is_needed.shape
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                if p.is_needed[x, y, z]:
                    step = (1.0 - work.cell_sums[x, y, z]) / (p.overlap[x, y, z] * balance)
                    weights[x, y, z] = max(0.0, weights[x, y, z] + step)
                    mean.weights[x, y, z] += weights[x, y, z] / RESTART_STEPS


@jit
def _take_steps_with_active_boxes(
    p: _Programme, work: _Workspace, balance: float, iterate: _Iterate
) -> _Iterate:
    """Take `RESTART_STEPS` steps with the active boxes; return the mean of the iterates.

    The active boxes are those that have a share above 0, or almost their maximum weight. The bounds on the
    minimum number of pieces use all boxes.

    Parameters
    ----------
    p, work, balance
        As in `_take_step`.
    iterate
        Iterate, updated in place.
    """
    sum_in_boxes(iterate.weights, p.corners, work.sums, work.box_sums)
    active = np.flatnonzero((iterate.shares > 0.0) | (work.box_sums > MIN_ACTIVE_FRACTION * p.piece_counts))
    programme = _Programme(
        p.is_needed, p.corners[active], p.piece_counts[active], p.needed_counts[active], p.overlap
    )
    active_iterate = _Iterate(iterate.shares[active], iterate.weights)
    mean = _Iterate(np.zeros(len(active)), np.zeros(p.is_needed.shape))
    for _ in range(RESTART_STEPS):
        _take_step(programme, work, balance, active_iterate, mean)
    iterate.shares[active] = active_iterate.shares
    shares = np.zeros(len(p.piece_counts))
    shares[active] = mean.shares
    return _Iterate(shares, mean.weights)


@jit
def _find_feasibility_divisors(p: _Programme, work: _Workspace, iterate: _Iterate) -> tuple[float, float]:
    """Find the divisors that make the weights and the shares of an iterate feasible.

    Parameters
    ----------
    p, work
        Linear programme, and workspace.
    iterate
        Iterate; it is not changed.

    Returns
    -------
    tuple
        Greatest weight per piece in any box, and least sum of shares over a needed cell.
    """
    sum_in_boxes(iterate.weights, p.corners, work.sums, work.box_sums)
    sum_over_cells(iterate.shares, p.corners, work.differences, work.cell_sums)
    max_weight, min_share = 1e-12, np.inf
    for k in range(len(p.piece_counts)):
        max_weight = max(max_weight, work.box_sums[k] / p.piece_counts[k])
    nx, ny, nz = p.is_needed.shape
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                if p.is_needed[x, y, z]:
                    min_share = min(min_share, work.cell_sums[x, y, z])
    return max_weight, max(min_share, 1e-12)


@jit
def _find_best_iterate(p: _Programme, work: _Workspace, printer_count: int, iterate: _Iterate) -> _Iterate:
    """Find the best feasible weights and shares by the primal-dual method.

    The search ends early if it becomes known whether more pieces are needed than there are printers.

    Parameters
    ----------
    p, work
        Linear programme, and workspace.
    printer_count
        Number of printers.
    iterate
        Iterate to start from, updated in place.
    """
    best_weights, best_shares = iterate.weights.copy(), iterate.shares.copy()
    # Bounds on the minimum number of pieces, from the best weights and the best shares.
    lower_bound, upper_bound = 0.0, np.inf
    balance = 0.05 * len(p.piece_counts) / p.is_needed.sum()
    for _ in range(MAX_RESTARTS):
        start = _Iterate(iterate.shares.copy(), iterate.weights.copy())
        mean = _take_steps_with_active_boxes(p, work, balance, iterate)
        smallest_gap, restart = np.inf, mean  # the next restart begins at this iterate
        for candidate in (_Iterate(iterate.shares.copy(), iterate.weights.copy()), mean):
            max_weight, min_share = _find_feasibility_divisors(p, work, candidate)
            low, high = (
                candidate.weights.sum() / max_weight,
                (candidate.shares * p.piece_counts).sum() / min_share,
            )
            if low > lower_bound:
                lower_bound, best_weights = low, candidate.weights / max_weight
            if high < upper_bound:
                upper_bound, best_shares = high, candidate.shares / min_share
            if high - low < smallest_gap:
                smallest_gap, restart = high - low, candidate
        if (
            lower_bound > printer_count * (1.0 + TOLERANCE)
            or upper_bound <= printer_count
            or upper_bound - lower_bound < BOUND_TOLERANCE * lower_bound
        ):
            break
        squared_share_distance = ((restart.shares - start.shares) ** 2 * p.needed_counts).sum()
        squared_weight_distance = ((restart.weights - start.weights) ** 2 * p.overlap).sum()
        if squared_share_distance > 0.0 and squared_weight_distance > 0.0:
            balance = np.sqrt(balance * np.sqrt(squared_share_distance / squared_weight_distance))
        iterate.shares[:], iterate.weights[:] = restart.shares, restart.weights
    return _Iterate(best_shares, best_weights)


@jit
def _solve_programme(
    is_needed: Bools,
    corners: Ints,
    piece_counts: Floats,
    overlap: Floats,
    printer_count: int,
    weights: Floats,
) -> _Iterate:
    """Build a `_Programme`, and find good feasible weights and shares of it.

    Parameters
    ----------
    is_needed, corners, piece_counts, overlap
        Arrays of `_Programme`.
    printer_count
        Maximum number of pieces; the search ends early if it becomes known whether more are needed.
    weights
        (nx, ny, nz) float64 initial weights, updated in place.
    """
    programme = _Programme(is_needed, corners, piece_counts, np.zeros(len(piece_counts)), overlap)
    nx, ny, nz = is_needed.shape
    work = _Workspace(
        np.zeros((nx + 1, ny + 1, nz + 1)),
        np.zeros((nx + 1, ny + 1, nz + 1)),
        np.zeros(len(piece_counts)),
        np.zeros((nx, ny, nz)),
        np.zeros(len(piece_counts)),
    )
    sum_in_boxes(is_needed.astype(np.float64), corners, work.sums, programme.needed_counts)
    shares = np.full(len(piece_counts), weights.sum() / piece_counts.sum())
    return _find_best_iterate(programme, work, printer_count, _Iterate(shares, weights))


def cover_cells(
    tables: BoxTables, is_needed: Bools, limit_s: float, printer_count: int, weights: Floats
) -> Covering:
    """Cover the needed cells with the fewest boxes whose print time is within a limit, or fractions of them.

    Parameters
    ----------
    tables
        Tables of the grid.
    is_needed
        (nx, ny, nz) bool, true for cells to be covered.
    limit_s
        Maximum print time of a box.
    printer_count
        Maximum number of pieces; the search ends early if it becomes known whether more are needed.
    weights
        (nx, ny, nz) float64 initial weights, 0 if a cell is not needed.

    Returns
    -------
    Covering
        Covering near the minimum. If needed cells are in no box within the limit, there is no covering,
        and all weight is on the first of these cells.
    """
    max_count = int((tables.seconds <= limit_s).sum())
    largest_boxes, indices = np.zeros((max_count, 6), np.int16), np.zeros(max_count, np.int64)
    arrays = (tables.seconds, tables.trimmed_box, tables.piece_counts)
    count = find_largest_boxes(arrays, limit_s, tables.shape, largest_boxes, indices)
    largest_boxes = largest_boxes[:count].copy()
    corners = find_corners(largest_boxes.astype(np.int64), tables.shape)
    overlap = np.zeros(is_needed.shape)
    sum_over_cells(np.ones(len(largest_boxes)), corners, np.zeros([n + 1 for n in tables.shape]), overlap)
    uncovered_cells = is_needed & (overlap < 0.5)
    if uncovered_cells.any():
        return Covering(
            (uncovered_cells.cumsum().reshape(uncovered_cells.shape) == 1) * uncovered_cells * 1.0,
            largest_boxes,
            np.zeros(len(largest_boxes)),
        )
    piece_counts = tables.piece_counts[indices[:count]].astype(np.float64)
    best = _solve_programme(is_needed, corners, piece_counts, overlap, printer_count, weights.copy())
    return Covering(best.weights, largest_boxes, best.shares)
