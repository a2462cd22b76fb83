"""Needed cells of a grid, found on finer cells than those along which the model is cut.

On the grid, a whole cell counts as needed, even if only a small part of it is needed. Finer cells matter when
planes are moved off the grid: a part next to a hollow may shrink until it contains only the surface and the
wall behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import map_coordinates

from decompose.arrays import Bools, Floats
from decompose.grid.grid import Cell, Grid, divide_planes, find_cells

SAME_PLANE_MM = 1e-9  # maximum difference between coordinates of the same plane
MAX_DIVISION = 6  # maximum number of fine cells along each side of a cell


def refine_cells(
    grid: Grid, triangles: Floats, min_wall_mm: float, keeps_interior: bool, max_cells: int
) -> NeededCells:
    """Divide the needed cells of a grid into fine cells, and find the fine cells that are needed.

    Parameters
    ----------
    grid
        Grid over the triangles.
    triangles
        (m, 3, 3) in mm.
    min_wall_mm
        Distance from the surface within which cells are needed.
    keeps_interior
        Whether every internal cell is needed.
    max_cells
        Maximum number of fine cells in total, unless the grid itself has more cells.
    """
    divisions = max(1, min(MAX_DIVISION, int((max_cells / grid.is_needed.size) ** (1.0 / 3.0))))
    px, py, pz = (divide_planes(cell_planes, divisions) for cell_planes in grid.planes)
    planes = (px, py, pz)
    cells, surface_bounds_mm = find_cells(triangles, planes)
    is_needed = cells != Cell.EXTERNAL
    if not keeps_interior:
        boundary = cells == Cell.BOUNDARY
        is_needed = boundary | is_needed & _find_near_cells(surface_bounds_mm[boundary], planes, min_wall_mm)
    is_cell_needed = grid.is_needed
    for axis in range(3):
        is_cell_needed = is_cell_needed.repeat(divisions, axis=axis)
    return NeededCells(planes, is_needed & is_cell_needed)


def _find_near_cells(bounds_mm: Floats, planes: tuple[Floats, Floats, Floats], distance_mm: float) -> Bools:
    """Find the cells (nx, ny, nz) within a distance of any of the boxes (b, 6), measured along each axis."""
    differences = np.zeros([len(p) for p in planes], dtype=np.int64)
    first = [
        np.searchsorted(p, bounds_mm[:, a] - distance_mm, side="right") - 1 for a, p in enumerate(planes)
    ]
    last = [np.searchsorted(p, bounds_mm[:, a + 3] + distance_mm, side="left") for a, p in enumerate(planes)]
    spans = [
        (np.clip(lo, 0, len(p) - 1), np.clip(hi, 0, len(p) - 1))
        for lo, hi, p in zip(first, last, planes, strict=True)
    ]
    for corner in np.ndindex(2, 2, 2):
        index = tuple(span[side] for span, side in zip(spans, corner, strict=True))
        np.add.at(differences, index, 1 - 2 * (sum(corner) % 2))
    counts = differences.cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
    return np.asarray(counts[:-1, :-1, :-1] > 0)


# Maximum share of all cells that may stay uncovered because of rounding, or of faces that are not exactly at
# the same coordinate (`SAME_PLANE_MM`).
MAX_UNCOVERED_SHARE = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class NeededCells:
    """Cells that boxes have to cover.

    Attributes
    ----------
    planes
        (n + 1,) ascending coordinates of the planes perpendicular to each axis, in mm.
    is_needed
        (nx, ny, nz) bool, true for cells to be covered.
    counts_below
        (nx + 1, ny + 1, nz + 1) float64 number of needed cells between the lowest corner of the grid and each
        of its corners.
    """

    planes: tuple[Floats, Floats, Floats]
    is_needed: Bools
    counts_below: Floats = field(init=False)

    def __post_init__(self) -> None:
        sums = self.is_needed.cumsum(axis=0, dtype=np.float64).cumsum(axis=1).cumsum(axis=2)
        object.__setattr__(self, "counts_below", np.pad(sums, ((1, 0),) * 3))

    def is_partition(self, boxes_mm: Floats) -> bool:
        """Check whether boxes (n, 2, 3) in mm do not overlap, and cover all needed cells."""
        lo, hi = boxes_mm[:, 0], boxes_mm[:, 1]
        overlap = np.minimum(hi[:, None], hi[None]) - np.maximum(lo[:, None], lo[None])
        if (np.triu((overlap > SAME_PLANE_MM).all(axis=2), k=1)).any() or (hi - lo <= SAME_PLANE_MM).any():
            return False
        uncovered_cells = self.counts_below[-1, -1, -1] - self._sum_covered_cells(boxes_mm)
        return bool(uncovered_cells <= MAX_UNCOVERED_SHARE * self.is_needed.size)

    def find_needed_bounds_mm(self, box_mm: Floats, margin_mm: float = 0.0) -> Floats:
        """Find the bounds (2, 3) in mm of the needed cells in a box (2, 3); the box itself if it has none.

        With a margin, cells up to that distance outside the box are included if there are others; the bounds
        stay in the box.
        """
        first, last = self._find_cell_range(box_mm + np.array([[-margin_mm], [margin_mm]]))
        x0, y0, z0, x1, y1, z1 = *first, *last
        c = self.counts_below
        counts = (
            c[x0 : x1 + 1, y1, z1] - c[x0 : x1 + 1, y0, z1] - c[x0 : x1 + 1, y1, z0] + c[x0 : x1 + 1, y0, z0],
            c[x1, y0 : y1 + 1, z1] - c[x0, y0 : y1 + 1, z1] - c[x1, y0 : y1 + 1, z0] + c[x0, y0 : y1 + 1, z0],
            c[x1, y1, z0 : z1 + 1] - c[x0, y1, z0 : z1 + 1] - c[x1, y0, z0 : z1 + 1] + c[x0, y0, z0 : z1 + 1],
        )
        bounds_mm = box_mm.copy()
        for axis, axis_counts in enumerate(counts):
            needed = np.flatnonzero(np.diff(axis_counts) > 0.5)
            if not len(needed):
                return box_mm.copy()
            planes = self.planes[axis]
            bounds_mm[0, axis] = max(box_mm[0, axis], planes[first[axis] + needed[0]])
            bounds_mm[1, axis] = min(box_mm[1, axis], planes[first[axis] + needed[-1] + 1])
        return bounds_mm if (bounds_mm[0] < bounds_mm[1]).all() else box_mm.copy()

    def _find_cell_range(self, box_mm: Floats) -> tuple[list[int], list[int]]:
        """Find the first cell along each axis that a box (2, 3) overlaps, and the end of these cells."""
        first, last = [], []
        for planes, (low_mm, high_mm) in zip(self.planes, box_mm.T, strict=True):
            low = int(np.searchsorted(planes, low_mm + SAME_PLANE_MM, side="right")) - 1
            high = int(np.searchsorted(planes, high_mm - SAME_PLANE_MM, side="left"))
            first.append(min(max(low, 0), len(planes) - 1))
            last.append(min(max(high, 0), len(planes) - 1))
        return first, last

    def _sum_covered_cells(self, boxes_mm: Floats) -> float:
        """Sum the shares of the needed cells that disjoint boxes (n, 2, 3) cover.

        Within a cell, the covered share is linear along each axis, as are the sums between its corners.
        """
        positions = np.stack(
            [
                np.interp(boxes_mm[:, :, axis], planes, np.arange(len(planes)))
                for axis, planes in enumerate(self.planes)
            ]
        )  # (3, n, 2)
        covered_cells = 0.0
        for corner in np.ndindex(2, 2, 2):
            points = np.stack([positions[axis, :, side] for axis, side in enumerate(corner)])
            sign = 1 - 2 * ((3 - sum(corner)) % 2)
            covered_cells += sign * float(
                map_coordinates(self.counts_below, points, order=1, mode="nearest").sum()
            )
        return covered_cells
