"""Shadows of parts along an axis: where a part begins and ends on each line of a grid parallel to the axis.

A part that is moved along an axis without limit collides with another part if, on some line parallel to the
axis, the other part has material ahead of it. The ends of both parts on all lines are enough to decide this.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats
from decompose.geometry import Solid
from decompose.jit import jit

LINE_SPACING_MM = 0.6  # distance between lines: less than the thickness of two printed walls
LINE_OFFSET_MM = 0.2137  # offset of the lines from round coordinates, at which many parts end
MAX_TOUCH_OVERLAP_MM = 0.05  # maximum overlap of parts that only touch


@dataclass(frozen=True, slots=True, eq=False)
class Shadow:
    """Least and greatest coordinate of a part on each line of the grid near it; these are its ends.

    Attributes
    ----------
    first_lines
        Numbers of the first lines along each of the two axes perpendicular to the lines.
    low_mm, high_mm
        (lines, lines) float64 least and greatest coordinate along the axis in mm; inf and -inf for a line
        that misses the part.
    """

    first_lines: tuple[int, int]
    low_mm: Floats
    high_mm: Floats

    def blocks(self, other: Shadow) -> tuple[bool, bool]:
        """Check whether this part blocks another one that moves along the axis: forwards, and backwards."""
        start = np.maximum(self.first_lines, other.first_lines)
        end = np.minimum(
            np.add(self.first_lines, self.low_mm.shape), np.add(other.first_lines, other.low_mm.shape)
        )
        if (start >= end).any():
            return False, False
        own_lines, other_lines = (
            tuple(slice(a - f, b - f) for a, b, f in zip(start, end, shadow.first_lines, strict=True))
            for shadow in (self, other)
        )
        blocks_forwards = other.low_mm[other_lines] < self.high_mm[own_lines] - MAX_TOUCH_OVERLAP_MM
        blocks_backwards = other.high_mm[other_lines] > self.low_mm[own_lines] + MAX_TOUCH_OVERLAP_MM
        return bool(blocks_forwards.any()), bool(blocks_backwards.any())


def cast_shadow(solid: Solid, frame: Floats) -> Shadow:
    """Find the ends of a solid on lines along the first axis of a frame.

    Parameters
    ----------
    solid
        Solid of a part, in mm.
    frame
        (3, 3) unit vectors as rows: the axis, and two vectors perpendicular to it.
    """
    vertices, faces = solid.arrays()
    rotated_mm = vertices @ frame.T
    cells = (rotated_mm[:, 1:] - LINE_OFFSET_MM) / LINE_SPACING_MM
    first, last = np.floor(cells.min(axis=0)).astype(np.int64), np.ceil(cells.max(axis=0)).astype(np.int64)
    low_mm = np.full(tuple(last - first + 1), np.inf)
    high_mm = np.full(low_mm.shape, -np.inf)
    points = np.column_stack([cells - first, rotated_mm[:, 0]])
    _extend_ends(points[faces], low_mm, high_mm)
    return Shadow((int(first[0]), int(first[1])), low_mm, high_mm)


@jit
def _extend_ends(triangles: Floats, low_mm: Floats, high_mm: Floats) -> None:
    """Extend the ends of a part on all lines so that they include some triangles of the part.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 corners: two line numbers, and the coordinate along the axis in mm.
    low_mm, high_mm
        (lines, lines) float64 least and greatest coordinate in mm, updated in place.
    """
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        doubled_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if doubled_area == 0.0:  # parallel to the axis
            continue
        for i in range(int(np.ceil(min(a[0], b[0], c[0]))), int(max(a[0], b[0], c[0])) + 1):
            for j in range(int(np.ceil(min(a[1], b[1], c[1]))), int(max(a[1], b[1], c[1])) + 1):
                u = ((b[0] - i) * (c[1] - j) - (b[1] - j) * (c[0] - i)) / doubled_area
                v = ((c[0] - i) * (a[1] - j) - (c[1] - j) * (a[0] - i)) / doubled_area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                z = u * a[2] + v * b[2] + w * c[2]
                low_mm[i, j] = min(low_mm[i, j], z)
                high_mm[i, j] = max(high_mm[i, j], z)
