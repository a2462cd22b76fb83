"""Heights of the printed lines, and whether the head can move over them."""

from __future__ import annotations

from array import array

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from slicing.printer import HeadShape

_CELL_MM = 1.0
_GRID_START_MM = -20.0  # where the grid begins, in X and Y
_CELL_COUNT = 270
_STEP_MM = 0.5  # distance between two samples of a line
_BUFFER_SIZE = 512 * 6

Point = list[float]


class Clearance:
    """Heights of the printed lines, on a grid of 1 mm, in the printer's coordinates.

    Lines are buffered: a print that only rises never needs the grid.

    Parameters
    ----------
    slack_mm
        Depth below printed lines that the nozzle may reach: slicers go up and down within a layer.
    head
        The printer's head.
    """

    def __init__(self, slack_mm: float, head: HeadShape) -> None:
        self._head = head
        self._slack_mm = slack_mm
        self._lines = array("d")  # x, y, z of both ends
        self._height_mm = np.zeros((_CELL_COUNT, _CELL_COUNT))  # [y, x]
        self._nozzle_heights_mm: NDArray[np.float64] | None = None  # maximum over the neighbouring cells
        self._head_heights_mm: NDArray[np.float64] | None = None  # maximum below the head
        self._max_new_height_mm = 0.0  # of the lines since both were computed

    def add_line(self, start: Point, target: Point) -> None:
        """Record a printed line."""
        self._lines.extend(start)
        self._lines.extend(target)
        self._max_new_height_mm = max(self._max_new_height_mm, start[2], target[2])
        if len(self._lines) >= _BUFFER_SIZE:
            self._flush()

    def find_obstacle_height_mm(self, start: Point, target: Point) -> float | None:
        """Find the height of the lines that the nozzle or the head would hit in a straight move, if any."""
        lowest_mm = min(start[2], target[2])
        if self._nozzle_heights_mm is None or self._max_new_height_mm > lowest_mm + self._slack_mm:
            self._flush()
            self._nozzle_heights_mm = ndimage.maximum_filter(self._height_mm, 3)
            self._head_heights_mm = _find_max_heights_below_head(self._height_mm, self._head)
            self._max_new_height_mm = 0.0
        assert self._head_heights_mm is not None
        xy, z = _sample_lines(np.array([[*start, *target]]))
        y, x = _find_cells(xy)
        nozzle_mm, head_mm = self._nozzle_heights_mm[y, x], self._head_heights_mm[y, x]
        is_hit = (nozzle_mm > z + self._slack_mm) | (head_mm > z + self._head.underside_mm + self._slack_mm)
        return float(np.maximum(nozzle_mm, head_mm)[is_hit].max()) if is_hit.any() else None

    def _flush(self) -> None:
        """Move the buffered lines to the grid."""
        if not self._lines:
            return
        xy, z = _sample_lines(np.frombuffer(self._lines, dtype=np.float64).reshape(-1, 6))
        y, x = _find_cells(xy)
        np.maximum.at(self._height_mm, (y, x), z)
        self._lines = array("d")


def _sample_lines(lines: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sample points on lines (n, 6), no further apart than a step: XY (m, 2) and Z (m,), in mm."""
    start, end = lines[:, :3], lines[:, 3:]
    counts = np.ceil(np.linalg.norm(end - start, axis=1) / _STEP_MM).astype(np.intp) + 1
    first = np.repeat(np.cumsum(counts) - counts, counts)
    share = (np.arange(counts.sum()) - first) / np.repeat(np.maximum(counts - 1, 1), counts)
    points = np.repeat(start, counts, axis=0) + share[:, None] * np.repeat(end - start, counts, axis=0)
    return points[:, :2], points[:, 2]


def _find_cells(xy: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find the row and the column of each point, clipped to the grid, beyond which no printer reaches."""
    cells = np.clip((xy - _GRID_START_MM) / _CELL_MM, 0, _CELL_COUNT - 1).astype(np.intp)
    return cells[:, 1], cells[:, 0]


def _find_max_heights_below_head(height_mm: NDArray[np.float64], head: HeadShape) -> NDArray[np.float64]:
    """Find the greatest height within the head's outline for each position of the nozzle."""
    left, right, front, back = (
        round(edge / _CELL_MM) for edge in (head.left_mm, head.right_mm, head.front_mm, head.back_mm)
    )
    size = (back - front + 1, right - left + 1)
    # The filter's window starts at -(size // 2) - origin, which has to be the head's front and left.
    origin = (-(size[0] // 2) - front, -(size[1] // 2) - left)
    highest: NDArray[np.float64] = ndimage.maximum_filter(
        height_mm, size, origin=origin, mode="constant", cval=0.0
    )
    return highest
