"""Number of connected pieces of the solid in every box of a grid, by the bodies of the solid in each cell.

The bodies of a cell are told apart on finer cells, each of which counts as connected. So a count is never
more than that of the solid cut out, and mostly equal to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Ints
from decompose.geometry.shells import label_components
from decompose.grid.box_index import index_of
from decompose.jit import jit


class CellBodies(NamedTuple):
    """Bodies of the solid in each cell of a grid, and their contacts across the sides of cells.

    Cells are counted as in an array (nx, ny, nz).

    Attributes
    ----------
    first
        (cells + 1,) number of the first body of each cell; those of a cell follow each other.
    first_link
        (3, cells + 1) for each axis, index of the first contact across the near side of each cell.
    links
        (3, m, 2) bodies of each contact: that of the cell, and that of the cell before it along the axis.
    """

    first: Ints
    first_link: Ints
    links: Ints


def find_bodies(full: Bools, opened: tuple[Bools, Bools, Bools], times: int) -> CellBodies:
    """Find the bodies of cells by finer cells, `times` of them along each side of a cell.

    Parameters
    ----------
    full
        (times nx, times ny, times nz) whether a fine cell has solid.
    opened
        For each axis, of the same shape, whether solid crosses the near side of a fine cell.
    times
        1: each cell with solid is one body.
    """
    nx, ny, nz = (n // times for n in full.shape)
    fine = np.arange(full.size).reshape(full.shape)
    x, y, z = (np.arange(n) // times for n in full.shape)
    cell = ((x[:, None, None] * ny + y[None, :, None]) * nz + z).ravel()
    pairs = []
    for axis, crossed in enumerate(opened):
        far = np.take(fine, range(1, full.shape[axis]), axis=axis)
        near = np.take(fine, range(full.shape[axis] - 1), axis=axis)
        is_open = np.take(crossed, range(1, full.shape[axis]), axis=axis)
        pairs.append(np.stack([far[is_open], near[is_open]], axis=1))
    inner = np.concatenate([each[cell[each[:, 0]] == cell[each[:, 1]]] for each in pairs])
    label = label_components(full.size, inner[:, 0], inner[:, 1])
    filled = np.flatnonzero(full)
    _, first_fine, body = np.unique(
        cell[filled] * full.size + label[filled], return_index=True, return_inverse=True
    )
    of_fine = np.full(full.size, -1)
    of_fine[filled] = body
    counts = np.bincount(cell[filled][first_fine], minlength=nx * ny * nz)
    cells = np.arange(nx * ny * nz + 1)
    links, first_link = [], []
    for each in pairs:
        outer = each[(cell[each[:, 0]] != cell[each[:, 1]]) & (of_fine[each] >= 0).all(axis=1)]
        linked = np.unique(of_fine[outer], axis=0)  # by the first body, so by its cell
        links.append(linked)
        first_link.append(np.searchsorted(cell[filled][first_fine][linked[:, 0]], cells))
    most = max(len(each) for each in links)
    padded = np.array([np.pad(each, ((0, most - len(each)), (0, 0))) for each in links])
    return CellBodies(np.concatenate([[0], np.cumsum(counts)]), np.array(first_link), padded)


@jit
def _join_groups(parent: npt.NDArray[np.int32], a: int, b: int) -> int:
    """Join the groups of two bodies in a forest of parents (bodies,); 1 if they were two, else 0."""
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    while parent[b] != b:
        parent[b] = parent[parent[b]]
        b = parent[b]
    if a == b:
        return 0
    if a < b:
        parent[b] = a
    else:
        parent[a] = b
    return 1


@jit
def count_pieces(
    shape: tuple[int, int, int],
    bodies: CellBodies,
    trimmed: npt.NDArray[np.int32],
    seconds: npt.NDArray[np.float32],
    pieces: npt.NDArray[np.int16],
) -> None:
    """Count the pieces of every box that may be printed.

    Union-find by layers: each box extends the one below it by one layer of cells.

    Parameters
    ----------
    shape
        Cells of the grid along each axis.
    bodies
        Bodies of its cells.
    trimmed, seconds
        Of `BoxTables`.
    pieces
        (boxes,) filled in.
    """
    nx, ny, nz = shape
    first, first_link, links = bodies
    parent = np.zeros(first[-1], np.int32)
    for x0 in range(nx):
        for x1 in range(x0 + 1, nx + 1):
            for y0 in range(ny):
                for y1 in range(y0 + 1, ny + 1):
                    for z0 in range(nz):
                        k = 0
                        for z in range(z0, nz):
                            for x in range(x0, x1):
                                for y in range(y0, y1):
                                    cell = (x * ny + y) * nz + z
                                    for body in range(first[cell], first[cell + 1]):
                                        parent[body] = body
                                        k += 1
                                    for axis in range(3):
                                        inside = x > x0 if axis == 0 else y > y0 if axis == 1 else z > z0
                                        if not inside:
                                            continue
                                        for i in range(first_link[axis, cell], first_link[axis, cell + 1]):
                                            k -= _join_groups(parent, links[axis, i, 0], links[axis, i, 1])
                            box = index_of((x0, y0, z0, x1, y1, z + 1), shape)
                            if trimmed[box] == box and seconds[box] < np.inf:
                                pieces[box] = max(1, k)
