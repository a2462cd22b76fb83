"""Tables for the growth of blocks: the cells, and two prices of every box."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Floats
from decompose.grid import OVERHANG, VOLUME, BoxTables, Grid, compute_index
from decompose.jit import jit

SPEED_MM_S = 20.0  # speed of shell and infill in the paper's settings
OVERHANG_TOLERANCE_DEG = 1.0  # tolerance for the angle of overhangs in the paper's settings


@dataclass(frozen=True, slots=True)
class GrowthTables:
    """Cells of the grid, and prices that decide how blocks grow.

    Attributes
    ----------
    is_needed
        (nx, ny, nz) bool, true for cells that must be covered.
    is_excluded
        (nx, ny, nz) bool, true for cells that no block may contain: those of the other half of a cut model.
    seconds
        (boxes,) float32 of `BoxTables`: +inf if a box does not fit.
    piece_counts
        (boxes,) int16 of `BoxTables`.
    printing_prices
        (boxes,) float32 P, the price of printing a box. It is used only for trimmed boxes, because blocks
        grow only by layers with needed cells.
    overhang_prices
        (boxes,) float32 O, the least overhang of a box in its six axis-aligned poses, which the score adds
        to P.
    """

    is_needed: Bools
    is_excluded: Bools
    seconds: npt.NDArray[np.float32]
    piece_counts: npt.NDArray[np.int16]
    printing_prices: npt.NDArray[np.float32]
    overhang_prices: npt.NDArray[np.float32]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the grid, in cells."""
        nx, ny, nz = self.is_needed.shape
        return nx, ny, nz

    def restrict_to_half(self, axis: int, plane: int, keeps_upper: bool) -> GrowthTables:
        """Restrict the tables to one side of a plane of the grid.

        Parameters
        ----------
        axis, plane
            Axis perpendicular to the plane, and index of the plane.
        keeps_upper
            Whether the side above the plane is kept.
        """
        is_other_half = np.zeros(self.is_needed.shape, dtype=np.bool_)
        side = slice(None, plane) if keeps_upper else slice(plane, None)
        is_other_half[tuple(side if a == axis else slice(None) for a in range(3))] = True
        return replace(
            self, is_needed=self.is_needed & ~is_other_half, is_excluded=self.is_excluded | is_other_half
        )


def make_time_tables(grid: Grid, box_tables: BoxTables) -> GrowthTables:
    """Build the tables in which P is the print time in the best pose, with supports, and O is 0.

    Parameters
    ----------
    grid
        Grid over the model.
    box_tables
        Tables of the boxes of the grid.
    """
    zero_overhangs = np.zeros(len(box_tables.seconds), np.float32)
    return GrowthTables(
        grid.is_needed,
        np.zeros_like(grid.is_needed),
        box_tables.seconds,
        box_tables.piece_counts,
        box_tables.seconds,
        zero_overhangs,
    )


def make_paper_tables(grid: Grid, box_tables: BoxTables) -> GrowthTables:
    """Build the tables in which P is speed times the sum of volume and area, and O the least overhang area.

    Parameters
    ----------
    grid
        Grid over the model, built with the paper's tolerance for overhangs.
    box_tables
        Tables of the boxes of the grid.
    """
    columns = np.concatenate(
        [grid.sums[..., [VOLUME]], grid.area_mm2[..., None], grid.sums[..., OVERHANG : OVERHANG + 6]], axis=3
    )
    sums = np.zeros([n + 1 for n in grid.shape] + [columns.shape[3]])
    sums[1:, 1:, 1:] = columns.cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
    cut_sums = []
    for axis, cut in enumerate(grid.cuts):
        a, b = (i for i in range(3) if i != axis)
        table = np.zeros([n + (i != axis) for i, n in enumerate(cut.shape)])
        table[tuple(slice(None) if i == axis else slice(1, None) for i in range(3))] = cut.cumsum(a).cumsum(b)
        cut_sums.append(table)
    printing, overhang = _compute_paper_prices(
        sums, cut_sums[0], cut_sums[1], cut_sums[2], len(box_tables.seconds), SPEED_MM_S
    )
    no_cells = np.zeros_like(grid.is_needed)
    return GrowthTables(
        grid.is_needed, no_cells, box_tables.seconds, box_tables.piece_counts, printing, overhang
    )


@jit
def _compute_paper_prices(
    sums: Floats, cut_x: Floats, cut_y: Floats, cut_z: Floats, box_count: int, speed_mm_s: float
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Compute P and O of `GrowthTables` for every box.

    Parameters
    ----------
    sums
        (nx + 1, ny + 1, nz + 1, 8) float64 summed-area table of volume in mm3, surface in mm2, and overhangs
        in the six poses in mm2.
    cut_x, cut_y, cut_z
        (nx + 1, ny + 1, nz + 1) float64 summed-area tables of the cut areas in mm2 on the planes
        perpendicular to one axis: sums along the two other axes.
    box_count
        Number of boxes.
    speed_mm_s
        Speed of shell and infill.

    Returns
    -------
    tuple
        (boxes,) float32 P, and (boxes,) float32 O.
    """
    nx, ny, nz = sums.shape[0] - 1, sums.shape[1] - 1, sums.shape[2] - 1
    printing = np.zeros(box_count, np.float32)
    overhang = np.zeros(box_count, np.float32)
    for x0 in range(nx):
        for x1 in range(x0 + 1, nx + 1):
            for y0 in range(ny):
                for y1 in range(y0 + 1, ny + 1):
                    for z0 in range(nz):
                        for z1 in range(z0 + 1, nz + 1):
                            s = sums[x1, y1, z1] - sums[x0, y1, z1] - sums[x1, y0, z1]
                            s = s - sums[x1, y1, z0] + sums[x0, y0, z1] + sums[x0, y1, z0]
                            s = s + sums[x1, y0, z0] - sums[x0, y0, z0]
                            area_mm2 = s[1]
                            for end in range(2):
                                x, y, z = (x0, y0, z0) if end == 0 else (x1, y1, z1)
                                area_mm2 += cut_x[x, y1, z1] - cut_x[x, y0, z1] - cut_x[x, y1, z0]
                                area_mm2 += cut_x[x, y0, z0]
                                area_mm2 += cut_y[x1, y, z1] - cut_y[x0, y, z1] - cut_y[x1, y, z0]
                                area_mm2 += cut_y[x0, y, z0]
                                area_mm2 += cut_z[x1, y1, z] - cut_z[x0, y1, z] - cut_z[x1, y0, z]
                                area_mm2 += cut_z[x0, y0, z]
                            box = compute_index((x0, y0, z0, x1, y1, z1), (nx, ny, nz))
                            printing[box] = speed_mm_s * (s[0] + area_mm2)
                            overhang[box] = s[2:8].min()
    return printing, overhang
