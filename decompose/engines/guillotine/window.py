"""A part of a partition solved again: some of its boxes, whatever shape they make together.

The tables of a window are those of the grid, but only the cells of its own boxes are to be covered, and a box
that meets another part is worth nothing. Guillotine cuts are exact there as they are anywhere; besides, the
window as a whole may be cut as a pinwheel: four boxes around a fifth, which no guillotine cut can begin.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Ints
from decompose.engines.guillotine.partitioner import Partitioner
from decompose.engines.guillotine.recursion import UNREACHABLE
from decompose.grid import Box, BoxTables, box_index, interval
from decompose.jit import jit

CLOSE = 0.002  # share of the time to which the least makespan is found

Pinwheel = tuple[int, int, int, int, int, int]  # axis that it is extruded along, mirrored, p1, p2, q1, q2


@jit
def _tables(
    mine: Bools,
    others: Ints,
    x: int,
    y: int,
    z: int,
    nx: int,
    ny: int,
    nz: int,
    grid_seconds: npt.NDArray[np.float32],
    grid_pieces: npt.NDArray[np.int16],
    seconds: npt.NDArray[np.float32],
    trimmed: npt.NDArray[np.int32],
    pieces: npt.NDArray[np.int16],
) -> None:
    """Fill in the tables of a window at cell x, y, z of a grid (nx, ny, nz).

    mine: cells to be covered. others: summed-area table of the cells of other parts.
    """
    wx, wy, wz = mine.shape
    ty, tz = wy * (wy + 1) // 2, wz * (wz + 1) // 2
    gy, gz = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    ends = np.zeros((len(seconds), 6), np.int16)  # of the box about the cells to be covered
    for dx in range(1, wx + 1):
        for dy in range(1, wy + 1):
            for dz in range(1, wz + 1):
                for x0 in range(wx - dx + 1):
                    ix = interval(x0, x0 + dx, wx) * ty
                    for y0 in range(wy - dy + 1):
                        iy = (ix + interval(y0, y0 + dy, wy)) * tz
                        for z0 in range(wz - dz + 1):
                            box = iy + interval(z0, z0 + dz, wz)
                            x1, y1, z1 = x0 + dx, y0 + dy, z0 + dz
                            if dx == 1 and dy == 1 and dz == 1:
                                if not mine[x0, y0, z0]:
                                    continue
                                ends[box, 0], ends[box, 1], ends[box, 2] = x0, y0, z0
                                ends[box, 3], ends[box, 4], ends[box, 5] = x1, y1, z1
                            else:  # one layer, and the rest
                                if dz > 1:
                                    near = iy + interval(z0, z1 - 1, wz)
                                    far = iy + interval(z1 - 1, z1, wz)
                                elif dy > 1:
                                    near = (ix + interval(y0, y1 - 1, wy)) * tz + interval(z0, z1, wz)
                                    far = (ix + interval(y1 - 1, y1, wy)) * tz + interval(z0, z1, wz)
                                else:
                                    at = interval(y0, y1, wy) * tz + interval(z0, z1, wz)
                                    near = interval(x0, x1 - 1, wx) * ty * tz + at
                                    far = interval(x1 - 1, x1, wx) * ty * tz + at
                                if trimmed[near] < 0 and trimmed[far] < 0:
                                    continue
                                if trimmed[near] < 0:
                                    ends[box] = ends[far]
                                elif trimmed[far] < 0:
                                    ends[box] = ends[near]
                                else:
                                    for k in range(3):
                                        ends[box, k] = min(ends[near, k], ends[far, k])
                                        ends[box, k + 3] = max(ends[near, k + 3], ends[far, k + 3])
                            e = ends[box]
                            tight = (interval(e[0], e[3], wx) * ty + interval(e[1], e[4], wy)) * tz
                            tight += interval(e[2], e[5], wz)
                            trimmed[box] = tight
                            if tight != box:
                                continue
                            strange = others[x1, y1, z1] - others[x0, y1, z1] - others[x1, y0, z1]
                            strange += others[x0, y0, z1] - others[x1, y1, z0] + others[x0, y1, z0]
                            strange += others[x1, y0, z0] - others[x0, y0, z0]
                            if strange > 0:
                                continue
                            on_grid = interval(x + x0, x + x1, nx) * gy + interval(y + y0, y + y1, ny)
                            on_grid = on_grid * gz + interval(z + z0, z + z1, nz)
                            seconds[box] = grid_seconds[on_grid]
                            pieces[box] = grid_pieces[on_grid]


@jit
def _fewest_in_pinwheel(
    counts: npt.NDArray[np.int16], wx: int, wy: int, wz: int
) -> tuple[int, int, int, int, int, int, int]:
    """Fewest parts of a pinwheel of the whole window, and the pinwheel; see `pinwheel_boxes`."""
    sizes = (wx, wy, wz)
    strides = (wy * (wy + 1) // 2 * (wz * (wz + 1) // 2), wz * (wz + 1) // 2, 1)
    best = (UNREACHABLE, 0, 0, 0, 0, 0, 0)
    for axis in range(3):
        p_axis, q_axis = (axis + 1) % 3, (axis + 2) % 3
        p, q = sizes[p_axis], sizes[q_axis]
        sp, sq = strides[p_axis], strides[q_axis]
        whole = interval(0, sizes[axis], sizes[axis]) * strides[axis]
        for p1 in range(1, p - 1):
            for p2 in range(p1 + 1, p):
                for q1 in range(1, q - 1):
                    for q2 in range(q1 + 1, q):
                        low, high = interval(0, q1, q) * sq, interval(q2, q, q) * sq
                        lower, upper = interval(0, q2, q) * sq, interval(q1, q, q) * sq
                        middle = interval(p1, p2, p) * sp + interval(q1, q2, q) * sq
                        centre = np.int64(counts[whole + middle])
                        n = centre + counts[whole + interval(0, p2, p) * sp + low]
                        n += counts[whole + interval(p2, p, p) * sp + lower]
                        n += counts[whole + interval(p1, p, p) * sp + high]
                        n += counts[whole + interval(0, p1, p) * sp + upper]
                        if n < best[0]:
                            best = (n, axis, 0, p1, p2, q1, q2)
                        n = centre + counts[whole + interval(p1, p, p) * sp + low]
                        n += counts[whole + interval(0, p1, p) * sp + lower]
                        n += counts[whole + interval(0, p2, p) * sp + high]
                        n += counts[whole + interval(p2, p, p) * sp + upper]
                        if n < best[0]:
                            best = (n, axis, 1, p1, p2, q1, q2)
    return best


def pinwheel_boxes(shape: tuple[int, int, int], wheel: Pinwheel) -> list[Box]:
    """Five boxes of a pinwheel that fills a grid of this shape; the last one is in the middle."""
    axis, mirrored, p1, p2, q1, q2 = wheel
    p, q = shape[(axis + 1) % 3], shape[(axis + 2) % 3]
    if mirrored:
        flat = [(p1, p, 0, q1), (0, p1, 0, q2), (0, p2, q2, q), (p2, p, q1, q), (p1, p2, q1, q2)]
    else:
        flat = [(0, p2, 0, q1), (p2, p, 0, q2), (p1, p, q2, q), (0, p1, q1, q), (p1, p2, q1, q2)]
    boxes = []
    for a, b, c, d in flat:
        lo, hi = [0, 0, 0], list(shape)
        lo[(axis + 1) % 3], hi[(axis + 1) % 3] = a, b
        lo[(axis + 2) % 3], hi[(axis + 2) % 3] = c, d
        boxes.append((lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]))
    return boxes


class Window:
    """Some boxes of a partition, to be cut anew between the others.

    Parameters
    ----------
    boxes
        The tables of the grid.
    mine, others
        The boxes of the partition that are cut anew, and all the rest.
    """

    def __init__(self, boxes: BoxTables, mine: Iterable[Box], others: Iterable[Box]) -> None:
        own = np.array(sorted(mine))
        self._lo, hi = own[:, :3].min(axis=0), own[:, 3:].max(axis=0)
        nx, ny, nz = (hi - self._lo).tolist()
        self.shape = (nx, ny, nz)
        covered = self._covered(own)
        left, front, bottom = self._lo.tolist()
        for cell in np.argwhere(covered):
            x, y, z = (self._lo + cell).tolist()
            covered[tuple(cell)] = boxes.trimmed[box_index((x, y, z, x + 1, y + 1, z + 1), boxes.shape)] >= 0
        rest = np.array(list(others)).reshape(-1, 6)
        rest = rest[(rest[:, :3] < hi).all(axis=1) & (rest[:, 3:] > self._lo).all(axis=1)]
        strange = self._covered(rest).astype(np.int64)
        sums = np.pad(strange, ((1, 0),) * 3).cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
        total = int(np.prod([n * (n + 1) // 2 for n in self.shape]))
        seconds = np.full(total, np.inf, np.float32)
        trimmed = np.full(total, -1, np.int32)
        pieces = np.ones(total, np.int16)
        on_grid = (boxes.seconds, boxes.pieces)
        _tables(covered, sums, left, front, bottom, *boxes.shape, *on_grid, seconds, trimmed, pieces)
        self._solver = Partitioner(BoxTables(self.shape, seconds, trimmed, pieces))
        self._wheel: Pinwheel | None = None

    @property
    def boxes(self) -> int:
        """Number of boxes in its tables."""
        return len(self._solver.boxes.seconds)

    @property
    def sums(self) -> int:
        """Number of sums of all its solves."""
        return self._solver.sums

    def _covered(self, boxes: Ints) -> Bools:
        """(nx, ny, nz) Cells of the window that lie in some of these boxes (n, 6)."""
        inside = np.zeros(self.shape, dtype=np.bool_)
        for box in boxes:
            lo, hi = np.maximum(box[:3] - self._lo, 0), box[3:] - self._lo
            inside[lo[0] : hi[0], lo[1] : hi[1], lo[2] : hi[2]] = True
        return inside

    def fewest_parts(self, limit_s: float) -> int:
        """Fewest parts that each take at most limit_s; `UNREACHABLE` or more where there are none."""
        by_cuts = self._solver.solve(limit_s, ties=True)
        count, *wheel = _fewest_in_pinwheel(self._solver.counts, *self.shape)
        axis, mirrored, p1, p2, q1, q2 = wheel
        self._wheel = (axis, mirrored, p1, p2, q1, q2) if count < by_cuts else None
        return min(by_cuts, int(count))

    def chosen_boxes(self) -> list[Box]:
        """Boxes of the last solution, in the cells of the grid."""
        if self._wheel is None:
            found = self._solver.chosen_boxes()
        else:
            arms = pinwheel_boxes(self.shape, self._wheel)
            found = [box for arm in arms for box in self._solver.chosen_boxes(arm)]
        x, y, z = self._lo.tolist()
        return [(a + x, b + y, c + z, d + x, e + y, f + z) for a, b, c, d, e, f in found]

    def solve(self, parts: int, below_s: float, least_s: float) -> list[Box] | None:
        """Cut it into at most so many parts, all faster than below_s, about as fast as possible.

        Nobody looks below least_s.
        """
        high = float(np.nextafter(np.float32(below_s), np.float32(0.0)))
        if self.fewest_parts(high) > parts:
            return None
        found, low = self.chosen_boxes(), least_s
        while high - low > CLOSE * high:
            middle = (low + high) / 2.0
            if self.fewest_parts(middle) <= parts:
                found, high = self.chosen_boxes(), middle
            else:
                low = middle
        return found
