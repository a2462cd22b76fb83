"""Pinwheels of a window: four boxes around a fifth, a partition that guillotine cuts cannot make."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from decompose.engines.guillotine.recursion import UNREACHABLE_COUNT
from decompose.grid import Box, index_interval
from decompose.jit import jit

# Axis along which all five boxes are as long as the window, whether the pinwheel is mirrored, and positions
# of the cuts along the two other axes: p1 and p2 along the next axis, q1 and q2 along the one after it.
Pinwheel = tuple[int, int, int, int, int, int]


@jit
def find_smallest_pinwheel(
    counts: npt.NDArray[np.int16], wx: int, wy: int, wz: int
) -> tuple[int, int, int, int, int, int, int]:
    """Find the pinwheel that fills a window with the fewest parts.

    Parameters
    ----------
    counts
        (boxes,) int16 minimum number of parts of each box of the window, by the index of the box.
    wx, wy, wz
        Number of cells of the window along each axis.

    Returns
    -------
    tuple
        Number of parts, `UNREACHABLE_COUNT` if there is no pinwheel, and the six values of the `Pinwheel`.
    """
    sizes = (wx, wy, wz)
    strides = (wy * (wy + 1) // 2 * (wz * (wz + 1) // 2), wz * (wz + 1) // 2, 1)
    best = (UNREACHABLE_COUNT, 0, 0, 0, 0, 0, 0)
    for axis in range(3):
        p_axis, q_axis = (axis + 1) % 3, (axis + 2) % 3
        p, q = sizes[p_axis], sizes[q_axis]
        p_stride, q_stride = strides[p_axis], strides[q_axis]
        full_index = index_interval(0, sizes[axis], sizes[axis]) * strides[axis]
        for p1 in range(1, p - 1):
            for p2 in range(p1 + 1, p):
                for q1 in range(1, q - 1):
                    for q2 in range(q1 + 1, q):
                        before_q1 = index_interval(0, q1, q) * q_stride
                        before_q2 = index_interval(0, q2, q) * q_stride
                        after_q1 = index_interval(q1, q, q) * q_stride
                        after_q2 = index_interval(q2, q, q) * q_stride
                        middle = index_interval(p1, p2, p) * p_stride + index_interval(q1, q2, q) * q_stride
                        centre = np.int64(counts[full_index + middle])
                        count = centre + counts[full_index + index_interval(0, p2, p) * p_stride + before_q1]
                        count += counts[full_index + index_interval(p2, p, p) * p_stride + before_q2]
                        count += counts[full_index + index_interval(p1, p, p) * p_stride + after_q2]
                        count += counts[full_index + index_interval(0, p1, p) * p_stride + after_q1]
                        if count < best[0]:
                            best = (count, axis, 0, p1, p2, q1, q2)
                        count = centre + counts[full_index + index_interval(p1, p, p) * p_stride + before_q1]
                        count += counts[full_index + index_interval(0, p1, p) * p_stride + before_q2]
                        count += counts[full_index + index_interval(0, p2, p) * p_stride + after_q2]
                        count += counts[full_index + index_interval(p2, p, p) * p_stride + after_q1]
                        if count < best[0]:
                            best = (count, axis, 1, p1, p2, q1, q2)
    return best


def list_pinwheel_boxes(shape: tuple[int, int, int], pinwheel: Pinwheel) -> list[Box]:
    """List the five boxes of a pinwheel that fills a window; the last one is in the middle.

    Parameters
    ----------
    shape
        Shape of the window, in cells.
    pinwheel
        Axis, mirroring and positions of the cuts.
    """
    axis, is_mirrored, p1, p2, q1, q2 = pinwheel
    p, q = shape[(axis + 1) % 3], shape[(axis + 2) % 3]
    if is_mirrored:
        rectangles = [(p1, p, 0, q1), (0, p1, 0, q2), (0, p2, q2, q), (p2, p, q1, q), (p1, p2, q1, q2)]
    else:
        rectangles = [(0, p2, 0, q1), (p2, p, 0, q2), (p1, p, q2, q), (0, p1, q1, q), (p1, p2, q1, q2)]
    boxes = []
    for a, b, c, d in rectangles:
        lo, hi = [0, 0, 0], list(shape)
        lo[(axis + 1) % 3], hi[(axis + 1) % 3] = a, b
        lo[(axis + 2) % 3], hi[(axis + 2) % 3] = c, d
        boxes.append((lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]))
    return boxes
