"""Fractional covering of cells by the fewest boxes: a linear programme over all boxes within a time.

Only the boxes within the time that no larger one contains are used. These are tens of thousands, with too
many cells each for a simplex method; but summed-area tables take O(1) for a box. So the programme is solved
by the primal-dual hybrid gradient method (Chambolle and Pock 2011; averages, restarts and the balance of the
steps as in PDLP, Applegate et al. 2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Floats, Ints
from decompose.bound.largest_boxes import find_largest_boxes
from decompose.grid import BoxTables
from decompose.jit import jit

RESTARTS, STEPS = 60, 100  # maximum number of restarts, and number of steps between them
ACTIVE_SHARE = 0.9  # share of its maximum weight from which a box may get a share before the next restart
TOLERANCE = 1e-4  # the search stops when the fewest boxes exceed the printers by this share
BOUND_TOLERANCE = 1e-3  # the search stops when the bounds on the fewest boxes differ by this share


@dataclass(frozen=True, slots=True)
class Covering:
    """A fractional covering of cells by boxes, and the weights that bound it from below.

    Attributes
    ----------
    weights
        (nx, ny, nz) weights of needed cells, at least 0. No box within the time holds more weight than it has
        pieces (but for rounding), so that their sum is a lower bound on the pieces of any covering.
    boxes
        (k, 6) int16 boxes within the time that no larger one contains.
    shares
        (k,) share of each box in the covering; their sum is near the minimum.
    """

    weights: Floats
    boxes: npt.NDArray[np.int16]
    shares: Floats


@jit
def _sum_in_boxes(cells: Floats, corners: Ints, sums: Floats, in_box: Floats) -> None:
    """Sum the values of cells in each box, by a summed-area table.

    Parameters
    ----------
    cells
        (nx, ny, nz) values.
    corners
        (k, 8) of `_corners`.
    sums
        (nx + 1, ny + 1, nz + 1) workspace, its first layers 0: the summed-area table.
    in_box
        (k,) filled in.
    """
    nx, ny, nz = cells.shape
    for x in range(nx):
        for y in range(ny):
            run = 0.0
            for z in range(nz):
                run += cells[x, y, z]
                sums[x + 1, y + 1, z + 1] = (
                    run + sums[x, y + 1, z + 1] + sums[x + 1, y, z + 1] - sums[x, y, z + 1]
                )
    s = sums.ravel()
    for k in range(len(corners)):
        c = corners[k]
        added = s[c[0]] + s[c[1]] + s[c[2]] + s[c[3]]
        in_box[k] = added - s[c[4]] - s[c[5]] - s[c[6]] - s[c[7]]


@jit
def _sum_over_cells(shares: Floats, corners: Ints, steps: Floats, covered: Floats) -> None:
    """Sum, for each cell, the shares of the boxes that cover it.

    Parameters
    ----------
    shares
        (k,) of the boxes.
    corners
        (k, 8) of `_corners`.
    steps
        (nx + 1, ny + 1, nz + 1) workspace: differences where boxes begin and end.
    covered
        (nx, ny, nz) filled in.
    """
    s = steps.ravel()
    s[:] = 0.0
    for k in range(len(corners)):
        if shares[k] == 0.0:
            continue
        for i in range(4):
            s[corners[k, i]] -= shares[k]
            s[corners[k, i + 4]] += shares[k]
    nx, ny, nz = covered.shape
    for x in range(nx):
        for y in range(ny):
            run = 0.0
            for z in range(nz):
                run += steps[x, y, z]
                v = run
                if x > 0:
                    v += covered[x - 1, y, z]
                if y > 0:
                    v += covered[x, y - 1, z]
                if x > 0 and y > 0:
                    v -= covered[x - 1, y - 1, z]
                covered[x, y, z] = v


class _Programme(NamedTuple):
    """Linear programme: cover cells with the minimum sum of shares of boxes, times their pieces.

    Attributes
    ----------
    needed
        (nx, ny, nz) bool cells to be covered.
    corners
        (k, 8) int64 of `_corners`.
    pieces
        (k,) float64 number of pieces of each box.
    content
        (k,) float64 number of needed cells in each box.
    overlap
        (nx, ny, nz) float64 number of boxes over each cell.
    """

    needed: Bools
    corners: Ints
    pieces: Floats
    content: Floats
    overlap: Floats


class _Iterate(NamedTuple):
    """Shares (k,) of the boxes and weights (nx, ny, nz) of the cells, float64."""

    shares: Floats
    weights: Floats


class _Workspace(NamedTuple):
    """Arrays that every step uses, float64.

    Attributes
    ----------
    sums, steps
        (nx + 1, ny + 1, nz + 1), see `_sum_in_boxes` and `_sum_over_cells`.
    in_box
        (k,) weight that each box holds.
    covered
        (nx, ny, nz) sum of the shares over each cell.
    extrapolated
        (k,) shares extrapolated by one step.
    """

    sums: Floats
    steps: Floats
    in_box: Floats
    covered: Floats
    extrapolated: Floats


@jit
def _advance(p: _Programme, work: _Workspace, balance: float, current: _Iterate, mean: _Iterate) -> None:
    """Make one step of the method, and add the new iterate to the mean; both are changed in place.

    balance: ratio of the steps in shares to those in weights.
    """
    shares, weights = current.shares, current.weights
    _sum_in_boxes(weights, p.corners, work.sums, work.in_box)
    for k in range(len(shares)):
        share = max(0.0, shares[k] + balance / p.content[k] * (work.in_box[k] - p.pieces[k]))
        work.extrapolated[k] = 2.0 * share - shares[k]
        shares[k] = share
        mean.shares[k] += share / STEPS
    _sum_over_cells(work.extrapolated, p.corners, work.steps, work.covered)
    nx, ny, nz = p.needed.shape
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                if p.needed[x, y, z]:
                    step = (1.0 - work.covered[x, y, z]) / (p.overlap[x, y, z] * balance)
                    weights[x, y, z] = max(0.0, weights[x, y, z] + step)
                    mean.weights[x, y, z] += weights[x, y, z] / STEPS


@jit
def _advance_active(p: _Programme, work: _Workspace, balance: float, current: _Iterate) -> _Iterate:
    """Make `STEPS` steps with the boxes that may get a share in them; return the mean of the iterates.

    These have a share, or hold almost as much weight as they may. The bounds on the fewest boxes use all
    boxes.
    """
    _sum_in_boxes(current.weights, p.corners, work.sums, work.in_box)
    active = np.flatnonzero((current.shares > 0.0) | (work.in_box > ACTIVE_SHARE * p.pieces))
    programme = _Programme(p.needed, p.corners[active], p.pieces[active], p.content[active], p.overlap)
    iterate = _Iterate(current.shares[active], current.weights)
    mean = _Iterate(np.zeros(len(active)), np.zeros(p.needed.shape))
    for _ in range(STEPS):
        _advance(programme, work, balance, iterate, mean)
    current.shares[active] = iterate.shares
    shares = np.zeros(len(p.pieces))
    shares[active] = mean.shares
    return _Iterate(shares, mean.weights)


@jit
def _find_feasibility_divisors(p: _Programme, work: _Workspace, iterate: _Iterate) -> tuple[float, float]:
    """Find the divisors that make an iterate feasible: its weights by the first, its shares by the second.

    The first is the greatest weight per piece in any box, the second the least sum of shares over a needed
    cell.
    """
    _sum_in_boxes(iterate.weights, p.corners, work.sums, work.in_box)
    _sum_over_cells(iterate.shares, p.corners, work.steps, work.covered)
    heaviest_box, least_covered_cell = 1e-12, np.inf
    for k in range(len(p.pieces)):
        heaviest_box = max(heaviest_box, work.in_box[k] / p.pieces[k])
    nx, ny, nz = p.needed.shape
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                if p.needed[x, y, z]:
                    least_covered_cell = min(least_covered_cell, work.covered[x, y, z])
    return heaviest_box, max(least_covered_cell, 1e-12)


@jit
def _search(p: _Programme, work: _Workspace, printers: int, current: _Iterate) -> _Iterate:
    """Search for the best feasible weights and shares, from an iterate that is changed in place.

    Primal-dual hybrid gradients with averages and restarts, see the head of this file. The search ends when
    it is known whether more pieces are needed than there are printers.
    """
    best_weights, best_shares = current.weights.copy(), current.shares.copy()
    lower, upper = 0.0, np.inf  # the sums of both are the bounds on the fewest boxes
    balance = 0.05 * len(p.pieces) / p.needed.sum()
    for _ in range(RESTARTS):
        old = _Iterate(current.shares.copy(), current.weights.copy())
        mean = _advance_active(p, work, balance, current)
        closest, restart = np.inf, mean
        for iterate in (_Iterate(current.shares.copy(), current.weights.copy()), mean):
            heaviest_box, least_covered_cell = _find_feasibility_divisors(p, work, iterate)
            low, high = (
                iterate.weights.sum() / heaviest_box,
                (iterate.shares * p.pieces).sum() / least_covered_cell,
            )
            if low > lower:
                lower, best_weights = low, iterate.weights / heaviest_box
            if high < upper:
                upper, best_shares = high, iterate.shares / least_covered_cell
            if high - low < closest:
                closest, restart = high - low, iterate
        if (
            lower > printers * (1.0 + TOLERANCE)
            or upper <= printers
            or upper - lower < BOUND_TOLERANCE * lower
        ):
            break
        by_shares = ((restart.shares - old.shares) ** 2 * p.content).sum()
        by_weights = ((restart.weights - old.weights) ** 2 * p.overlap).sum()
        if by_shares > 0.0 and by_weights > 0.0:
            balance = np.sqrt(balance * np.sqrt(by_shares / by_weights))
        current.shares[:], current.weights[:] = restart.shares, restart.weights
    return _Iterate(best_shares, best_weights)


@jit
def _solve(
    needed: Bools, corners: Ints, pieces: Floats, overlap: Floats, printers: int, weights: Floats
) -> _Iterate:
    """Find good feasible weights and shares of a `_Programme`.

    Parameters
    ----------
    needed, corners, pieces, overlap
        As in `_Programme`.
    printers
        The search ends when it is known whether more pieces than these are needed.
    weights
        (nx, ny, nz) float64 initial weights; changed in place.
    """
    programme = _Programme(needed, corners, pieces, np.zeros(len(pieces)), overlap)
    nx, ny, nz = needed.shape
    work = _Workspace(
        np.zeros((nx + 1, ny + 1, nz + 1)),
        np.zeros((nx + 1, ny + 1, nz + 1)),
        np.zeros(len(pieces)),
        np.zeros((nx, ny, nz)),
        np.zeros(len(pieces)),
    )
    _sum_in_boxes(needed.astype(np.float64), corners, work.sums, programme.content)
    shares = np.full(len(pieces), weights.sum() / pieces.sum())
    return _search(programme, work, printers, _Iterate(shares, weights))


def cover_cells(boxes: BoxTables, needed: Bools, limit_s: float, printers: int, weights: Floats) -> Covering:
    """Cover the needed cells by the fewest boxes within a time, fractions allowed.

    Parameters
    ----------
    boxes
        The tables.
    needed
        (nx, ny, nz) cells to cover.
    limit_s
        The time.
    printers
        The search ends when it is known whether more pieces than these are needed.
    weights
        (nx, ny, nz) initial weights, 0 if a cell is not needed.

    Returns
    -------
    Covering
        If a needed cell is in no box within the time there is no covering, and all weight is on that cell.
    """
    total = int((boxes.seconds <= limit_s).sum())
    largest, indices = np.zeros((total, 6), np.int16), np.zeros(total, np.int64)
    tables = (boxes.seconds, boxes.trimmed, boxes.pieces)
    count = find_largest_boxes(tables, limit_s, boxes.shape, largest, indices)
    largest = largest[:count].copy()
    corners = _find_corners(largest.astype(np.int64), boxes.shape)
    overlap = np.zeros(needed.shape)
    _sum_over_cells(np.ones(len(largest)), corners, np.zeros([n + 1 for n in boxes.shape]), overlap)
    uncovered_cells = needed & (overlap < 0.5)
    if uncovered_cells.any():
        return Covering(
            (uncovered_cells.cumsum().reshape(uncovered_cells.shape) == 1) * uncovered_cells * 1.0,
            largest,
            np.zeros(len(largest)),
        )
    pieces = boxes.pieces[indices[:count]].astype(np.float64)
    best = _solve(needed, corners, pieces, overlap, printers, weights.copy())
    return Covering(best.weights, largest, best.shares)


def _find_corners(boxes: Ints, shape: tuple[int, int, int]) -> Ints:
    """Find the corners (k, 8) of boxes (k, 6) in a summed-area table, the four positive ones first."""
    _, ny, nz = shape
    x0, y0, z0, x1, y1, z1 = boxes.T

    def find_index(x: Ints, y: Ints, z: Ints) -> Ints:
        return (x * (ny + 1) + y) * (nz + 1) + z

    positive = find_index(x1, y1, z1), find_index(x0, y0, z1), find_index(x0, y1, z0), find_index(x1, y0, z0)
    negative = find_index(x0, y1, z1), find_index(x1, y0, z1), find_index(x1, y1, z0), find_index(x0, y0, z0)
    return np.ascontiguousarray(np.stack([*positive, *negative], axis=1))
