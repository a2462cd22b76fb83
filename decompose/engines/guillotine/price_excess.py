"""Excess of true prices over those of the tables, spread over the cells of the boxes that were cut.

The tables price boxes by sums over their cells, in axis-aligned poses. Where a model has thin walls, holes or
overhangs, these prices are too low, and the search would choose such boxes again and again. So the excess of
each box whose true price is known is spread over its solid, and added to the prices of other boxes there.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from decompose.arrays import Float32s, Floats, Ints
from decompose.grid import VOLUME, Box, BoxTables, Grid, find_interval_ends, index_box
from decompose.jit import jit

# Share of the excess that is added to the prices of other boxes: they may be cut where it does not arise.
SPREAD_SHARE = 0.7


class PriceExcess:
    """Estimate of the true prices of boxes whose true prices are not known.

    Parameters
    ----------
    grid, tables
        Grid, and its tables.

    Attributes
    ----------
    estimates
        The same tables with estimated prices.
    """

    def __init__(self, grid: Grid, tables: BoxTables) -> None:
        self.estimates = replace(tables, seconds=tables.seconds.copy())
        self._grid, self._tables = grid, tables
        self._volumes_mm3 = grid.sums[..., VOLUME]
        self._excess_s_per_mm3 = np.zeros(self._volumes_mm3.shape)  # sum over the boxes around each cell
        self._box_count = np.zeros(self._volumes_mm3.shape, np.int64)
        self._true_indices: list[int] = []

    def copy(self, tables: BoxTables) -> PriceExcess:
        """Copy the known excess for a copy of the tables."""
        excess = PriceExcess(self._grid, tables)
        excess.estimates.seconds[:] = self.estimates.seconds
        excess._excess_s_per_mm3[:] = self._excess_s_per_mm3
        excess._box_count[:] = self._box_count
        excess._true_indices = self._true_indices.copy()
        return excess

    def record(self, box: Box, true_s: float) -> None:
        """Record the true price of a box, which becomes its price in both tables unless it is lower.

        Parameters
        ----------
        box
            Box, trimmed to its needed cells.
        true_s
            Its true price; inf if a piece has no pose.
        """
        index = index_box(box, self._tables.shape)
        table_s = float(self._tables.seconds[index])
        cells = tuple(slice(box[axis], box[axis + 3]) for axis in range(3))
        volume_mm3 = float(self._volumes_mm3[cells].sum())
        if math.isfinite(true_s) and math.isfinite(table_s) and volume_mm3 > 0.0:
            self._excess_s_per_mm3[cells] += max(0.0, true_s - table_s) / volume_mm3
            self._box_count[cells] += 1
        self._true_indices.append(index)
        self._tables.seconds[index] = self.estimates.seconds[index] = max(table_s, true_s)

    def exclude(self, box: Box) -> None:
        """Exclude a box from both tables."""
        index = index_box(box, self._tables.shape)
        self._tables.seconds[index] = self.estimates.seconds[index] = math.inf

    def update_estimates(self) -> None:
        """Estimate the prices of all boxes from the excess of those whose true prices are known."""
        excess_s = SPREAD_SHARE * self._excess_s_per_mm3 / self._box_count.clip(1) * self._volumes_mm3
        add_box_sums(self._tables.seconds, excess_s, self.estimates.seconds)
        self.estimates.seconds[self._true_indices] = self._tables.seconds[self._true_indices]


def add_box_sums(seconds: Float32s, values_s: Floats, estimates_s: Float32s) -> None:
    """Add the sum over the cells of each box to its price.

    Parameters
    ----------
    seconds
        (boxes,) prices, in the order of the tables.
    values_s
        (nx, ny, nz) value of each cell.
    estimates_s
        (boxes,) array for the sums of both.
    """
    sums_s = np.pad(values_s, ((1, 0), (1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
    x_ends, y_ends, z_ends = (_list_ends(count) for count in values_s.shape)
    _fill_estimates(seconds, sums_s, x_ends, y_ends, z_ends, estimates_s)


@jit
def _fill_estimates(
    seconds: Float32s, sums_s: Floats, x_ends: Ints, y_ends: Ints, z_ends: Ints, estimates_s: Float32s
) -> None:
    """Add the sums of all boxes to their prices, from the sums of the cells below each corner of the grid."""
    box = 0
    for x in range(len(x_ends)):
        layer_s = sums_s[x_ends[x, 1]] - sums_s[x_ends[x, 0]]
        for y in range(len(y_ends)):
            row_s = layer_s[y_ends[y, 1]] - layer_s[y_ends[y, 0]]
            for z in range(len(z_ends)):
                estimates_s[box] = seconds[box] + (row_s[z_ends[z, 1]] - row_s[z_ends[z, 0]])
                box += 1


def _list_ends(count: int) -> Ints:
    """List the ends (k, 2) of all intervals on an axis with a number of cells, by their indices."""
    return np.array([find_interval_ends(interval, count) for interval in range(count * (count + 1) // 2)])
