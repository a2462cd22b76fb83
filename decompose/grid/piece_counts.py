"""Number of connected pieces of the solid in every box of a grid.

The pieces are counted from the bodies of each cell: the connected components of the solid in it. Bodies are
told apart on finer cells, and the solid in a finer cell counts as connected. So a count is never higher than
the true number of pieces, and is usually equal to it.
"""

from __future__ import annotations

from concurrent.futures import Executor
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Ints
from decompose.disjoint_sets import join_sets
from decompose.geometry import label_components
from decompose.grid.box_index import index_interval
from decompose.grid.threads import SHARE_COUNT, run_shares
from decompose.jit import jit


class CellBodies(NamedTuple):
    """Bodies of the solid in each cell of a grid, and their contacts across the sides of cells.

    Cells are numbered as in an array (nx, ny, nz).

    Attributes
    ----------
    first_body
        (cells + 1,) int64 number of the first body of each cell; the bodies of a cell have consecutive
        numbers.
    first_contact
        (3, cells + 1) int64 index of the first contact across the lower side of each cell, for each axis.
    contacts
        (3, m, 2) int64 bodies of each contact: the one in the cell, and the one in the previous cell along
        the axis.
    """

    first_body: Ints
    first_contact: Ints
    contacts: Ints


NO_BODIES = CellBodies(np.zeros(0, np.int64), np.zeros((3, 0), np.int64), np.zeros((3, 0, 2), np.int64))


def find_bodies(is_full: Bools, crosses_lower_side: tuple[Bools, Bools, Bools], divisions: int) -> CellBodies:
    """Find the bodies of cells by means of finer cells.

    Parameters
    ----------
    is_full
        (divisions * nx, divisions * ny, divisions * nz) bool, true for a fine cell with solid.
    crosses_lower_side
        Array of this shape for each axis, true if solid crosses the lower side of a fine cell.
    divisions
        Number of fine cells along each side of a cell; with 1, each cell with solid is one body.
    """
    nx, ny, nz = (n // divisions for n in is_full.shape)
    fine_cells = np.arange(is_full.size).reshape(is_full.shape)
    x, y, z = (np.arange(n) // divisions for n in is_full.shape)
    cell = ((x[:, None, None] * ny + y[None, :, None]) * nz + z).ravel()
    cell_pairs_by_axis = []
    for axis, crosses in enumerate(crosses_lower_side):
        upper_cells = np.take(fine_cells, range(1, is_full.shape[axis]), axis=axis)
        lower_cells = np.take(fine_cells, range(is_full.shape[axis] - 1), axis=axis)
        is_contact = np.take(crosses, range(1, is_full.shape[axis]), axis=axis)
        cell_pairs_by_axis.append(np.stack([upper_cells[is_contact], lower_cells[is_contact]], axis=1))
    inner_pairs = np.concatenate(
        [cell_pairs[cell[cell_pairs[:, 0]] == cell[cell_pairs[:, 1]]] for cell_pairs in cell_pairs_by_axis]
    )
    label = label_components(is_full.size, inner_pairs[:, 0], inner_pairs[:, 1])
    full_cells = np.flatnonzero(is_full)
    _, first_fine, body = np.unique(
        cell[full_cells] * is_full.size + label[full_cells], return_index=True, return_inverse=True
    )
    body_of_fine_cell = np.full(is_full.size, -1)
    body_of_fine_cell[full_cells] = body
    counts = np.bincount(cell[full_cells][first_fine], minlength=nx * ny * nz)
    cells = np.arange(nx * ny * nz + 1)
    contacts, first_contact = [], []
    for cell_pairs in cell_pairs_by_axis:
        outer_pairs = cell_pairs[
            (cell[cell_pairs[:, 0]] != cell[cell_pairs[:, 1]])
            & (body_of_fine_cell[cell_pairs] >= 0).all(axis=1)
        ]
        # The contacts are sorted by their first body, and thus by its cell.
        body_contacts = np.unique(body_of_fine_cell[outer_pairs], axis=0)
        contacts.append(body_contacts)
        first_contact.append(np.searchsorted(cell[full_cells][first_fine][body_contacts[:, 0]], cells))
    max_contact_count = max(len(body_pairs) for body_pairs in contacts)
    padded_contacts = np.array(
        [np.pad(body_pairs, ((0, max_contact_count - len(body_pairs)), (0, 0))) for body_pairs in contacts]
    )
    return CellBodies(np.concatenate([[0], np.cumsum(counts)]), np.array(first_contact), padded_contacts)


class _Order(NamedTuple):
    """Order of the axes in which boxes are visited: each box extends the previous one along the last axis.

    Attributes
    ----------
    axes
        Axes from the outermost loop to the innermost.
    sizes
        Number of cells of the grid along each of these axes.
    cell_strides, box_strides
        For each of these axes, the difference between the indices of two neighbouring cells in a flat array;
        and the difference between the indices, in the tables of boxes, of two boxes whose intervals along the
        axis have consecutive indices.
    """

    axes: tuple[int, int, int]
    sizes: tuple[int, int, int]
    cell_strides: tuple[int, int, int]
    box_strides: tuple[int, int, int]


@jit
def _find_highest_top(
    base: tuple[int, int],
    order: _Order,
    trimmed_box: npt.NDArray[np.int32],
    seconds: npt.NDArray[np.float32],
) -> int:
    """Find the top of the highest printable box over a base; return the bottom if there is none.

    Top and bottom are the ends of a box along the last axis.

    Parameters
    ----------
    base
        Contribution of the other two axes to the index of a box, and the bottom of the box.
    order
        Order of the axes.
    trimmed_box, seconds
        (boxes,) int32 and (boxes,) float32 of `BoxTables`.
    """
    row, bottom = base
    for top in range(order.sizes[2], bottom, -1):
        box = row + index_interval(bottom, top, order.sizes[2]) * order.box_strides[2]
        if trimmed_box[box] == box and seconds[box] < np.inf:
            return top
    return bottom


@jit
def _add_layer(
    base: tuple[int, int, int, int],
    bottom: int,
    layer: int,
    order: _Order,
    bodies: CellBodies,
    parent: npt.NDArray[np.int32],
) -> int:
    """Add a layer of cells to the union-find forest of a box; return the change in the number of pieces.

    Parameters
    ----------
    base
        First cell of the box, and the cell after the last one, along the first and the second axis.
    bottom, layer
        First layer of the box along the last axis, and the layer that is added.
    order
        Order of the axes.
    bodies
        Bodies of all cells.
    parent
        (bodies,) int32 forest of all bodies, updated in place.
    """
    a0, a1, b0, b1 = base
    first_body, first_contact, contacts = bodies
    change = 0
    for a in range(a0, a1):
        for b in range(b0, b1):
            cell = a * order.cell_strides[0] + b * order.cell_strides[1] + layer * order.cell_strides[2]
            for body in range(first_body[cell], first_body[cell + 1]):
                parent[body] = body
                change += 1
    for a in range(a0, a1):
        for b in range(b0, b1):
            cell = a * order.cell_strides[0] + b * order.cell_strides[1] + layer * order.cell_strides[2]
            for k in range(3):
                is_inside = a > a0 if k == 0 else b > b0 if k == 1 else layer > bottom
                if not is_inside:
                    continue
                axis = order.axes[k]
                for i in range(first_contact[axis, cell], first_contact[axis, cell + 1]):
                    change -= join_sets(parent, contacts[axis, i, 0], contacts[axis, i, 1])
    return change


@jit
def _count_share(
    order: _Order,
    bodies: CellBodies,
    trimmed_box: npt.NDArray[np.int32],
    seconds: npt.NDArray[np.float32],
    piece_counts: npt.NDArray[np.int16],
    share: int,
) -> None:
    """Count the pieces of the boxes in one share; boxes that cannot be printed are skipped.

    Parameters
    ----------
    order
        Order of the axes.
    bodies
        Bodies of all cells.
    trimmed_box, seconds
        (boxes,) int32 and (boxes,) float32 of `BoxTables`.
    piece_counts
        (boxes,) int16, filled in.
    share
        Number of the share: its boxes begin along the outermost axis at this cell, and at every
        `SHARE_COUNT`-th one after it.
    """
    na, nb, nc = order.sizes
    parent = np.zeros(bodies.first_body[-1], np.int32)
    for a0 in range(share, na, SHARE_COUNT):
        for a1 in range(a0 + 1, na + 1):
            for b0 in range(nb):
                for b1 in range(b0 + 1, nb + 1):
                    row = index_interval(a0, a1, na) * order.box_strides[0]
                    row += index_interval(b0, b1, nb) * order.box_strides[1]
                    for bottom in range(nc):
                        piece_count = 0
                        for layer in range(
                            bottom, _find_highest_top((row, bottom), order, trimmed_box, seconds)
                        ):
                            piece_count += _add_layer((a0, a1, b0, b1), bottom, layer, order, bodies, parent)
                            box = row + index_interval(bottom, layer + 1, nc) * order.box_strides[2]
                            if trimmed_box[box] == box and seconds[box] < np.inf:
                                piece_counts[box] = max(1, piece_count)


def count_pieces(
    shape: tuple[int, int, int],
    bodies: CellBodies,
    trimmed_box: npt.NDArray[np.int32],
    seconds: npt.NDArray[np.float32],
    piece_counts: npt.NDArray[np.int16],
    executor: Executor | None = None,
) -> None:
    """Count the pieces of every box that may be printed.

    The method is union-find by layers: each box extends the previous one by one layer of cells along the
    longest axis.

    Parameters
    ----------
    shape
        Number of cells of the grid along each axis.
    bodies
        Bodies of all cells.
    trimmed_box, seconds
        (boxes,) int32 and (boxes,) float32 of `BoxTables`.
    piece_counts
        (boxes,) int16, filled in.
    executor
        Threads that may treat half of the boxes while the current thread treats the others; None to treat all
        in the current thread.
    """
    _, ny, nz = shape
    y_interval_count, z_interval_count = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    a, b, c = sorted(range(3), key=lambda axis: shape[axis])
    cell_strides, box_strides = (ny * nz, nz, 1), (y_interval_count * z_interval_count, z_interval_count, 1)
    order = _Order(
        (a, b, c),
        (shape[a], shape[b], shape[c]),
        (cell_strides[a], cell_strides[b], cell_strides[c]),
        (box_strides[a], box_strides[b], box_strides[c]),
    )
    run_shares(executor, partial(_count_share, order, bodies, trimmed_box, seconds, piece_counts))
