"""Block growth: seed blocks of cells grow, a layer at a time, until they cover all that they can.

The cheapest block that can grow grows next, in the direction whose score is best: ``|P + O|`` of the grown
block and its nearness to other blocks. The paper calls higher scores better (section "Objective"), although
P and O are costs: `Score` has both readings. What no block may do (leave the grid, not fit its printer, grow
by nothing, take a cell that has an owner, fall into more pieces) forbids a direction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from decompose.boxes import Box, BoxTables, index_of
from decompose.grid import OVERHANG, VOLUME, Grid
from decompose.jit import jit

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

SPEED_MM_S = 20.0  # of shell and of infill, in the paper's settings
OVERHANG_TOLERANCE_DEG = 1.0  # likewise
NOBODY, BARRED = -1, -2


class Score(StrEnum):
    """Which score of a direction is the best."""

    LOW = "low"  # costs are costs
    HIGH = "high"  # as the paper's text has it
    BOTH = "both"  # attempts with each

    @property
    def readings(self) -> tuple[Score, ...]:
        """The readings to be tried, of which each is low or high."""
        return (Score.LOW, Score.HIGH) if self is Score.BOTH else (self,)


@dataclass(frozen=True, slots=True)
class Terrain:
    """What blocks grow on.

    Attributes
    ----------
    needed
        (nx, ny, nz) cells that must be covered.
    barred
        (nx, ny, nz) cells that no block may take: those of the other half, where the model was cut in two.
    seconds
        (boxes,) of `Boxes`: +inf where a box does not fit.
    pieces
        (boxes,) of `Boxes`.
    printing
        (boxes,) P, the price of printing a box that ends at needed cells on all sides.
    overhang
        (boxes,) O, the least overhang of its six poses, in units of P.
    """

    needed: Bools
    barred: Bools
    seconds: npt.NDArray[np.float32]
    pieces: npt.NDArray[np.int16]
    printing: npt.NDArray[np.float32]
    overhang: npt.NDArray[np.float32]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of the grid, in cells."""
        nx, ny, nz = self.needed.shape
        return nx, ny, nz

    def half(self, axis: int, plane: int, upper: bool) -> Terrain:
        """Only what lies on one side of a plane of the grid."""
        other = np.zeros(self.needed.shape, dtype=np.bool_)
        side = slice(None, plane) if upper else slice(plane, None)
        other[tuple(side if a == axis else slice(None) for a in range(3))] = True
        return replace(self, needed=self.needed & ~other, barred=self.barred | other)


def time_terrain(grid: Grid, boxes: BoxTables) -> Terrain:
    """P is the print time in the best pose that fits, with its supports, so that O is nothing."""
    none = np.zeros(len(boxes.seconds), np.float32)
    return Terrain(grid.needed, np.zeros_like(grid.needed), boxes.seconds, boxes.pieces, boxes.seconds, none)


def paper_terrain(grid: Grid, boxes: BoxTables) -> Terrain:
    """P is speed times volume plus speed times area, O the least overhanging area.

    Parameters
    ----------
    grid
        Whose overhangs count: of the paper's tolerance where it was laid with that.
    """
    columns = np.concatenate(
        [grid.sums[..., [VOLUME]], grid.area[..., None], grid.sums[..., OVERHANG : OVERHANG + 6]], axis=3
    )
    prefix = np.zeros([n + 1 for n in grid.shape] + [columns.shape[3]])
    prefix[1:, 1:, 1:] = columns.cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
    faces = []
    for axis, cut in enumerate(grid.cuts):
        a, b = (i for i in range(3) if i != axis)
        table = np.zeros([n + (i != axis) for i, n in enumerate(cut.shape)])
        table[tuple(slice(None) if i == axis else slice(1, None) for i in range(3))] = cut.cumsum(a).cumsum(b)
        faces.append(table)
    printing, overhang = _paper_prices(prefix, faces[0], faces[1], faces[2], len(boxes.seconds), SPEED_MM_S)
    free = np.zeros_like(grid.needed)
    return Terrain(grid.needed, free, boxes.seconds, boxes.pieces, printing, overhang)


@jit
def _paper_prices(
    prefix: Floats, cut_x: Floats, cut_y: Floats, cut_z: Floats, total: int, speed: float
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    nx, ny, nz = prefix.shape[0] - 1, prefix.shape[1] - 1, prefix.shape[2] - 1
    printing = np.zeros(total, np.float32)
    overhang = np.zeros(total, np.float32)
    for x0 in range(nx):
        for x1 in range(x0 + 1, nx + 1):
            for y0 in range(ny):
                for y1 in range(y0 + 1, ny + 1):
                    for z0 in range(nz):
                        for z1 in range(z0 + 1, nz + 1):
                            s = prefix[x1, y1, z1] - prefix[x0, y1, z1] - prefix[x1, y0, z1]
                            s = s - prefix[x1, y1, z0] + prefix[x0, y0, z1] + prefix[x0, y1, z0]
                            s = s + prefix[x1, y0, z0] - prefix[x0, y0, z0]
                            area = s[1]
                            for end in range(2):
                                x, y, z = (x0, y0, z0) if end == 0 else (x1, y1, z1)
                                area += cut_x[x, y1, z1] - cut_x[x, y0, z1] - cut_x[x, y1, z0]
                                area += cut_x[x, y0, z0]
                                area += cut_y[x1, y, z1] - cut_y[x0, y, z1] - cut_y[x1, y, z0]
                                area += cut_y[x0, y, z0]
                                area += cut_z[x1, y1, z] - cut_z[x0, y1, z] - cut_z[x1, y0, z]
                                area += cut_z[x0, y0, z]
                            box = index_of(x0, y0, z0, x1, y1, z1, nx, ny, nz)
                            printing[box] = speed * (s[0] + area)
                            overhang[box] = s[2:8].min()
    return printing, overhang


@jit
def grown_box_index(
    block: Ints,
    direction: int,
    owner: Ints,
    needed: Bools,
    seconds: npt.NDArray[np.float32],
    pieces: npt.NDArray[np.int16],
) -> int:
    """The index of the box that a block grows to, -1 where a hard constraint forbids it.

    Parameters
    ----------
    block
        (6,) x0, y0, z0, x1, y1, z1 in cells, half-open.
    direction
        0 to 5: -x, -y, -z, +x, +y, +z.
    owner
        (nx, ny, nz) the block that has a cell, `NOBODY` or `BARRED`.
    """
    nx, ny, nz = owner.shape
    axis = direction % 3
    grown = block.copy()
    layer = block.copy()
    if direction < 3:
        grown[axis] -= 1
        layer[axis], layer[axis + 3] = grown[axis], block[axis]
    else:
        grown[direction] += 1
        layer[axis], layer[axis + 3] = block[direction], grown[direction]
    if grown[axis] < 0 or grown[axis + 3] > owner.shape[axis]:
        return -1
    worth = False
    for x in range(layer[0], layer[3]):
        for y in range(layer[1], layer[4]):
            for z in range(layer[2], layer[5]):
                if owner[x, y, z] != -1:
                    return -1
                worth = worth or needed[x, y, z]
    if not worth:
        return -1
    box = index_of(grown[0], grown[1], grown[2], grown[3], grown[4], grown[5], nx, ny, nz)
    now = index_of(block[0], block[1], block[2], block[3], block[4], block[5], nx, ny, nz)
    if not np.isfinite(seconds[box]) or pieces[box] > pieces[now]:
        return -1
    return box


@jit
def claim_cells(block: Ints, number: int, owner: Ints) -> None:
    """Make a block the owner of all its cells."""
    owner[block[0] : block[3], block[1] : block[4], block[2] : block[5]] = number


@jit
def _proximity(blocks: Ints, number: int, direction: int, cells: int) -> float:
    """S_prox: 0.5 where another block ahead touches, 1 where none is within the length of the grid.

    The gap is the L1 distance of the centres less half the sizes, as in the paper; its share of the grid and
    the half are those of the paper's program, without which a touching block would bar every growth.
    """
    axis = direction % 3
    nearest = 1.0
    for other in range(len(blocks)):
        ahead = (
            blocks[other, axis] + blocks[other, axis + 3] - blocks[number, axis] - blocks[number, axis + 3]
        )
        if other == number or (ahead <= 0 if direction >= 3 else ahead >= 0):
            continue
        gap = 0.0
        for k in range(3):
            a0, a1, b0, b1 = blocks[number, k], blocks[number, k + 3], blocks[other, k], blocks[other, k + 3]
            gap += abs(a0 + a1 - b0 - b1) / 2.0 - (a1 - a0 + b1 - b0) / 2.0
        nearest = min(nearest, 0.5 + 0.5 * max(0.0, gap) / cells)
    return nearest


@jit
def _grow(
    blocks: Ints,
    owner: Ints,
    needed: Bools,
    seconds: npt.NDArray[np.float32],
    pieces: npt.NDArray[np.int16],
    printing: npt.NDArray[np.float32],
    overhang: npt.NDArray[np.float32],
    high: bool,
) -> None:
    nx, ny, nz = owner.shape
    cost = np.zeros(len(blocks))
    for i in range(len(blocks)):
        b = blocks[i]
        claim_cells(b, i, owner)
        cost[i] = printing[index_of(b[0], b[1], b[2], b[3], b[4], b[5], nx, ny, nz)]
    while len(blocks):
        cheapest = int(np.argmin(cost))
        if cost[cheapest] == np.inf:
            return
        chosen, best, price = -1, 0.0, 0.0
        for direction in range(6):
            box = grown_box_index(blocks[cheapest], direction, owner, needed, seconds, pieces)
            if box < 0:
                continue
            score = abs(printing[box] + overhang[box])
            near = _proximity(blocks, cheapest, direction, nx + ny + nz)
            score = score * near if high else -score / near
            if chosen < 0 or score > best:
                chosen, best, price = direction, score, float(printing[box])
        if chosen < 0:  # and it never will: owners only grow
            cost[cheapest] = np.inf
            continue
        blocks[cheapest, chosen] += 1 if chosen >= 3 else -1
        claim_cells(blocks[cheapest], cheapest, owner)
        cost[cheapest] = price


def grow_blocks(seeds: list[Box], terrain: Terrain, score: Score) -> tuple[Ints, Ints]:
    """Grow blocks from seeds, which are single cells, no two the same.

    Returns
    -------
    blocks, owner
        (k, 6) in cells, half-open, and (nx, ny, nz): the block that has a cell, `NOBODY` or `BARRED`.
    """
    blocks = np.array(seeds, dtype=np.int64).reshape(-1, 6)
    owner = np.where(terrain.barred, BARRED, NOBODY).astype(np.int64)
    tables = (terrain.seconds, terrain.pieces, terrain.printing, terrain.overhang)
    _grow(blocks, owner, terrain.needed, *tables, score is Score.HIGH)
    return blocks, owner
