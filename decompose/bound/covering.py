"""Fewest boxes that cover cells, fractions allowed: a linear programme over all boxes within a time.

Only boxes count that no larger one within the time contains: some ten thousands, too many and too wide for a
simplex method, but each is summed and spread in O(1) by summed-area tables. So it is solved by the
primal-dual hybrid gradient method (Chambolle and Pock 2011; averages, restarts and the balance of the steps
as in PDLP, Applegate et al. 2021).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Floats, Ints
from decompose.grid import Box, BoxTables, Shape, box_index, index_of
from decompose.jit import jit

Tables = tuple[npt.NDArray[np.float32], npt.NDArray[np.int32], npt.NDArray[np.int16]]

RESTARTS, STEPS = 60, 100  # so many times, so many steps
SURE = 1e-4  # share by which the fewest boxes exceed the printers when the search stops


@dataclass(frozen=True, slots=True)
class Covering:
    """A fractional covering of cells by boxes, and the weights that bound it from below.

    Attributes
    ----------
    weights
        (nx, ny, nz) of needed cells, at least 0. No box within the time holds more than its pieces of them
        (but for rounding), so that their sum is a lower bound on the pieces of any covering.
    boxes
        (k, 6) the boxes that no larger one within the time contains.
    shares
        (k,) how much of each the covering takes, near the least sum.
    """

    weights: Floats
    boxes: npt.NDArray[np.int16]
    shares: Floats


@jit
def _is_replaced(tables: Tables, limit_s: float, box: Box, shape: Shape) -> bool:
    """Tell whether a box within the limit one layer larger, of no more pieces, can stand for a box."""
    seconds, trimmed, pieces = tables
    at = index_of(box, shape)
    replaced = False
    for face in range(6):
        x0, y0, z0, x1, y1, z1 = box
        larger = at
        while larger == at:  # a layer without needed cells changes nothing
            x0, y0, z0 = x0 - (face == 0), y0 - (face == 1), z0 - (face == 2)
            x1, y1, z1 = x1 + (face == 3), y1 + (face == 4), z1 + (face == 5)
            if min(x0, y0, z0) < 0 or x1 > shape[0] or y1 > shape[1] or z1 > shape[2]:
                break
            larger = trimmed[index_of((x0, y0, z0, x1, y1, z1), shape)]
        if larger != at and seconds[larger] <= limit_s:
            replaced = replaced or pieces[larger] <= pieces[at]
    return replaced


@jit
def _largest(tables: Tables, limit_s: float, shape: Shape, found: npt.NDArray[np.int16]) -> int:
    """Fill in the boxes within the limit that no box one layer larger replaces; return how many they are.

    Parameters
    ----------
    tables
        `seconds` float32, `trimmed` int32 and `pieces` int16 of `BoxTables`, (boxes,) each.
    found
        (k, 6) int16, with room for all boxes within the limit.
    """
    seconds, trimmed, _ = tables
    nx, ny, nz = shape
    count = 0
    for x0 in range(nx):
        for x1 in range(x0 + 1, nx + 1):
            for y0 in range(ny):
                for y1 in range(y0 + 1, ny + 1):
                    for z0 in range(nz):
                        for z1 in range(z0 + 1, nz + 1):
                            box = index_of((x0, y0, z0, x1, y1, z1), shape)
                            if not seconds[box] <= limit_s or trimmed[box] != box:
                                continue
                            if not _is_replaced(tables, limit_s, (x0, y0, z0, x1, y1, z1), shape):
                                found[count, 0], found[count, 1], found[count, 2] = x0, y0, z0
                                found[count, 3], found[count, 4], found[count, 5] = x1, y1, z1
                                count += 1
    return count


@jit
def _hold(cells: Floats, corners: Ints, sums: Floats, held: Floats) -> None:
    """Sum the values of cells in each box, by a summed-area table.

    Parameters
    ----------
    cells
        (nx, ny, nz) values.
    corners
        (k, 8) of `_corners`.
    sums
        (nx + 1, ny + 1, nz + 1) workspace, its first layers 0: the summed-area table.
    held
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
        more = s[c[0]] + s[c[1]] + s[c[2]] + s[c[3]]
        held[k] = more - s[c[4]] - s[c[5]] - s[c[6]] - s[c[7]]


@jit
def _cover(shares: Floats, corners: Ints, steps: Floats, covered: Floats) -> None:
    """Sum, for each cell, the shares of the boxes that cover it.

    Parameters
    ----------
    shares
        (k,) of the boxes.
    corners
        (k, 8) of `_corners`.
    steps
        (nx + 1, ny + 1, nz + 1) workspace: what changes where boxes begin and end.
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


@jit
def _solve(
    needed: Bools, corners: Ints, pieces: Floats, printers: int, weights: Floats
) -> tuple[Floats, Floats]:
    """Best weights and shares found, scaled so that both keep their rules.

    Primal-dual hybrid gradients with averages and restarts, see the head of this file.

    Parameters
    ----------
    needed
        (nx, ny, nz) cells to be covered.
    corners, pieces
        (k, 8) of `_corners` and (k,) pieces of the boxes.
    printers
        The search ends when it is known whether more pieces than these are needed.
    weights
        (nx, ny, nz) to begin with; changed.

    Returns
    -------
    tuple
        Weights (nx, ny, nz) and shares (k,).
    """
    shape = (needed.shape[0] + 1, needed.shape[1] + 1, needed.shape[2] + 1)
    sums, steps, covered = np.zeros(shape), np.zeros(shape), np.zeros(needed.shape)
    held, content, crowd = np.zeros(len(pieces)), np.zeros(len(pieces)), np.zeros(needed.shape)
    _hold(
        needed.astype(np.float64), corners, sums, content
    )  # how many cells a box has, and how many boxes a cell
    _cover(np.ones(len(pieces)), corners, steps, crowd)
    shares = np.full(len(pieces), weights.sum() / pieces.sum())
    ahead = np.zeros(len(pieces))
    best_weights, best_shares = weights.copy(), shares.copy()
    most, least = 0.0, np.inf  # sums of these: the bounds on the fewest boxes
    balance = 0.05 * len(pieces) / needed.sum()  # of the steps in shares to those in weights
    for _ in range(RESTARTS):
        old_shares, old_weights = shares.copy(), weights.copy()
        mean_shares, mean_weights = np.zeros(len(pieces)), np.zeros(needed.shape)
        for _ in range(STEPS):
            _hold(weights, corners, sums, held)
            for k in range(len(pieces)):
                share = max(0.0, shares[k] + balance / content[k] * (held[k] - pieces[k]))
                ahead[k] = 2.0 * share - shares[k]
                shares[k] = share
                mean_shares[k] += share / STEPS
            _cover(ahead, corners, steps, covered)
            for x in range(needed.shape[0]):
                for y in range(needed.shape[1]):
                    for z in range(needed.shape[2]):
                        if needed[x, y, z]:
                            step = (1.0 - covered[x, y, z]) / (crowd[x, y, z] * balance)
                            weights[x, y, z] = max(0.0, weights[x, y, z] + step)
                            mean_weights[x, y, z] += weights[x, y, z] / STEPS
        closest = np.inf
        for mean in range(2):
            s, w = (mean_shares, mean_weights) if mean else (shares.copy(), weights.copy())
            _hold(w, corners, sums, held)
            _cover(s, corners, steps, covered)
            over, open_ = 1e-12, np.inf
            for k in range(len(pieces)):
                over = max(over, held[k] / pieces[k])
            for x in range(needed.shape[0]):
                for y in range(needed.shape[1]):
                    for z in range(needed.shape[2]):
                        if needed[x, y, z]:
                            open_ = min(open_, covered[x, y, z])
            low, high = w.sum() / over, (s * pieces).sum() / max(open_, 1e-12)
            if low > most:
                most, best_weights = low, w / over
            if high < least:
                least, best_shares = high, s / max(open_, 1e-12)
            if high - low < closest:
                closest, next_shares, next_weights = high - low, s, w
        if most > printers * (1.0 + SURE) or least <= printers or least - most < SURE * most:
            break
        by_shares = ((next_shares - old_shares) ** 2 * content).sum()
        by_weights = ((next_weights - old_weights) ** 2 * crowd).sum()
        if by_shares > 0.0 and by_weights > 0.0:
            balance = np.sqrt(balance * np.sqrt(by_shares / by_weights))
        shares[:], weights[:] = next_shares, next_weights
    return best_weights, best_shares


def cover_cells(boxes: BoxTables, needed: Bools, limit_s: float, printers: int, weights: Floats) -> Covering:
    """Cover the needed cells by the fewest boxes within a time, fractions allowed.

    Parameters
    ----------
    needed
        (nx, ny, nz).
    printers
        Nobody looks further than whether more pieces than these are needed.
    weights
        (nx, ny, nz) to begin with, 0 where a cell is not needed.

    Returns
    -------
    Covering
        Where a cell is in no box within the time, nothing covers it: all weight is on that cell.
    """
    found = np.zeros((int((boxes.seconds <= limit_s).sum()), 6), np.int16)
    tables = (boxes.seconds, boxes.trimmed, boxes.pieces)
    found = found[: _largest(tables, limit_s, boxes.shape, found)].copy()
    corners = _corners(found.astype(np.int64), boxes.shape)
    crowd = np.zeros(needed.shape)
    _cover(np.ones(len(found)), corners, np.zeros([n + 1 for n in boxes.shape]), crowd)
    alone = needed & (crowd < 0.5)
    if alone.any():
        return Covering((alone.cumsum().reshape(alone.shape) == 1) * alone * 1.0, found, np.zeros(len(found)))
    at = [box_index((a, b, c, d, e, f), boxes.shape) for a, b, c, d, e, f in found.tolist()]
    pieces = boxes.pieces[at].astype(np.float64)
    best, shares = _solve(needed, corners, pieces, printers, weights.copy())
    return Covering(best, found, shares)


def _corners(boxes: Ints, shape: tuple[int, int, int]) -> Ints:
    """(k, 8) Where the corners of boxes (k, 6) lie in a table one longer each way: first those that add."""
    _, ny, nz = shape
    x0, y0, z0, x1, y1, z1 = boxes.T

    def at(x: Ints, y: Ints, z: Ints) -> Ints:
        return (x * (ny + 1) + y) * (nz + 1) + z

    more = at(x1, y1, z1), at(x0, y0, z1), at(x0, y1, z0), at(x1, y0, z0)
    less = at(x0, y1, z1), at(x1, y0, z1), at(x1, y1, z0), at(x0, y0, z0)
    return np.ascontiguousarray(np.stack([*more, *less], axis=1))
