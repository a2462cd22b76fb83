"""The exact guillotine engine: the partition by recursive axis cuts that ends soonest.

For a time T the fewest parts that cover all needed cells of a box is: none where it has no needed cell; one
where it costs at most T and is one piece; or the best sum over all cuts across it. Bisection over T gives the
least makespan for a number of printers. (Hierarchical bipartition HIER-OPT of Saule, Bas and Catalyurek 2012,
in three dimensions and with a cost that is not additive.)

Among partitions of as few parts the one with the least sum of times wins, then the one with the least area of
cuts: the three are digits of one whole number, `_key`, whose sum is made least.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decompose.boxes import Box, Boxes, box_at, box_index, interval
from decompose.jit import jit

UNREACHABLE = 16_000  # more parts than anybody has printers; twice as many are an int16
PART = 1 << 46  # of a key: the digit of the parts
SECOND = 1 << 20  # of the seconds, rounded; what is left counts the area of the cuts
AREA_MM2 = 64.0  # in units of this
MOST_S = 1e6  # so many seconds of a box count, so that the digits keep apart

Table = npt.NDArray[np.int16] | npt.NDArray[np.int64]


@jit
def _least(out: Table, near: Table, far: Table) -> None:
    for i in range(len(out)):
        both = near[i] + far[i]
        if both < out[i]:
            out[i] = both


@jit
def _solve(value: Table, nx: int, ny: int, nz: int) -> None:
    """The least sum over all guillotine partitions of every box, in place; `value` is that of one part.

    Boxes of one length along an axis stand side by side: those of the same sides are added at once, whatever
    their places; along z after they were turned, so that z comes before y.
    A box that is larger than its needed cells needs no care: what a cut takes off there is worth 0.
    """
    ty, tz = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    size = ty * tz
    turned = np.empty(ny * tz, value.dtype)
    for dx in range(1, nx + 1):
        for x0 in range(nx - dx + 1):
            at = interval(x0, x0 + dx, nx) * size
            layer = value[at : at + size]
            for x in range(x0 + 1, x0 + dx):
                a, b = interval(x0, x, nx) * size, interval(x, x0 + dx, nx) * size
                _least(layer, value[a : a + size], value[b : b + size])
            for dy in range(1, ny + 1):
                rows = ny - dy + 1
                at = interval(0, dy, ny) * tz
                block = layer[at : at + rows * tz]
                for cut in range(1, dy):
                    a, b = interval(0, cut, ny) * tz, interval(cut, dy, ny) * tz
                    _least(block, layer[a : a + rows * tz], layer[b : b + rows * tz])
                _turn(block, turned, rows, tz)
                for dz in range(2, nz + 1):
                    places = (nz - dz + 1) * rows
                    at = interval(0, dz, nz) * rows
                    for cut in range(1, dz):
                        a, b = interval(0, cut, nz) * rows, interval(cut, dz, nz) * rows
                        _least(turned[at : at + places], turned[a : a + places], turned[b : b + places])
                _turn(turned, block, tz, rows)


@jit
def _turn(rows: Table, columns: Table, m: int, n: int) -> None:
    """Transpose (m, n) into (n, m)."""
    for i in range(m):
        for k in range(n):
            columns[k * m + i] = rows[i * n + k]


@jit
def _count(
    limit_s: float,
    seconds: npt.NDArray[np.float32],
    trimmed: npt.NDArray[np.int32],
    pieces: npt.NDArray[np.int16],
    value: npt.NDArray[np.int16],
) -> None:
    """The parts of each box where it is not cut."""
    for box in range(len(value)):
        if trimmed[box] < 0:
            value[box] = 0
        else:
            value[box] = pieces[box] if seconds[box] <= limit_s else UNREACHABLE


@jit
def _key(seconds: float, pieces: int, cut_mm2: float) -> int:
    """Of a box that is not cut: parts, seconds and area of cuts as digits of one number."""
    key: int = pieces * PART + round(min(seconds, MOST_S)) * SECOND + round(cut_mm2 / AREA_MM2)
    return key


@jit
def _keys(
    limit_s: float,
    seconds: npt.NDArray[np.float32],
    trimmed: npt.NDArray[np.int32],
    pieces: npt.NDArray[np.int16],
    cut_mm2: npt.NDArray[np.float32],
    value: npt.NDArray[np.int64],
) -> None:
    """The key of each box where it is not cut."""
    for box in range(len(value)):
        if trimmed[box] < 0:
            value[box] = 0
        elif seconds[box] <= limit_s:
            value[box] = _key(seconds[box], pieces[box], cut_mm2[box] if len(cut_mm2) else 0.0)
        else:
            value[box] = UNREACHABLE * PART


class Partitioner:
    """Solves for one table of boxes, and keeps the last solution while the table is as it was."""

    def __init__(self, boxes: Boxes) -> None:
        self.boxes = boxes
        self._value: Table = np.zeros(0, np.int16)
        self._limit_s = 0.0
        self._root: Box = (0, 0, 0, *boxes.shape)

    def parts(self, limit_s: float, ties: bool = False) -> int:
        """The fewest parts that each cost at most limit_s; `UNREACHABLE` where there is no such partition.

        With `ties`, of the solutions with so few the one of least work, then of the least area of cuts.
        """
        b, self._limit_s = self.boxes, limit_s
        if ties:
            keys = np.empty(len(b.seconds), np.int64)
            _keys(limit_s, b.seconds, b.trimmed, b.pieces, b.cut_mm2, keys)
            self._value = keys
        else:
            counts = np.empty(len(b.seconds), np.int16)
            _count(limit_s, b.seconds, b.trimmed, b.pieces, counts)
            self._value = counts
        _solve(self._value, *b.shape)
        return min(int(self.counts[box_index(self._root, b.shape)]), UNREACHABLE)

    @property
    def counts(self) -> npt.NDArray[np.int16]:
        """(boxes,) The fewest parts of each box in the last solution, by the index of the box."""
        if self._value.dtype == np.int64:
            return (self._value // PART).astype(np.int16)
        return self._value.astype(np.int16, copy=False)

    def chosen(self, within: Box | None = None) -> list[Box]:
        """The boxes of the last solution, all or those of one box, in the order of the cuts."""
        found: list[Box] = []
        stack = [within or self._root]
        while stack:
            box = self._tight(stack.pop())
            if box is None:
                continue
            at = box_index(box, self.boxes.shape)
            if self._value[at] == self._uncut(at):
                found.append(box)
            else:
                stack.extend(self._cut(box, int(self._value[at])))
        return found

    def _uncut(self, at: int) -> int:
        """What a box is worth as one part."""
        b = self.boxes
        if not b.seconds[at] <= self._limit_s:
            return UNREACHABLE * PART
        if self._value.dtype == np.int16:
            return int(b.pieces[at])
        return _key(float(b.seconds[at]), int(b.pieces[at]), float(b.cut_mm2[at]) if len(b.cut_mm2) else 0.0)

    def _cut(self, box: Box, value: int) -> tuple[Box, Box]:
        """The far and the near side of the first cut that reaches the value of a box."""
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                far, near = list(box), list(box)
                near[axis + 3] = far[axis] = plane
                sides = _box(far), _box(near)
                if sum(int(self._value[box_index(side, self.boxes.shape)]) for side in sides) == value:
                    return sides
        raise LookupError(f"no solution for {box}: nothing reaches it at this limit")

    def _tight(self, box: Box) -> Box | None:
        at = int(self.boxes.trimmed[box_index(box, self.boxes.shape)])
        return None if at < 0 else box_at(at, self.boxes.shape)

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


def _box(sides: list[int]) -> Box:
    x0, y0, z0, x1, y1, z1 = sides
    return x0, y0, z0, x1, y1, z1
