"""Every axis-aligned box of a grid: what it costs, what of it is needed, how many pieces are in it.

There are some millions of them; a row, a layer and then a box are added up from the one before, so that each
box costs a few dozen additions.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Floats
from decompose.grid.box_index import Box, box_index, index_of
from decompose.grid.clipping import LATERAL, MOMENT, OVERHANG, SKIN, SLOPE, VOLUME
from decompose.grid.grid import Grid
from decompose.jit import jit
from decompose.print_time import CostModel, price
from decompose.printers import PrinterRoom


@dataclass(frozen=True, slots=True)
class BoxTables:
    """Every axis-aligned box of a grid. A box's index combines those of its intervals along x, y and z.

    Attributes
    ----------
    seconds
        (boxes,) print time in the best pose that fits; +inf where none fits or it was not worth computing.
    trimmed
        (boxes,) index of the box about its needed cells, -1 where it has none.
    pieces
        (boxes,) connected pieces of the solid in it, as far as the grid can tell.
    cut_mm2
        (boxes,) area of its cut faces, of boxes that may be printed; or (0,) where it does not matter.
    """

    shape: tuple[int, int, int]
    seconds: npt.NDArray[np.float32]
    trimmed: npt.NDArray[np.int32]
    pieces: npt.NDArray[np.int16]
    cut_mm2: npt.NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))

    def longest_s(self, found: Iterable[Box]) -> float:
        """The time of the costliest of some boxes, each trimmed."""
        return max(float(self.seconds[self.trimmed[box_index(box, self.shape)]]) for box in found)


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
    needed: Bools,
    sums: Floats,
    extents: Floats,
    cut_x: Floats,
    cut_y: Floats,
    cut_z: Floats,
    rooms: Floats,
    c: Floats,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32], npt.NDArray[np.int16], npt.NDArray[np.float32]]:
    """Cost, trimmed box, pieces and cut area of every box: a row, then a layer, then a box is added up.

    cut_*: prefix sums of the cut areas over the two axes of each plane.
    """
    nx, ny, nz = needed.shape
    total = nx * (nx + 1) // 2 * (ny * (ny + 1) // 2) * (nz * (nz + 1) // 2)
    seconds = np.full(total, np.inf, np.float32)
    trimmed = np.full(total, -1, np.int32)
    pieces = np.ones(total, np.int16)
    cut_mm2 = np.zeros(total, np.float32)
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
                            box = index_of(x0, y0, z0, x1, y1, z1, nx, ny, nz)
                            tight = index_of(
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
                                for over in range(2):  # as it is, and turned over
                                    pose = 2 * up + over
                                    column = s[MOMENT + pose] - s[OVERHANG + pose] * e[up]
                                    if over == 1:
                                        column = s[OVERHANG + pose] * e[up + 3] - s[MOMENT + pose]
                                    t = price(
                                        c,
                                        s[VOLUME],
                                        s[LATERAL + up] + cut - flat,
                                        s[SKIN + up] + flat,
                                        s[SLOPE + up],
                                        column,
                                        width,
                                        depth,
                                        height,
                                    )
                                    best = min(best, t)
                            seconds[box] = best
                            cut_mm2[box] = cut
    return seconds, trimmed, pieces, cut_mm2


@jit
def _count_pieces(
    full: Bools,
    open_x: Bools,
    open_y: Bools,
    open_z: Bools,
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
                            box = index_of(x0, y0, z0, x1, y1, z + 1, nx, ny, nz)
                            if trimmed[box] == box and seconds[box] < np.inf:
                                pieces[box] = max(1, k)


def room_array(printers: list[PrinterRoom]) -> Floats:
    """The distinct rooms as (rooms, boxes, 3) in mm, padded with boxes that nothing fits."""
    distinct = sorted({p.boxes for p in printers})
    most = max(len(boxes) for boxes in distinct)
    return np.array([list(boxes) + [(-1.0, -1.0, -1.0)] * (most - len(boxes)) for boxes in distinct])


def price_boxes(grid: Grid, printers: list[PrinterRoom], cost: CostModel) -> BoxTables:
    """Tables over all boxes of a grid; a box fits where it fits every one of the printers."""
    prefix = []
    for axis, cut in enumerate(grid.cuts):
        table = np.zeros([n + (a != axis) for a, n in enumerate(cut.shape)])
        a, b = (i for i in range(3) if i != axis)
        inner = tuple(slice(None) if i == axis else slice(1, None) for i in range(3))
        table[inner] = cut.cumsum(axis=a).cumsum(axis=b)
        prefix.append(table)
    seconds, trimmed, pieces, cut_mm2 = _all_boxes(
        grid.needed,
        grid.sums,
        grid.extents,
        prefix[0],
        prefix[1],
        prefix[2],
        room_array(printers),
        cost.coefficients(),
    )
    full = np.isfinite(grid.extents[..., 0])
    nx, ny, nz = grid.shape
    open_x, open_y, open_z = (c > 0.0 for c in grid.cuts)
    _count_pieces(full, open_x[:nx], open_y[:, :ny], open_z[:, :, :nz], trimmed, seconds, pieces)
    return BoxTables(grid.shape, seconds, trimmed, pieces, cut_mm2)
