"""Lower bound on the makespan of all partitions into axis-parallel boxes, on a grid or not.

The work (print time) of all boxes together is bounded from below. One of n boxes has at least an n-th of it.
If the printers differ in speed, one box has at least the share of its printer, in proportion to the speed.

Surface and volume: each face of the model is printed once. It costs at least its price in the cheapest axis
pose, in which an axis of the grid points up. Each mm3 of solid in a box is also printed once.

Cut faces: a line along an axis runs through a length L of solid. At most a length U of it, far enough from
the surface, need not be printed. A box is at most R long, the longest side of a build volume. So the line is
shared by m >= (L - U) / R boxes. At m - 1 places one box ends and the next one begins. There are two cut
faces at each place, whether the boxes touch or not. If they do not touch, the solid between them is not
printed. Compared with the whole line in one box, the extra cost is at least

    2 k (m - 1) - v U / 3, but never above 0 if L <= R.

Here m is the least whole number >= 2 for which L - U <= m R. The least price of a mm2 of cut face in any pose
is k, and the price of a mm3 of solid is v. A third of v counts for each of the three lines through a point.
The integral of the extra cost over all lines along the three axes is the cost of the cuts minus the savings
from hollows. The extra cost increases with L and decreases with U, so the bound also holds if L is too small
or U too large. In each row of cells of a grid, L is the longest run of full cells, and U the length of all
cells that may be left out.

`compute_price_s` subtracts two savings from the price of a box. Insets: inner walls are shorter than outer
walls; this saving is limited by the height of a build volume. Rims: along the edges of skin, walls are
printed instead of it; this saving is limited by the skin that can be printed within the upper limit of the
bound.

As in the tables of a grid (`grid.boxes`), a box is priced as one part in an axis-aligned pose, even if its
solid is in several pieces. Supports, brims and minimum layer times only add to the price.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import distance_transform_edt

from decompose.arrays import Bools, Floats, Ints
from decompose.grid import Cell, Grid, GridRules, fill_grid, place_planes
from decompose.print_time import MEAN_SIDE_SHARE, CostModel
from decompose.printers import TargetPrinter

CELLS_PER_SIDE = 64  # cube root of the number of cells; enough for a wall of 10 mm in a model of 450 mm
UNREACHABLE_COS = 1.0  # no face has a cosine above this limit, so no skin and no overhangs are counted


def sum_least_work_s(
    triangles: Floats, printers: Sequence[TargetPrinter], cost: CostModel, wall_mm: float
) -> float:
    """Compute a lower bound on the total time of any boxes into which a solid is cut.

    It does not include the fixed time and the savings (insets and rims) of each box.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm, a closed mesh whose faces point outward by the right-hand rule.
    printers
        Printers, each of which prints at most one box; only their build volumes count.
    cost
        Cost model for print times.
    wall_mm
        Thickness of the wall: solid that is this close to the surface must be in a box. Inf if no solid may
        be left out.

    Returns
    -------
    float
        Seconds.
    """
    max_length_mm = max(side_mm for printer in printers for box in printer.box_sizes_mm for side_mm in box)
    volume_mm3 = float(
        np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])) / 6.0
    )
    work_s = _compute_min_surface_price_s(triangles, cost) + cost.volume_s_per_mm3 * volume_mm3
    grid = _build_grid(triangles)
    is_unneeded = _find_unneeded_cells(grid, wall_mm)
    for axis in range(3):
        solid_mm, hollow_mm, area_mm2 = _measure_rows(grid, is_unneeded, axis).T
        work_s += float((area_mm2 * _price_cuts_s_per_mm2(solid_mm, hollow_mm, max_length_mm, cost)).sum())
    return work_s


def bound_shared_work_s(
    work_s: float, printers: Sequence[TargetPrinter], cost: CostModel, makespan_s: float
) -> float:
    """Compute a lower bound on the makespan of all partitions of a solid into axis-parallel boxes.

    Parameters
    ----------
    work_s
        Work that the printers share: the result of `sum_least_work_s`.
    printers
        Printers, each of which prints at most one box; their heights and their speeds count.
    cost
        Cost model for print times.
    makespan_s
        Upper limit of the bound, such as the makespan of a known partition. It also limits the
        savings from rims, because partitions with a longer makespan are above the bound in any case.

    Returns
    -------
    float
        Seconds.
    """
    time_factors = [printer.time_factor for printer in printers]
    max_height_mm = max(box[2] for printer in printers for box in printer.box_sizes_mm)
    saved_s = cost.inset_s_per_mm * float(max_height_mm)
    saved_s += _compute_max_rim_savings_s(cost, makespan_s / min(time_factors))
    per_part_s = cost.fixed_s - saved_s
    per_part_s *= min(time_factors) if per_part_s > 0.0 else max(time_factors)
    return min(makespan_s, max(0.0, work_s / sum(1.0 / factor for factor in time_factors) + per_part_s))


def _compute_min_surface_price_s(triangles: Floats, cost: CostModel) -> float:
    """Compute the price of triangles (m, 3, 3) as surface, in s: each in its cheapest axis-aligned pose."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    doubled_areas_mm2 = np.linalg.norm(cross, axis=1)
    cosines = np.abs(cross) / np.maximum(doubled_areas_mm2, np.finfo(float).tiny)[:, None]
    upright = np.sqrt(np.maximum(0.0, 1.0 - cosines * cosines))
    skin_s_per_mm2 = cost.skin_s_per_mm2 * cosines + cost.slope_s_per_mm2 * upright
    prices_s_per_mm2 = cost.lateral_s_per_mm2 * upright + (cosines > cost.skin_cos) * skin_s_per_mm2
    return float((prices_s_per_mm2.min(axis=1) * doubled_areas_mm2).sum() / 2.0)


def _price_cuts_s_per_mm2(
    solid_mm: Floats, hollow_mm: Floats, max_length_mm: float, cost: CostModel
) -> Floats:
    """Compute the least extra cost of lines that several boxes share, in s per mm2 of cross-section.

    The extra cost is the cost minus that of the whole line in a single box.

    Parameters
    ----------
    solid_mm, hollow_mm
        (k,) minimum length L of the solid on each line, and maximum length U of the solid that need not be
        printed.
    max_length_mm
        Maximum length of a box.
    cost
        Cost model for print times.
    """
    hidden_share = max(cost.hidden_bed_share, cost.hidden_top_share)
    upright_s_per_mm2 = (1.0 - MEAN_SIDE_SHARE * cost.hidden_side_share) * cost.lateral_s_per_mm2
    face_s_per_mm2 = min(upright_s_per_mm2, (1.0 - hidden_share) * cost.skin_s_per_mm2)
    box_counts = np.maximum(2.0, np.ceil((solid_mm - hollow_mm) / max_length_mm - 1e-9))
    cut_s = 2.0 * face_s_per_mm2 * (box_counts - 1.0) - cost.volume_s_per_mm3 * hollow_mm / 3.0
    return np.asarray(np.where(solid_mm > max_length_mm, cut_s, np.minimum(0.0, cut_s)))


def _compute_max_rim_savings_s(cost: CostModel, makespan_s: float) -> float:
    """Compute the maximum time in s that `compute_price_s` subtracts for the rims of a part.

    Only parts that take at most `makespan_s` are considered.
    """
    if not cost.skin_s_per_mm2:
        return 0.0
    rim_s_per_mm, skin_s_per_mm2 = cost.skin_rim_s_per_mm, cost.skin_s_per_mm2
    return (
        rim_s_per_mm
        * (rim_s_per_mm + math.sqrt(rim_s_per_mm * rim_s_per_mm + 4.0 * skin_s_per_mm2 * makespan_s))
        / (2.0 * skin_s_per_mm2)
    )


def _build_grid(triangles: Floats) -> Grid:
    """Build a grid of nearly cubic cells over triangles (m, 3, 3) in mm."""
    lo_mm, hi_mm = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    edge_mm = float(np.prod(hi_mm - lo_mm) ** (1.0 / 3.0)) / CELLS_PER_SIDE
    px, py, pz = (
        place_planes(lo, hi, max(1, round((hi - lo) / edge_mm)))
        for lo, hi in zip(lo_mm.tolist(), hi_mm.tolist(), strict=True)
    )
    return fill_grid(triangles, (px, py, pz), GridRules(0.0, True, UNREACHABLE_COS, UNREACHABLE_COS))


def _find_unneeded_cells(grid: Grid, wall_mm: float) -> Bools:
    """Find the cells (nx, ny, nz) with solid that may be further from the surface than the wall thickness.

    A cell is not among them if all of it is closer than the wall thickness to every point of one box: the
    bounding box of the surface in a cell with surface. Any such cell is valid; it is about the nearest one.
    """
    low_mm, high_mm = (
        np.stack(np.meshgrid(*(p[side : len(p) - 1 + side] for p in grid.planes), indexing="ij"), axis=-1)
        for side in range(2)
    )
    nearest = distance_transform_edt(
        grid.cells != Cell.BOUNDARY,
        sampling=[np.diff(planes).mean() for planes in grid.planes],
        return_distances=False,
        return_indices=True,
    )
    is_needed = grid.is_needed
    surface = grid.surface_bounds_mm[tuple(nearest[:, is_needed])]
    centres_mm, halves_mm = (surface[:, :3] + surface[:, 3:]) / 2.0, (surface[:, 3:] - surface[:, :3]) / 2.0
    low_mm, high_mm = low_mm[is_needed], high_mm[is_needed]
    reach_mm = np.abs((low_mm + high_mm) / 2.0 - centres_mm) + (high_mm - low_mm) / 2.0 + halves_mm
    is_unneeded = np.zeros(is_needed.shape, np.bool_)
    is_unneeded[is_needed] = np.linalg.norm(reach_mm, axis=1) > wall_mm
    return is_unneeded


def _measure_rows(grid: Grid, is_unneeded: Bools, axis: int) -> Floats:
    """Measure each run of cells with solid along an axis.

    Returns
    -------
    Floats
        (k, 3) for each run: length of the longest run of full cells within it in mm, length of all its cells
        that may be left out in mm, and its cross-section in mm2.
    """
    a_mm, b_mm = (np.diff(grid.planes[other]) for other in range(3) if other != axis)
    planes_mm, rows = grid.planes[axis], np.moveaxis(grid.is_needed, axis, 2)
    starts, _ = _find_runs(grid.is_needed, axis)
    is_start = np.zeros(rows.shape, np.bool_)
    is_start[tuple(starts.T)] = True
    run_numbers = (is_start.cumsum() - 1).reshape(rows.shape)  # number of the run of each cell with solid
    max_length_mm, hollow_mm = np.zeros(len(starts)), np.zeros(len(starts))
    full_starts, full_ends = _find_runs(grid.cells == Cell.INTERNAL, axis)
    full_mm = planes_mm[full_ends[:, 2]] - planes_mm[full_starts[:, 2]]
    np.maximum.at(max_length_mm, run_numbers[tuple(full_starts.T)], full_mm)
    unneeded_cells = np.argwhere(np.moveaxis(is_unneeded, axis, 2))
    np.add.at(hollow_mm, run_numbers[tuple(unneeded_cells.T)], np.diff(planes_mm)[unneeded_cells[:, 2]])
    return np.stack([max_length_mm, hollow_mm, a_mm[starts[:, 0]] * b_mm[starts[:, 1]]], axis=1)


def _find_runs(cells: Bools, axis: int) -> tuple[Ints, Ints]:
    """Find the start and the end of each run of cells (nx, ny, nz) along an axis.

    Returns
    -------
    tuple
        (k, 3) int64 indices of the starts, and (k, 3) of the ends; the axis is the last column.
    """
    rows = np.moveaxis(cells, axis, 2).astype(np.int8)
    steps = np.diff(np.pad(rows, ((0, 0), (0, 0), (1, 1))), axis=2)
    return np.argwhere(steps == 1), np.argwhere(steps == -1)
