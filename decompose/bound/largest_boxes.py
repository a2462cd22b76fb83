"""Largest boxes whose print time is within a limit: those that no larger box can replace in a covering."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decompose.arrays import Ints
from decompose.grid import Box, Shape, compute_index
from decompose.jit import jit

Tables = tuple[npt.NDArray[np.float32], npt.NDArray[np.int32], npt.NDArray[np.int16]]


@jit
def _is_replaceable(tables: Tables, limit_s: float, box: Box, shape: Shape) -> bool:
    """Check whether a box can be replaced by a box that is one layer larger.

    The larger box must be within the limit, and must not have more pieces.

    Parameters
    ----------
    tables, limit_s, shape
        As in `find_largest_boxes`.
    box
        Box in cells, half-open.
    """
    seconds, trimmed_box, piece_counts = tables
    index = compute_index(box, shape)
    is_replaceable = False
    for face in range(6):
        x0, y0, z0, x1, y1, z1 = box
        larger = index
        while larger == index:  # a layer without needed cells changes nothing
            x0, y0, z0 = x0 - (face == 0), y0 - (face == 1), z0 - (face == 2)
            x1, y1, z1 = x1 + (face == 3), y1 + (face == 4), z1 + (face == 5)
            if min(x0, y0, z0) < 0 or x1 > shape[0] or y1 > shape[1] or z1 > shape[2]:
                break
            larger = trimmed_box[compute_index((x0, y0, z0, x1, y1, z1), shape)]
        if larger != index and seconds[larger] <= limit_s:
            is_replaceable = is_replaceable or piece_counts[larger] <= piece_counts[index]
    return is_replaceable


@jit
def find_largest_boxes(
    tables: Tables, limit_s: float, shape: Shape, boxes: npt.NDArray[np.int16], indices: Ints
) -> int:
    """Find the boxes within a limit that no larger ones can replace; return the number of these boxes.

    Parameters
    ----------
    tables
        (boxes,) `seconds` float32, `trimmed_box` int32 and `piece_counts` int16 of `BoxTables`.
    limit_s
        Maximum print time of a box.
    shape
        Number of cells of the grid along each axis.
    boxes, indices
        (k, 6) int16 and (k,) int64, filled in with the boxes and their indices; k is at least the number of
        boxes within the limit.
    """
    seconds, trimmed_box, _ = tables
    nx, ny, nz = shape
    count = 0
    for x0 in range(nx):
        for x1 in range(x0 + 1, nx + 1):
            for y0 in range(ny):
                for y1 in range(y0 + 1, ny + 1):
                    for z0 in range(nz):
                        for z1 in range(z0 + 1, nz + 1):
                            box = compute_index((x0, y0, z0, x1, y1, z1), shape)
                            if not seconds[box] <= limit_s or trimmed_box[box] != box:
                                continue
                            if not _is_replaceable(tables, limit_s, (x0, y0, z0, x1, y1, z1), shape):
                                boxes[count, 0], boxes[count, 1], boxes[count, 2] = x0, y0, z0
                                boxes[count, 3], boxes[count, 4], boxes[count, 5] = x1, y1, z1
                                indices[count] = box
                                count += 1
    return count
