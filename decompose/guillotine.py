"""The exact guillotine engine: the partition by recursive axis cuts that ends soonest.

For a time T the fewest parts that cover all needed cells of a box is: none where it has no needed cell; the
answer of the smaller box about its needed cells, where that is smaller; one where it costs at most T and is
one piece; else the best sum over all cuts across it. Bisection over T gives the least makespan for a number
of printers. (Hierarchical bipartition HIER-OPT of Saule, Bas and Catalyurek 2012, in three dimensions and
with a cost that is not additive.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decompose.cost import CostModel, PrinterRoom
from decompose.grid import Grid
from decompose.jit import jit

Floats = npt.NDArray[np.float64]
Box = tuple[int, int, int, int, int, int]  # x0, y0, z0, x1, y1, z1 in cells, half-open

UNREACHABLE = 30_000  # more parts than anybody has printers


@dataclass(frozen=True, slots=True)
class Boxes:
    """Every axis-aligned box of a grid. A box's index combines those of its intervals along x, y and z.

    Attributes
    ----------
    seconds
        (boxes,) print time in the best pose that fits; +inf where none fits or it was not worth computing.
    trimmed
        (boxes,) index of the box about its needed cells, -1 where it has none.
    pieces
        (boxes,) connected pieces of the solid in it, as far as the grid can tell.
    """

    shape: tuple[int, int, int]
    seconds: npt.NDArray[np.float32]
    trimmed: npt.NDArray[np.int32]
    pieces: npt.NDArray[np.int16]


@jit
def _interval(lo: int, hi: int, n: int) -> int:
    """Index of the interval [lo, hi) among all n(n+1)/2 intervals of n cells, by length."""
    length = hi - lo
    return (length - 1) * n - (length - 1) * (length - 2) // 2 + lo


@jit
def _index(x0: int, y0: int, z0: int, x1: int, y1: int, z1: int, nx: int, ny: int, nz: int) -> int:
    ty, tz = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    return (_interval(x0, x1, nx) * ty + _interval(y0, y1, ny)) * tz + _interval(z0, z1, nz)


@jit
def _fits(rooms: Floats, width: float, depth: float, height: float) -> bool:
    for r in range(len(rooms)):
        fits = False
        for b in range(rooms.shape[1]):
            x, y, z = rooms[r, b, 0], rooms[r, b, 1], rooms[r, b, 2]
            if height <= z and ((width <= x and depth <= y) or (depth <= x and width <= y)):
                fits = True
        if not fits:
            return False
    return True


@jit
def _all_boxes(
    needed: npt.NDArray[np.bool_],
    sums: Floats,
    extents: Floats,
    cut_x: Floats,
    cut_y: Floats,
    cut_z: Floats,
    rooms: Floats,
    c: Floats,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32], npt.NDArray[np.int16]]:
    """Cost, trimmed box and pieces of every box, adding up a row, then a layer, then a box at a time.

    cut_*: prefix sums of the cut areas over the two axes of each plane.
    """
    nx, ny, nz = needed.shape
    total = nx * (nx + 1) // 2 * (ny * (ny + 1) // 2) * (nz * (nz + 1) // 2)
    seconds = np.full(total, np.inf, np.float32)
    trimmed = np.full(total, -1, np.int32)
    pieces = np.ones(total, np.int16)
    columns = sums.shape[3]
    first = np.zeros((nx, ny, nz, 6))  # needed cells: their own indices, as extents
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                for k in range(6):
                    first[x, y, z, k] = 1e9 if k < 3 else -1e9
                if needed[x, y, z]:
                    first[x, y, z, 0], first[x, y, z, 3] = x, x + 1
                    first[x, y, z, 1], first[x, y, z, 4] = y, y + 1
                    first[x, y, z, 2], first[x, y, z, 5] = z, z + 1
    ends = np.concatenate((extents, first), axis=3)  # 12 columns: 0-2 and 6-8 least, 3-5 and 9-11 greatest
    row = np.zeros((ny, nz, columns))
    row_ends = np.zeros((ny, nz, 12))
    layer = np.zeros((nz, columns))
    layer_ends = np.zeros((nz, 12))
    s = np.zeros(columns)
    e = np.zeros(12)
    face = np.zeros(6)
    for x0 in range(nx):
        row[:] = 0.0
        for k in range(12):
            row_ends[:, :, k] = np.inf if k % 6 < 3 else -np.inf
        for x1 in range(x0 + 1, nx + 1):
            for y in range(ny):
                for z in range(nz):
                    for k in range(columns):
                        row[y, z, k] += sums[x1 - 1, y, z, k]
                    for k in range(12):
                        v = ends[x1 - 1, y, z, k]
                        if k % 6 < 3:
                            row_ends[y, z, k] = min(row_ends[y, z, k], v)
                        else:
                            row_ends[y, z, k] = max(row_ends[y, z, k], v)
            for y0 in range(ny):
                layer[:] = 0.0
                for k in range(12):
                    layer_ends[:, k] = np.inf if k % 6 < 3 else -np.inf
                for y1 in range(y0 + 1, ny + 1):
                    for z in range(nz):
                        for k in range(columns):
                            layer[z, k] += row[y1 - 1, z, k]
                        for k in range(12):
                            v = row_ends[y1 - 1, z, k]
                            if k % 6 < 3:
                                layer_ends[z, k] = min(layer_ends[z, k], v)
                            else:
                                layer_ends[z, k] = max(layer_ends[z, k], v)
                    for z0 in range(nz):
                        s[:] = 0.0
                        for k in range(12):
                            e[k] = np.inf if k % 6 < 3 else -np.inf
                        for z1 in range(z0 + 1, nz + 1):
                            for k in range(columns):
                                s[k] += layer[z1 - 1, k]
                            for k in range(12):
                                v = layer_ends[z1 - 1, k]
                                if k % 6 < 3:
                                    e[k] = min(e[k], v)
                                else:
                                    e[k] = max(e[k], v)
                            if e[9] < 0.0:
                                continue  # no needed cell
                            box = _index(x0, y0, z0, x1, y1, z1, nx, ny, nz)
                            tight = _index(
                                int(e[6]), int(e[7]), int(e[8]), int(e[9]), int(e[10]), int(e[11]), nx, ny, nz
                            )
                            trimmed[box] = tight
                            if tight != box:
                                continue
                            for i in range(2):
                                x, y, z = (x0, y0, z0) if i == 0 else (x1, y1, z1)
                                face[i] = (
                                    cut_x[x, y1, z1] - cut_x[x, y0, z1] - cut_x[x, y1, z0] + cut_x[x, y0, z0]
                                )
                                face[2 + i] = (
                                    cut_y[x1, y, z1] - cut_y[x0, y, z1] - cut_y[x1, y, z0] + cut_y[x0, y, z0]
                                )
                                face[4 + i] = (
                                    cut_z[x1, y1, z] - cut_z[x0, y1, z] - cut_z[x1, y0, z] + cut_z[x0, y0, z]
                                )
                            cut = face.sum()
                            best = np.inf
                            for up in range(3):
                                width = e[(up + 1) % 3 + 3] - e[(up + 1) % 3]
                                depth = e[(up + 2) % 3 + 3] - e[(up + 2) % 3]
                                height = e[up + 3] - e[up]
                                if not _fits(rooms, width, depth, height):
                                    continue
                                flat = face[2 * up] + face[2 * up + 1]
                                over = min(
                                    s[13 + 2 * up] - s[7 + 2 * up] * e[up],
                                    s[8 + 2 * up] * e[up + 3] - s[14 + 2 * up],
                                )
                                t = (
                                    c[0]
                                    + c[1] * s[0]
                                    + c[2] * (s[1 + up] + cut - flat)
                                    + c[3] * (s[4 + up] + flat)
                                    + c[4] * over
                                    + c[5] * c[7] * (2.0 * (width + depth) + np.pi * c[7])
                                    + c[6] * height
                                )
                                best = min(best, t)
                            seconds[box] = best
    return seconds, trimmed, pieces


@jit
def _count_pieces(
    full: npt.NDArray[np.bool_],
    open_x: npt.NDArray[np.bool_],
    open_y: npt.NDArray[np.bool_],
    open_z: npt.NDArray[np.bool_],
    trimmed: npt.NDArray[np.int32],
    seconds: npt.NDArray[np.float32],
    pieces: npt.NDArray[np.int16],
) -> None:
    """Pieces of every box that may be printed, each cell's solid taken as one: union-find by layers.

    open_*: whether solid crosses the near side of a cell along that axis.
    """
    nx, ny, nz = full.shape
    parent = np.zeros(nx * ny * nz, np.int32)
    for x0 in range(nx):
        for x1 in range(x0 + 1, nx + 1):
            for y0 in range(ny):
                for y1 in range(y0 + 1, ny + 1):
                    for z0 in range(nz):
                        k = 0
                        for z in range(z0, nz):
                            for x in range(x0, x1):
                                for y in range(y0, y1):
                                    if not full[x, y, z]:
                                        continue
                                    me = (x * ny + y) * nz + z
                                    parent[me] = me
                                    k += 1
                                    for axis in range(3):
                                        if axis == 0:
                                            linked = x > x0 and open_x[x, y, z]
                                            other = me - ny * nz
                                        elif axis == 1:
                                            linked = y > y0 and open_y[x, y, z]
                                            other = me - nz
                                        else:
                                            linked = z > z0 and open_z[x, y, z]
                                            other = me - 1
                                        if not linked:
                                            continue
                                        a = me
                                        while parent[a] != a:
                                            parent[a] = parent[parent[a]]
                                            a = parent[a]
                                        b = other
                                        while parent[b] != b:
                                            parent[b] = parent[parent[b]]
                                            b = parent[b]
                                        if a != b:
                                            parent[max(a, b)] = min(a, b)
                                            k -= 1
                            box = _index(x0, y0, z0, x1, y1, z + 1, nx, ny, nz)
                            if trimmed[box] == box and seconds[box] < np.inf:
                                pieces[box] = max(1, k)


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
                    ix = _interval(x0, x0 + dx, nx)
                    for y0 in range(ny - dy + 1):
                        iy = _interval(y0, y0 + dy, ny)
                        for z0 in range(nz - dz + 1):
                            iz = _interval(z0, z0 + dz, nz)
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
                                            a = (_interval(x0, x0 + cut, nx) * ty + iy) * tz + iz
                                            b = (_interval(x0 + cut, x0 + dx, nx) * ty + iy) * tz + iz
                                        elif axis == 1:
                                            a = (ix * ty + _interval(y0, y0 + cut, ny)) * tz + iz
                                            b = (ix * ty + _interval(y0 + cut, y0 + dy, ny)) * tz + iz
                                        else:
                                            a = (ix * ty + iy) * tz + _interval(z0, z0 + cut, nz)
                                            b = (ix * ty + iy) * tz + _interval(z0 + cut, z0 + dz, nz)
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


def shared_rooms(printers: list[PrinterRoom]) -> Floats:
    """The distinct rooms as (rooms, boxes, 3) in mm, padded with boxes that nothing fits."""
    distinct = sorted({p.boxes for p in printers})
    most = max(len(boxes) for boxes in distinct)
    return np.array([list(boxes) + [(-1.0, -1.0, -1.0)] * (most - len(boxes)) for boxes in distinct])


def all_boxes(grid: Grid, printers: list[PrinterRoom], cost: CostModel) -> Boxes:
    """Tables over all boxes of a grid; a box fits where it fits every one of the printers."""
    prefix = []
    for axis, cut in enumerate(grid.cuts):
        table = np.zeros([n + (a != axis) for a, n in enumerate(cut.shape)])
        a, b = (i for i in range(3) if i != axis)
        inner = tuple(slice(None) if i == axis else slice(1, None) for i in range(3))
        table[inner] = cut.cumsum(axis=a).cumsum(axis=b)
        prefix.append(table)
    seconds, trimmed, pieces = _all_boxes(
        grid.needed,
        grid.sums,
        grid.extents,
        prefix[0],
        prefix[1],
        prefix[2],
        shared_rooms(printers),
        cost.coefficients(),
    )
    full = np.isfinite(grid.extents[..., 0])
    nx, ny, nz = grid.shape
    open_x, open_y, open_z = (c > 0.0 for c in grid.cuts)
    _count_pieces(full, open_x[:nx], open_y[:, :ny], open_z[:, :, :nz], trimmed, seconds, pieces)
    return Boxes(grid.shape, seconds, trimmed, pieces)


def box_index(box: Box, shape: tuple[int, int, int]) -> int:
    """Index of a box in the tables of `Boxes`."""
    return int(_index(*box, *shape))


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

    def chosen(self) -> list[Box]:
        """The boxes of the last solution, in the order of the cuts."""
        found: list[Box] = []
        stack = [self._root]
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
            _ends(i, n) for i, n in zip((ix, iy, iz), self.boxes.shape, strict=True)
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
        return max(float(self.boxes.seconds[box_index(b, self.boxes.shape)]) for b in self.chosen())


def _ends(interval: int, n: int) -> tuple[int, int]:
    """The inverse of `_interval`."""
    length = 1
    while interval >= n - length + 1:
        interval -= n - length + 1
        length += 1
    return interval, interval + length
