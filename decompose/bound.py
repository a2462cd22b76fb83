"""A proven lower bound on the makespan: no partition of the grid into boxes ends sooner by the tables.

The certificate is a weight for each needed cell. Of `n` parts that hold all the weight, one holds at least
an n-th of it, so the makespan is at least the time of the quickest box that holds so much (a box of k pieces
is k parts, and has to hold k times as much). That is true of any weights; weights are whole numbers, so that
the comparison is exact, and every box is looked at.

Good weights are the dual solution of a linear programme: cover the needed cells with the fewest boxes,
fractions of boxes allowed, that each take at most T seconds. Where that takes more than n, T is refuted. Its
columns are generated: solve it over few boxes, price all boxes, add those that weigh too much.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog
from scipy.sparse import csc_array

from decompose.boxes import Box, Boxes, box_index, interval
from decompose.jit import jit

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

UNIT = 1 << 24  # the weight of a whole part, once weights are rounded to whole numbers
ROUNDS = 40  # of column generation
CLOSE = 0.005  # a bound this close to what can be proven so is good enough
SMOOTH = 0.5  # share of the best weights so far in those that are priced: dual solutions jump about
IDLE = 0.8  # a box that holds less than this share of what it may is left out of the next programme
LARGE = 1000  # boxes in a programme, beyond which such are left out
MOST_BLOCKS = 600  # cells share a weight in blocks, so that the programme stays small


@dataclass(frozen=True, slots=True)
class Bound:
    """A lower bound and what proves it.

    Attributes
    ----------
    seconds
        Every partition into boxes, of at most as many pieces as printers, has a box that takes this long.
    weights
        (nx, ny, nz) of the cells, whole numbers; 0 where a cell is not needed.
    """

    seconds: float
    weights: Ints


@jit
def _weigh_all(
    sat: Ints,
    printers: int,
    makespan_s: float,
    limit_s: float,
    seconds: npt.NDArray[np.float32],
    trimmed: npt.NDArray[np.int32],
    pieces: npt.NDArray[np.int16],
    heavy: npt.NDArray[np.int32],
) -> tuple[float, float]:
    """Weigh every box: the time that is proven, and the most that a part weighs in a box within the limit.

    sat: summed-area table of the weights. heavy (nx, ny, nz, 3): for each lower corner the upper one of the
    heaviest box within the limit that weighs more than `UNIT` a part; 0 where there is none.
    """
    nx, ny, nz = sat.shape[0] - 1, sat.shape[1] - 1, sat.shape[2] - 1
    ty, tz = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    total = sat[nx, ny, nz]
    proven = makespan_s
    most = 0.0
    heavy[:] = 0
    for x0 in range(nx):
        for y0 in range(ny):
            for z0 in range(nz):
                top = float(UNIT)
                for x1 in range(x0 + 1, nx + 1):
                    ix = interval(x0, x1, nx)
                    for y1 in range(y0 + 1, ny + 1):
                        row = (ix * ty + interval(y0, y1, ny)) * tz
                        for z1 in range(z0 + 1, nz + 1):
                            box = row + interval(z0, z1, nz)
                            t = seconds[box]
                            if not t <= makespan_s or trimmed[box] != box:
                                continue
                            weight = sat[x1, y1, z1] - sat[x0, y1, z1] - sat[x1, y0, z1] - sat[x1, y1, z0]
                            weight += sat[x0, y0, z1] + sat[x0, y1, z0] + sat[x1, y0, z0] - sat[x0, y0, z0]
                            if t < proven and weight * printers >= pieces[box] * total:
                                proven = float(t)
                            if t <= limit_s:
                                share = weight / pieces[box]
                                most = max(most, share)
                                if share > top:
                                    top = share
                                    heavy[x0, y0, z0, 0] = x1
                                    heavy[x0, y0, z0, 1] = y1
                                    heavy[x0, y0, z0, 2] = z1
    return proven, most


class _Master:
    """The linear programme over the boxes that were generated; the cells of a block have one weight."""

    def __init__(self, boxes: Boxes, needed: npt.NDArray[np.bool_]) -> None:
        self._boxes = boxes
        self._needed = needed
        number = _blocks(np.argwhere(needed))
        self._block = np.full(needed.shape, -1)
        self._block[needed] = number
        self._cells = np.bincount(number).astype(np.float64)
        self._shares: dict[int, tuple[Ints, Floats]] = {}  # of which blocks a box has how much

    def add(self, found: Iterable[Box]) -> int:
        """Take boxes in; how many of them are new."""
        before = len(self._shares)
        for x0, y0, z0, x1, y1, z1 in found:
            at = box_index((x0, y0, z0, x1, y1, z1), self._boxes.shape)
            if at not in self._shares:
                inside = self._block[x0:x1, y0:y1, z0:z1].ravel()
                blocks, cells = np.unique(inside[inside >= 0], return_counts=True)
                self._shares[at] = blocks, cells / self._cells[blocks]
        return len(self._shares) - before

    def weights(self, limit_s: float) -> Floats:
        """(nx, ny, nz) The dual solution: weights whose sum is greatest while no box overruns.

        Only boxes that were added and take at most limit_s count. Each block may be covered alone, as a part.
        Of many boxes those that are far from overrun are dropped, so that the programme stays small; should
        later weights overrun one, it is added again.
        """
        columns = [at for at in self._shares if self._boxes.seconds[at] <= limit_s]
        count = len(self._cells)
        shares = [self._shares[at] for at in columns]
        rows = np.concatenate([*(blocks for blocks, _ in shares), np.arange(count)])
        values = np.concatenate([*(share for _, share in shares), np.ones(count)])
        starts = np.cumsum([0, *(len(blocks) for blocks, _ in shares), *([1] * count)])
        cover = csc_array((values, rows, starts), shape=(count, len(columns) + count))
        parts = np.concatenate([self._boxes.pieces[columns].astype(np.float64), np.ones(count)])
        solved = linprog(parts, -cover, -np.ones(count), method="highs-ds")
        spread = np.zeros(self._needed.shape)
        if solved.status == 0:
            each = np.clip(-solved.ineqlin.marginals, 0.0, 1.0)
            held = (cover.T @ each)[: len(columns)] / parts[: len(columns)]
            if len(columns) > LARGE:
                for at in np.array(columns, dtype=np.int64)[held < IDLE].tolist():
                    del self._shares[at]
            spread[self._needed] = (each / self._cells)[self._block[self._needed]]
        return spread


def _blocks(cells: Ints) -> Ints:
    """The number of the block that each cell (n, 3) is in, of the smallest blocks that are few enough."""
    edge = 1
    while True:
        blocks, number = np.unique(cells // edge, axis=0, return_inverse=True)
        if len(blocks) <= MOST_BLOCKS:
            return np.asarray(number.reshape(-1), dtype=np.int64)
        edge += 1


def makespan_bound(
    boxes: Boxes, needed: npt.NDArray[np.bool_], printers: int, found: Iterable[Box], makespan_s: float
) -> Bound:
    """A lower bound on the longest time of any box, over all partitions into boxes, guillotine or not.

    Parameters
    ----------
    boxes
        The tables. The proof is about them: a box takes what it takes in the best of its axis poses, with
        supports down to the bed, and has as many pieces as they say.
    needed
        (nx, ny, nz) cells that must be in some box; at least one.
    printers
        The greatest number of pieces.
    found, makespan_s
        A partition into so many, and its longest time by the tables.

    Returns
    -------
    Bound
        The best that was proven in `ROUNDS` rounds. It misses the optimum by what fractions of boxes win, by
        what weights of single cells would, and by what the rounds did not reach.
    """
    master = _Master(boxes, needed)
    master.add(found)
    low, high, limit = Bound(0.0, np.zeros(needed.shape, np.int64)), makespan_s, makespan_s
    weights = needed * (printers / needed.sum())
    best, best_sum, smooth = weights, 0.0, SMOOTH  # the best at this limit
    heavy = np.zeros((*needed.shape, 3), np.int32)
    for _ in range(ROUNDS):
        whole = np.floor((smooth * best + (1.0 - smooth) * weights) * UNIT).astype(np.int64)
        sat = np.pad(whole, ((1, 0),) * 3).cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
        tables = (boxes.seconds, boxes.trimmed, boxes.pieces)
        proven, most = _weigh_all(sat, printers, makespan_s, limit, *tables, heavy)
        if proven > low.seconds:
            low = Bound(proven, whole)
        scale = 1.0 / max(most, float(UNIT))  # makes them weights that no box within the limit overruns
        if whole.sum() * scale > best_sum:
            best, best_sum = whole * scale, float(whole.sum() * scale)
        lower = np.argwhere(heavy[..., 0] > 0)
        corners = np.hstack([lower, heavy[tuple(lower.T)]]).tolist()
        grew = master.add((a, b, c, d, e, f) for a, b, c, d, e, f in corners) > 0
        if low.seconds >= limit:
            limit, best_sum = (low.seconds + high) / 2.0, 0.0
            grew = True  # nothing was priced at this limit yet
        if high <= low.seconds * (1.0 + CLOSE):
            break
        weights = master.weights(limit)
        if weights.sum() <= printers + 1e-6 or not (grew or smooth):  # no weights refute this limit
            high, limit, best_sum = limit, (low.seconds + limit) / 2.0, 0.0
            grew = True  # as above
        smooth = SMOOTH if grew else 0.0
    return low
