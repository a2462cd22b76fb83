"""Tables of every axis-aligned box of a grid: price, box around the needed cells, and number of pieces.

A box is priced in its six axis-aligned poses: in each, one of its sides lies on the bed. The sums over a box
are those over the box that is one layer of cells shorter, plus those over the added layer, which is summed
from rows of cells in the same way. Needed cells are those of `Grid.is_needed`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Floats
from decompose.build_volumes import fits_all, list_build_volumes
from decompose.grid.box_index import Box, Shape, compute_index, index_box
from decompose.grid.clipping import LATERAL_AREA, MOMENT, OVERHANG, SKIN, SLOPE, VOLUME
from decompose.grid.grid import Grid
from decompose.grid.piece_counts import count_pieces
from decompose.grid.threads import SHARE_COUNT, run_shares
from decompose.jit import jit
from decompose.print_time import MEAN_SIDE_SHARE, MIN_VISIBLE_MM2, CostModel, Prices, compute_price_s
from decompose.printers import TargetPrinter


@dataclass(frozen=True, slots=True)
class BoxTables:
    """Tables of every axis-aligned box of a grid.

    The index of a box combines the indices of its intervals along x, y and z (`box_index`).

    Attributes
    ----------
    shape
        Shape of the grid, in cells.
    seconds
        (boxes,) print time in the best pose; +inf if none fits, or if a smaller box has its needed cells.
    trimmed_box
        (boxes,) index of the smallest box around the needed cells of a box; -1 if there are none.
    piece_counts
        (boxes,) number of connected pieces of the solid in a box, as counted on the grid.
    cut_mm2
        (boxes,) total area of a box's cut faces, or 0 as for `seconds`; empty (0,) if not needed.
    """

    shape: tuple[int, int, int]
    seconds: npt.NDArray[np.float32]
    trimmed_box: npt.NDArray[np.int32]
    piece_counts: npt.NDArray[np.int16]
    cut_mm2: npt.NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))

    def find_longest_time_s(self, boxes: Iterable[Box]) -> float:
        """Find the time in seconds of the slowest of several boxes, each trimmed to its needed cells."""
        return max(float(self.seconds[self.trimmed_box[index_box(box, self.shape)]]) for box in boxes)


@jit
def _clear_bounds(bounds: Floats) -> None:
    """Set bounds to those of an empty set of cells: inf for the least values, -inf for the greatest ones.

    Parameters
    ----------
    bounds
        (12,) float64 as in `_find_cell_bounds`, set in place.
    """
    for k in range(3):
        bounds[k], bounds[k + 3], bounds[k + 6], bounds[k + 9] = np.inf, -np.inf, np.inf, -np.inf


@jit
def _widen_bounds(bounds: Floats, added_bounds: Floats) -> None:
    """Widen bounds so that they include other bounds.

    Parameters
    ----------
    bounds, added_bounds
        (12,) float64 as in `_find_cell_bounds`; the first array is updated in place.
    """
    for k in range(3):
        bounds[k], bounds[k + 3] = min(bounds[k], added_bounds[k]), max(bounds[k + 3], added_bounds[k + 3])
        bounds[k + 6], bounds[k + 9] = (
            min(bounds[k + 6], added_bounds[k + 6]),
            max(bounds[k + 9], added_bounds[k + 9]),
        )


@jit
def _find_cell_bounds(is_needed: Bools, bounds_mm: Floats) -> Floats:
    """Find the bounds of the solid in each cell, and those of the cell itself if it is needed.

    Parameters
    ----------
    is_needed
        (nx, ny, nz) bool of `Grid`.
    bounds_mm
        (nx, ny, nz, 6) float64 of `Grid`.

    Returns
    -------
    ndarray
        (nx, ny, nz, 12) float64: least and greatest x, y and z of the solid in mm (columns 0-2 and 3-5), and
        of the cell, counted in cells (6-8 and 9-11); 1e9 and -1e9 for a cell that is not needed.
    """
    nx, ny, nz = is_needed.shape
    needed_bounds = np.zeros((nx, ny, nz, 6))
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                for k in range(6):
                    needed_bounds[x, y, z, k] = 1e9 if k < 3 else -1e9
                if is_needed[x, y, z]:
                    needed_bounds[x, y, z, 0], needed_bounds[x, y, z, 3] = x, x + 1
                    needed_bounds[x, y, z, 1], needed_bounds[x, y, z, 4] = y, y + 1
                    needed_bounds[x, y, z, 2], needed_bounds[x, y, z, 5] = z, z + 1
    return np.concatenate((bounds_mm, needed_bounds), axis=3)


@jit
def _fill_cut_areas(cuts: tuple[Floats, Floats, Floats], box: Box, areas_mm2: Floats) -> float:
    """Fill in the cut areas of the sides of a box, and return their sum in mm2.

    Parameters
    ----------
    cuts
        For each axis, float64 sums of `Grid.cuts` along the two other axes: summed-area tables in mm2.
    box
        Box in cells, half-open.
    areas_mm2
        (6,) float64 in mm2, filled in: sides -x, +x, -y, +y, -z, +z.
    """
    x0, y0, z0, x1, y1, z1 = box
    cut_x, cut_y, cut_z = cuts
    for i in range(2):
        x, y, z = (x0, y0, z0) if i == 0 else (x1, y1, z1)
        areas_mm2[i] = cut_x[x, y1, z1] - cut_x[x, y0, z1] - cut_x[x, y1, z0] + cut_x[x, y0, z0]
        areas_mm2[2 + i] = cut_y[x1, y, z1] - cut_y[x0, y, z1] - cut_y[x1, y, z0] + cut_y[x0, y, z0]
        areas_mm2[4 + i] = cut_z[x1, y1, z] - cut_z[x0, y1, z] - cut_z[x1, y0, z] + cut_z[x0, y0, z]
    return float(areas_mm2.sum())


@jit
def _compute_min_price_s(
    prices: Prices, build_volumes: Floats, sums: Floats, bounds_mm: Floats, areas_mm2: Floats
) -> float:
    """Compute the price of a box in the best axis-aligned pose that fits all build volumes; inf if none does.

    Parameters
    ----------
    prices
        Record from `CostModel.build_prices`.
    build_volumes
        (build volumes, boxes, 3) float64 in mm, from `list_build_volumes`.
    sums
        (SUM_COUNT,) float64 sums over its cells, see `grid.clipping`.
    bounds_mm
        (12,) float64; the first six are the bounds of its solid in mm.
    areas_mm2
        (6,) float64 areas of its cut sides in mm2, from `_fill_cut_areas`.
    """
    cut_mm2 = areas_mm2.sum()
    best_s = np.inf
    for up in range(3):
        width_mm = bounds_mm[(up + 1) % 3 + 3] - bounds_mm[(up + 1) % 3]
        depth_mm = bounds_mm[(up + 2) % 3 + 3] - bounds_mm[(up + 2) % 3]
        height_mm = bounds_mm[up + 3] - bounds_mm[up]
        if not fits_all(build_volumes, width_mm, depth_mm, height_mm):
            continue
        flat_mm2 = areas_mm2[2 * up] + areas_mm2[2 * up + 1]
        hidden_side_factor = 1.0 - MEAN_SIDE_SHARE * prices["hidden_side_share"]
        lateral_mm2 = sums[LATERAL_AREA + up] + hidden_side_factor * (cut_mm2 - flat_mm2)
        connectors_s = (
            prices["connector_side_s_per_mm2"] * (cut_mm2 - flat_mm2)
            + prices["connector_level_s_per_mm2"] * flat_mm2
        )
        visible_skin_mm2 = sums[SKIN + up]
        for is_turned_over in range(2):  # the right way up, and upside down
            pose = 2 * up + is_turned_over
            skin_mm2 = visible_skin_mm2 + flat_mm2 - prices["hidden_bed_share"] * areas_mm2[pose]
            if visible_skin_mm2 < MIN_VISIBLE_MM2:  # neither a top nor an underside is visible
                skin_mm2 -= prices["hidden_top_share"] * areas_mm2[4 * up + 1 - pose]
            column_mm3 = sums[MOMENT + pose] - sums[OVERHANG + pose] * bounds_mm[up]
            if is_turned_over == 1:
                column_mm3 = sums[OVERHANG + pose] * bounds_mm[up + 3] - sums[MOMENT + pose]
            features = (sums[VOLUME], lateral_mm2, max(0.0, skin_mm2), sums[SLOPE + up], column_mm3)
            price_s = connectors_s + compute_price_s(prices, features, (width_mm, depth_mm, height_mm))
            best_s = min(best_s, price_s)
    return best_s


class Contents(NamedTuple):
    """Contents of n cells, rows of cells, or layers of cells, float64.

    `sums` (n, SUM_COUNT) are described in `grid.clipping`, `bounds` (n, 12) in `_find_cell_bounds`.
    """

    sums: Floats
    bounds: Floats


class Pricing(NamedTuple):
    """Input for the prices of all boxes.

    Attributes
    ----------
    build_volumes
        (build volumes, boxes, 3) float64 in mm, from `list_build_volumes`.
    cuts
        As in `_fill_cut_areas`.
    prices
        Record from `CostModel.build_prices`.
    """

    build_volumes: Floats
    cuts: tuple[Floats, Floats, Floats]
    prices: Prices


class PriceTables(NamedTuple):
    """Tables to fill in: `seconds`, `trimmed_box` and `cut_mm2` of `BoxTables`, (boxes,) each."""

    seconds: npt.NDArray[np.float32]
    trimmed_box: npt.NDArray[np.int32]
    cut_mm2: npt.NDArray[np.float32]


@jit
def _reset_contents(total: Contents) -> None:
    """Reset contents to those of empty cells."""
    total.sums[:] = 0.0
    for i in range(len(total.bounds)):
        _clear_bounds(total.bounds[i])


@jit
def _add_contents(total: Contents, contents: Contents) -> None:
    """Add contents to a total, item by item."""
    for i in range(len(total.bounds)):
        for k in range(total.sums.shape[1]):
            total.sums[i, k] += contents.sums[i, k]
        _widen_bounds(total.bounds[i], contents.bounds[i])


@jit
def _price_share(
    is_needed: Bools, sums: Floats, bounds: Floats, pricing: Pricing, tables: PriceTables, share: int
) -> None:
    """Price one share of the boxes of a grid, by adding up rows of cells into layers, and layers into boxes.

    Parameters
    ----------
    is_needed, sums
        (nx, ny, nz) bool and (nx, ny, nz, SUM_COUNT) float64 of `Grid`.
    bounds
        (nx, ny, nz, 12) float64 from `_find_cell_bounds`.
    pricing
        Build volumes, cut areas and prices.
    tables
        Tables, filled in.
    share
        Number of the share: its boxes begin along x at this cell, and at every `SHARE_COUNT`-th one after it.
    """
    nx, ny, nz = shape = is_needed.shape
    row = Contents(np.zeros((ny, nz, sums.shape[3])), np.zeros((ny, nz, 12)))
    layer = Contents(np.zeros((nz, sums.shape[3])), np.zeros((nz, 12)))
    for x0 in range(share, nx, SHARE_COUNT):
        for y in range(ny):
            _reset_contents(Contents(row.sums[y], row.bounds[y]))
        for x1 in range(x0 + 1, nx + 1):
            for y in range(ny):
                _add_contents(
                    Contents(row.sums[y], row.bounds[y]), Contents(sums[x1 - 1, y], bounds[x1 - 1, y])
                )
            for y0 in range(ny):
                _reset_contents(layer)
                for y1 in range(y0 + 1, ny + 1):
                    _add_contents(layer, Contents(row.sums[y1 - 1], row.bounds[y1 - 1]))
                    _price_column(layer, (x0, y0, x1, y1), shape, pricing, tables)


@jit
def _price_column(
    layer: Contents, base: tuple[int, int, int, int], shape: Shape, pricing: Pricing, tables: PriceTables
) -> None:
    """Price all boxes with the same base, a rectangle of cells in the x-y plane.

    Parameters
    ----------
    layer
        Contents of the nz layers of cells over the base.
    base
        x0, y0, x1, y1 in cells, half-open.
    shape
        Shape of the grid, in cells.
    pricing
        Build volumes, cut areas and prices.
    tables
        Tables, filled in.
    """
    x0, y0, x1, y1 = base
    nz = shape[2]
    sums, bounds, areas_mm2 = np.zeros(layer.sums.shape[1]), np.zeros(12), np.zeros(6)
    for z0 in range(nz):
        sums[:] = 0.0
        _clear_bounds(bounds)
        for z1 in range(z0 + 1, nz + 1):
            for k in range(len(sums)):
                sums[k] += layer.sums[z1 - 1, k]
            _widen_bounds(bounds, layer.bounds[z1 - 1])
            if bounds[9] < 0.0:
                continue  # no needed cell
            box = (x0, y0, z0, x1, y1, z1)
            index = compute_index(box, shape)
            lower = (int(bounds[6]), int(bounds[7]), int(bounds[8]))
            upper = (int(bounds[9]), int(bounds[10]), int(bounds[11]))
            tables.trimmed_box[index] = compute_index(lower + upper, shape)
            if tables.trimmed_box[index] == index:
                tables.cut_mm2[index] = _fill_cut_areas(pricing.cuts, box, areas_mm2)
                tables.seconds[index] = _compute_min_price_s(
                    pricing.prices, pricing.build_volumes, sums, bounds, areas_mm2
                )


def price_boxes(
    grid: Grid, printers: Sequence[TargetPrinter], cost: CostModel, executor: Executor | None = None
) -> BoxTables:
    """Price every box of a grid.

    Parameters
    ----------
    grid
        Grid that was built with the overhang and skin angles of the cost model.
    printers
        Printers; a box is allowed only if it fits the build volume of each of them.
    cost
        Cost model, which estimates print times.
    executor
        Threads that may price half of the boxes while the current thread prices the others; None to price all
        in the current thread.
    """
    cut_sums = []
    for axis, cut in enumerate(grid.cuts):
        table = np.zeros([n + (a != axis) for a, n in enumerate(cut.shape)])
        a, b = (i for i in range(3) if i != axis)
        inner_index = tuple(slice(None) if i == axis else slice(1, None) for i in range(3))
        table[inner_index] = cut.cumsum(axis=a).cumsum(axis=b)
        cut_sums.append(table)
    cuts = (cut_sums[0], cut_sums[1], cut_sums[2])
    count = math.prod(n * (n + 1) // 2 for n in grid.shape)
    tables = PriceTables(
        np.full(count, np.inf, np.float32), np.full(count, -1, np.int32), np.zeros(count, np.float32)
    )
    pricing = Pricing(list_build_volumes(printers), cuts, cost.build_prices())
    bounds = _find_cell_bounds(grid.is_needed, grid.bounds_mm)
    run_shares(executor, partial(_price_share, grid.is_needed, grid.sums, bounds, pricing, tables))
    piece_counts = np.ones(count, np.int16)
    count_pieces(grid.shape, grid.bodies, tables.trimmed_box, tables.seconds, piece_counts, executor)
    return BoxTables(grid.shape, tables.seconds, tables.trimmed_box, piece_counts, tables.cut_mm2)
