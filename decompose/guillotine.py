"""The exact guillotine engine: the partition by recursive axis cuts that ends soonest.

For a time T the fewest parts that cover all needed cells of a box is: none where it has no needed cell; the
answer of the smaller box about its needed cells, where that is smaller; one where it costs at most T and is
one piece; else the best sum over all cuts across it. Bisection over T gives the least makespan for a number
of printers. (Hierarchical bipartition HIER-OPT of Saule, Bas and Catalyurek 2012, in three dimensions and
with a cost that is not additive.)
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decompose.boxes import Box, Boxes, box_index, ends, interval
from decompose.jit import jit

UNREACHABLE = 30_000  # more parts than anybody has printers


@jit
def _solve(
    limit_s: float,
    seconds: npt.NDArray[np.float32],
    trimmed: npt.NDArray[np.int32],
    pieces: npt.NDArray[np.int16],
    nx: int,
    ny: int,
    nz: int,
    ties: bool,
    count: npt.NDArray[np.int16],
    work: npt.NDArray[np.float32],
    choice: npt.NDArray[np.int16],
) -> None:
    """Fewest parts of each box at a time limit, into `count`; with `ties` the least sum of times among those.

    choice: 0 print it, 1 nothing to print or smaller box, else 2 + 3 * offset of the cut + axis.
    """
    ty, tz = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    for dx in range(1, nx + 1):
        for dy in range(1, ny + 1):
            for dz in range(1, nz + 1):
                for x0 in range(nx - dx + 1):
                    ix = interval(x0, x0 + dx, nx)
                    for y0 in range(ny - dy + 1):
                        iy = interval(y0, y0 + dy, ny)
                        for z0 in range(nz - dz + 1):
                            iz = interval(z0, z0 + dz, nz)
                            box = (ix * ty + iy) * tz + iz
                            tight = trimmed[box]
                            if tight != box:
                                choice[box] = 1
                                count[box] = 0 if tight < 0 else count[tight]
                                work[box] = 0.0 if tight < 0 else work[tight]
                                continue
                            best = 30_000
                            least = np.float32(np.inf)
                            how = 0
                            if seconds[box] <= limit_s:
                                best = pieces[box]
                                least = seconds[box]
                            if best > 1:
                                for axis in range(3):
                                    cells = dx if axis == 0 else dy if axis == 1 else dz
                                    for cut in range(1, cells):
                                        if axis == 0:
                                            a = (interval(x0, x0 + cut, nx) * ty + iy) * tz + iz
                                            b = (interval(x0 + cut, x0 + dx, nx) * ty + iy) * tz + iz
                                        elif axis == 1:
                                            a = (ix * ty + interval(y0, y0 + cut, ny)) * tz + iz
                                            b = (ix * ty + interval(y0 + cut, y0 + dy, ny)) * tz + iz
                                        else:
                                            a = (ix * ty + iy) * tz + interval(z0, z0 + cut, nz)
                                            b = (ix * ty + iy) * tz + interval(z0 + cut, z0 + dz, nz)
                                        n = np.int64(count[a]) + count[b]
                                        if n < best or (ties and n == best and work[a] + work[b] < least):
                                            best = n
                                            least = work[a] + work[b]
                                            how = 2 + 3 * cut + axis
                                    if best == 2 and not ties:
                                        break
                            count[box] = min(best, 30_000)
                            work[box] = least
                            choice[box] = how


class Partitioner:
    """Solves for one table of boxes, and keeps the memory that a solution needs."""

    def __init__(self, boxes: Boxes) -> None:
        self.boxes = boxes
        total = len(boxes.seconds)
        self._count = np.zeros(total, np.int16)
        self._work = np.zeros(total, np.float32)
        self._choice = np.zeros(total, np.int16)
        self._root: Box = (0, 0, 0, *boxes.shape)

    def parts(self, limit_s: float, ties: bool = False) -> int:
        """The fewest parts that each cost at most limit_s; UNREACHABLE where there is no such partition."""
        b = self.boxes
        tables = (b.seconds, b.trimmed, b.pieces)
        _solve(limit_s, *tables, *b.shape, ties, self._count, self._work, self._choice)
        return min(int(self._count[box_index(self._root, b.shape)]), UNREACHABLE)

    @property
    def counts(self) -> npt.NDArray[np.int16]:
        """(boxes,) The fewest parts of each box in the last solution, by the index of the box."""
        return self._count

    def chosen(self, within: Box | None = None) -> list[Box]:
        """The boxes of the last solution, all or those of one box, in the order of the cuts."""
        found: list[Box] = []
        stack = [within or self._root]
        while stack:
            box = self._tight(stack.pop())
            if box is None:
                continue
            how = int(self._choice[box_index(box, self.boxes.shape)])
            if how == 0:
                found.append(box)
                continue
            axis, cut = (how - 2) % 3, (how - 2) // 3
            near, far = list(box), list(box)
            near[axis + 3] = far[axis] = box[axis] + cut
            x0, y0, z0, x1, y1, z1 = far
            stack.append((x0, y0, z0, x1, y1, z1))
            x0, y0, z0, x1, y1, z1 = near
            stack.append((x0, y0, z0, x1, y1, z1))
        return found

    def _tight(self, box: Box) -> Box | None:
        at = int(self.boxes.trimmed[box_index(box, self.boxes.shape)])
        if at < 0:
            return None
        sizes = [n * (n + 1) // 2 for n in self.boxes.shape]
        at, iz = divmod(at, sizes[2])
        ix, iy = divmod(at, sizes[1])
        (x0, x1), (y0, y1), (z0, z1) = (
            ends(i, n) for i, n in zip((ix, iy, iz), self.boxes.shape, strict=True)
        )
        return x0, y0, z0, x1, y1, z1

    def least_makespan(self, printers: int, at_least_s: float, tolerance_s: float = 1.0) -> float | None:
        """The least limit (to tolerance_s) at which `printers` parts are enough; leaves its solution."""
        finite = self.boxes.seconds[np.isfinite(self.boxes.seconds)]
        if not len(finite):
            return None
        low, high = max(0.0, at_least_s), float(finite.max())
        if self.parts(high) > printers:
            return None
        while high - low > tolerance_s:
            middle = (low + high) / 2.0
            if self.parts(middle) <= printers:
                high = min(middle, self.longest_s())
            else:
                low = middle
        self.parts(high, ties=True)
        return high

    def longest_s(self) -> float:
        """The time of the costliest box of the last solution."""
        return self.boxes.longest_s(self.chosen())
