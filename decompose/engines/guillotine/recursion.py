"""Kernels of `partitioner`: the recursion over all guillotine cuts of every box."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decompose.arrays import Ints
from decompose.grid import Shape, index_interval
from decompose.jit import jit

UNREACHABLE_COUNT = 16_000  # more than the printers of any fleet; twice this number fits into an int16
PART_WEIGHT = 1 << 46  # weight of a part in a key (`make_key`)
SECOND_WEIGHT = 1 << 20  # weight of a rounded second in a key; the lowest digit is the area of the cuts
AREA_UNIT_MM2 = 64.0  # unit of the area of cuts in a key
MAX_KEY_TIME_S = 1e6  # maximum print time of a box in a key, so that the digits do not overlap

Table = npt.NDArray[np.int16] | Ints | npt.NDArray[np.float32]


@jit
def _lower_values(value: Table, size: int, start: tuple[int, int, int], count: int, sums: Ints) -> None:
    """Reduce the values of consecutive boxes to the sums of the values of their two sides at a cut.

    A value that is not above its sum stays as it is.

    Parameters
    ----------
    value
        (states * size,) int16 counts, int64 keys or float32 print times, lowered in place. A state is a
        number of usable printers of each class but the first (see `partitioner`).
    size
        Number of boxes in each state.
    start
        First index of the boxes, of their lower sides and of their upper sides, in each state.
    count
        Number of boxes.
    sums
        (m, 3) int64 indices of a state, of the state of the lower side, and of the state of the upper side.
    """
    box_index, lower_index, upper_index = start
    for k in range(len(sums)):
        begin = sums[k, 0] * size + box_index
        least = value[begin : begin + count]
        begin = sums[k, 1] * size + lower_index
        lower = value[begin : begin + count]
        begin = sums[k, 2] * size + upper_index
        upper = value[begin : begin + count]
        for i in range(len(least)):  # in the table's type, so that the processor adds many values at once
            least[i] = min(value.dtype.type(lower[i] + upper[i]), least[i])


@jit
def lower_box_values(value: Table, sums: Ints, shape: Shape, length: int, first: int, end: int) -> None:
    """Lower the values of boxes of one length along x, in place, to the values of their best partitions.

    All shorter boxes must have been processed first; boxes of the same length do not depend on each other.
    Boxes of one length along an axis are adjacent in the tables, so the sums for boxes of one size are
    computed for all positions at once. A box that is larger than its needed cells needs no special case: cuts
    split off the empty regions, whose value is 0.

    Parameters
    ----------
    value
        (states * boxes,) int16 counts, int64 keys or float32 print times of the uncut boxes, state after
        state; lowered in place.
    sums
        (m, 3) int64 from `partitioner.list_class_states`.
    shape
        Shape of the grid, in cells.
    length
        Number of cells of the boxes along x.
    first, end
        Range of the cells at which the boxes begin along x, half-open.
    """
    nx, ny, nz = shape
    y_interval_count, z_interval_count = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    layer = y_interval_count * z_interval_count
    size = nx * (nx + 1) // 2 * layer
    state_count = len(value) // size
    transposed_value = np.empty(state_count * ny * z_interval_count, value.dtype)
    for x0 in range(first, end):
        start = index_interval(x0, x0 + length, nx) * layer
        for x in range(x0 + 1, x0 + length):
            a, b = index_interval(x0, x, nx) * layer, index_interval(x, x0 + length, nx) * layer
            _lower_values(value, size, (start, a, b), layer, sums)
        for dy in range(1, ny + 1):
            rows = ny - dy + 1
            block = rows * z_interval_count
            row = start + index_interval(0, dy, ny) * z_interval_count
            for cut in range(1, dy):
                a, b = (
                    start + index_interval(0, cut, ny) * z_interval_count,
                    start + index_interval(cut, dy, ny) * z_interval_count,
                )
                _lower_values(value, size, (row, a, b), block, sums)
            for state in range(state_count):
                source, target = state * size + row, state * block
                _transpose_table(
                    value[source : source + block],
                    transposed_value[target : target + block],
                    rows,
                    z_interval_count,
                )
            _lower_along_z(transposed_value, sums, nz, rows)
            for state in range(state_count):
                source, target = state * block, state * size + row
                _transpose_table(
                    transposed_value[source : source + block],
                    value[target : target + block],
                    z_interval_count,
                    rows,
                )


@jit
def _lower_along_z(value: Table, sums: Ints, nz: int, rows: int) -> None:
    """Lower the values of boxes in place to the least sums of both sides, over cuts perpendicular to z.

    All boxes have one length along x, and one length along y.

    Parameters
    ----------
    value
        (states * boxes,) int16 counts or int64 keys, state after state, in a transposed table in which boxes
        of one length along z are adjacent.
    sums
        As in `lower_box_values`.
    nz
        Number of cells of the grid along z.
    rows
        Number of positions of the boxes along y.
    """
    size = nz * (nz + 1) // 2 * rows
    for dz in range(2, nz + 1):
        start = index_interval(0, dz, nz) * rows
        for cut in range(1, dz):
            a, b = index_interval(0, cut, nz) * rows, index_interval(cut, dz, nz) * rows
            _lower_values(value, size, (start, a, b), (nz - dz + 1) * rows, sums)


@jit
def _transpose_table(rows: Table, columns: Table, m: int, n: int) -> None:
    """Transpose a table into another one.

    Parameters
    ----------
    rows
        (m * n,) int16 or int64, row after row.
    columns
        (n * m,) of the same type, filled in column after column.
    m, n
        Number of rows and of columns.
    """
    for i in range(m):
        for k in range(n):
            columns[k * m + i] = rows[i * n + k]


@jit
def fill_counts(
    limit_s: float,
    seconds: npt.NDArray[np.float32],
    trimmed_box: npt.NDArray[np.int32],
    piece_counts: npt.NDArray[np.int16],
    value: npt.NDArray[np.int16],
) -> None:
    """Fill in the number of parts of each uncut box.

    Parameters
    ----------
    limit_s
        Maximum print time of a part; a box that takes longer gets `UNREACHABLE_COUNT`.
    seconds, trimmed_box, piece_counts
        (boxes,) float32 in s, (boxes,) int32 and (boxes,) int16 tables of `BoxTables`.
    value
        (boxes,) int16, filled in.
    """
    for box in range(len(value)):
        if trimmed_box[box] < 0:
            value[box] = 0
        else:
            value[box] = piece_counts[box] if seconds[box] <= limit_s else UNREACHABLE_COUNT


@jit
def make_key(seconds: float, piece_count: int, cut_mm2: float) -> int:
    """Make the key of an uncut box: its parts, seconds and area of cuts as digits of one number.

    Parameters
    ----------
    seconds
        Time of the box.
    piece_count
        Number of its pieces.
    cut_mm2
        Area of its cut faces.
    """
    key: int = (
        piece_count * PART_WEIGHT
        + round(min(seconds, MAX_KEY_TIME_S)) * SECOND_WEIGHT
        + round(cut_mm2 / AREA_UNIT_MM2)
    )
    return key


@jit
def fill_keys(
    limit_s: float,
    seconds: npt.NDArray[np.float32],
    trimmed_box: npt.NDArray[np.int32],
    piece_counts: npt.NDArray[np.int16],
    cut_mm2: npt.NDArray[np.float32],
    value: Ints,
) -> None:
    """Fill in the key of each uncut box.

    Parameters
    ----------
    limit_s
        Maximum print time of a part; a box that takes longer gets the key of `UNREACHABLE_COUNT` parts.
    seconds, trimmed_box, piece_counts
        (boxes,) float32 in s, (boxes,) int32 and (boxes,) int16 tables of `BoxTables`.
    cut_mm2
        (boxes,) float32 in mm2 of `BoxTables`; (0,) to ignore the area.
    value
        (boxes,) int64, filled in.
    """
    for box in range(len(value)):
        if trimmed_box[box] < 0:
            value[box] = 0
        elif seconds[box] <= limit_s:
            value[box] = make_key(seconds[box], piece_counts[box], cut_mm2[box] if len(cut_mm2) else 0.0)
        else:
            value[box] = UNREACHABLE_COUNT * PART_WEIGHT
