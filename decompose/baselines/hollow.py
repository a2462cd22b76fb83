"""A model hollowed on a grid, and the largest cube in the hollow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decompose.grid import Cell, Grid
from decompose.piece import box_planes
from decompose.solid import Solid

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Block = tuple[int, int, int, int, int, int]  # x0, y0, z0, x1, y1, z1 in cells, half-open


@dataclass(frozen=True, slots=True, eq=False)
class Shell:
    """What is left of a model.

    Attributes
    ----------
    cavity
        (nx, ny, nz) the cells that were taken out.
    planes
        (k, 4) rows nx, ny, nz, d: those of the walls of the hollow.
    boxes_mm
        (b, 2, 3) boxes about all that is left; none where nothing was taken out.
    """

    solid: Solid
    cavity: Bools
    planes: Floats
    boxes_mm: Floats


def hollow(solid: Solid, grid: Grid) -> Shell:
    """Take out the cells that are not needed: those that keep the least wall from the surface."""
    cavity = without_diagonals((grid.cells == Cell.INTERNAL) & ~grid.needed)
    if not cavity.any():
        return Shell(solid, cavity, np.zeros((0, 4)), np.zeros((0, 2, 3)))
    holes = [np.array(grid.bounds_mm(block)) for block in blocks(cavity)]
    left = np.array([grid.bounds_mm(block) for block in blocks(~cavity)])
    shell = solid.subtract(Solid.union([Solid.box(*hole) for hole in holes]))
    planes = np.unique(np.concatenate([box_planes(hole) for hole in holes]), axis=0)
    return Shell(shell, cavity, planes, left)


def without_diagonals(cells: Bools) -> Bools:
    """Less cells that meet others along an edge alone, where the surface of the rest would touch itself."""
    cells = cells.copy()
    while True:
        before = int(cells.sum())
        for a, b in ((0, 1), (0, 2), (1, 2)):
            view = np.moveaxis(cells, (a, b), (0, 1))
            near, far = view[:-1, :-1], view[1:, 1:]
            left, right = view[1:, :-1], view[:-1, 1:]
            near &= ~(near & far & ~left & ~right)
            left &= ~(left & right & ~near & ~far)
        if int(cells.sum()) == before:
            return cells


def blocks(cells: Bools) -> list[Block]:
    """Disjoint boxes that cover just these cells: each grows along z, then y, then x as far as it can."""
    free = cells.copy()
    found: list[Block] = []
    for x, y, z in np.argwhere(cells).tolist():
        if not free[x, y, z]:
            continue
        x1, y1, z1 = x + 1, y + 1, z + 1
        while z1 < free.shape[2] and free[x, y, z1]:
            z1 += 1
        while y1 < free.shape[1] and free[x, y1, z:z1].all():
            y1 += 1
        while x1 < free.shape[0] and free[x1, y:y1, z:z1].all():
            x1 += 1
        free[x:x1, y:y1, z:z1] = False
        found.append((x, y, z, x1, y1, z1))
    return found


def largest_cube(cells: Bools) -> Block | None:
    """The largest cube of these cells, the one nearest to their middle; None where there are no cells."""
    if not cells.any():
        return None
    edge = np.zeros([n + 1 for n in cells.shape], dtype=np.int64)  # of the largest cube that ends at a cell
    for x, y, z in np.argwhere(cells).tolist():
        before = edge[x : x + 2, y : y + 2, z : z + 2].ravel()[:7]
        edge[x + 1, y + 1, z + 1] = 1 + before.min()
    ends = np.argwhere(edge == edge.max())
    size = int(edge.max())
    middle = np.argwhere(cells).mean(axis=0) + 0.5
    away = np.round(np.linalg.norm(ends - size / 2.0 - middle, axis=1), 6)
    x, y, z = ends[int(np.argmin(away))].tolist()
    return x - size, y - size, z - size, x, y, z


def cubes_about(cube: Block, cells: Bools) -> list[Block]:
    """From the middle of each face of a cube outwards the largest cube of these cells, not larger than it."""
    edge = cube[3] - cube[0]
    found: list[Block] = []
    for axis in range(3):
        for outward in (False, True):
            for size in range(edge, 0, -1):
                lo = [cube[a] + (edge - size) // 2 for a in range(3)]
                lo[axis] = cube[axis + 3] if outward else cube[axis] - size
                hi = [v + size for v in lo]
                inside = min(lo) >= 0 and all(h <= n for h, n in zip(hi, cells.shape, strict=True))
                if inside and cells[lo[0] : hi[0], lo[1] : hi[1], lo[2] : hi[2]].all():
                    found.append((lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]))
                    break
    return found
