"""Proven lower bounds on the makespan: from surface and volume, and from the tables of a grid's boxes.

The bound from the tables holds for all partitions of the grid into boxes.

The certificate of the bound is a weight for each needed cell, that is, each cell that must be printed. If n
parts contain all the weight, one of them contains at least an n-th of it. So the makespan is at least the
time of the fastest box that contains an n-th of the weight. A box of k pieces counts as k parts, so it has to
contain k n-ths of the weight. This is true for any weights. The weights are whole numbers, so that
comparisons are exact. Every box of the grid is examined.

Good weights are the dual solution of a linear programme (`bound.covering`): cover the needed cells with the
fewest boxes, or fractions of boxes, that each take at most T seconds. If more than n boxes are needed, the
makespan is longer than T. Bisection finds the greatest such T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from decompose.arrays import Bools, Floats, Ints
from decompose.bound.covering import cover_cells
from decompose.grid import BoxTables, index_interval, sum_box
from decompose.jit import jit
from decompose.print_time import MAX_INSET_SHARE, CostModel

WEIGHT_UNIT = 1 << 24  # whole number that stands for a weight of 1; weights are rounded down to whole numbers
MAX_LIMITS = 30  # maximum number of limits T that are tested
FIRST_LIMIT_SHARE = 0.95  # first limit T, as a share of a known partition's makespan
TOLERANCE = 0.0075  # accuracy of the bound, as a share of it


@dataclass(frozen=True, slots=True)
class Bound:
    """Lower bound with its certificate.

    Attributes
    ----------
    seconds
        Lower bound on the time of the slowest box, for all partitions into at most as many pieces as there
        are printers.
    weights
        (nx, ny, nz) int64 weights of the cells; 0 if a cell is not needed.
    """

    seconds: float
    weights: Ints


@jit
def _find_bound_s(
    weight_sums: Ints,
    printer_count: int,
    makespan_s: float,
    seconds: npt.NDArray[np.float32],
    trimmed_box: npt.NDArray[np.int32],
    piece_counts: npt.NDArray[np.int16],
) -> float:
    """Find the time of the fastest box that contains enough weight for its number of pieces.

    For each of its pieces, a box must contain the total weight divided by the number of printers.

    Parameters
    ----------
    weight_sums
        (nx + 1, ny + 1, nz + 1) int64 summed-area table of the weights.
    printer_count
        Maximum number of pieces.
    makespan_s
        Upper limit of the result.
    seconds, trimmed_box, piece_counts
        (boxes,) float32 in s, (boxes,) int32 and (boxes,) int16 of `BoxTables`.
    """
    nx, ny, nz = weight_sums.shape[0] - 1, weight_sums.shape[1] - 1, weight_sums.shape[2] - 1
    y_interval_count, z_interval_count = ny * (ny + 1) // 2, nz * (nz + 1) // 2
    total = weight_sums[nx, ny, nz]
    proven_s = makespan_s
    for x0 in range(nx):
        for x1 in range(x0 + 1, nx + 1):
            ix = index_interval(x0, x1, nx)
            for y0 in range(ny):
                for y1 in range(y0 + 1, ny + 1):
                    row = (ix * y_interval_count + index_interval(y0, y1, ny)) * z_interval_count
                    for z0 in range(nz):
                        for z1 in range(z0 + 1, nz + 1):
                            box = row + index_interval(z0, z1, nz)
                            if not seconds[box] < proven_s or trimmed_box[box] != box:
                                continue
                            weight = sum_box(weight_sums, (x0, y0, z0, x1, y1, z1))
                            if weight * printer_count >= piece_counts[box] * total:
                                proven_s = float(seconds[box])
    return proven_s


def _compute_bound(tables: BoxTables, weights: Floats, printer_count: int, makespan_s: float) -> Bound:
    """Compute the bound that weights prove."""
    whole_weights = np.floor(weights * WEIGHT_UNIT).astype(np.int64)
    weight_sums = np.pad(whole_weights, ((1, 0),) * 3).cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
    arrays = (tables.seconds, tables.trimmed_box, tables.piece_counts)
    return Bound(_find_bound_s(weight_sums, printer_count, makespan_s, *arrays), whole_weights)


def bound_makespan(tables: BoxTables, is_needed: Bools, printer_count: int, makespan_s: float) -> Bound:
    """Prove a lower bound on the time of the slowest box, for all partitions into boxes, guillotine or not.

    Parameters
    ----------
    tables
        Tables for which the proof holds. It assumes that a box takes the time of its best axis-aligned pose
        (one of its sides lies on the bed), with supports down to the bed, and that it consists of as many
        pieces as the tables say.
    is_needed
        (nx, ny, nz) bool, true for cells that must be in a box; at least one.
    printer_count
        Maximum number of pieces.
    makespan_s
        Makespan of a partition into at most that many pieces, according to the tables.

    Returns
    -------
    Bound
        Best proven bound. It is below the optimum because fractions of boxes are allowed, and because the
        linear programmes are solved approximately.
    """
    weights = is_needed * (printer_count / is_needed.sum())
    best_bound = _compute_bound(tables, weights, printer_count, makespan_s)
    high_s, limit_s = makespan_s, FIRST_LIMIT_SHARE * makespan_s
    for _ in range(MAX_LIMITS):
        if high_s <= best_bound.seconds * (1.0 + TOLERANCE):
            break
        if limit_s <= best_bound.seconds:
            limit_s = (best_bound.seconds + high_s) / 2.0
        weights = cover_cells(tables, is_needed, limit_s, printer_count, weights).weights
        bound = _compute_bound(tables, weights, printer_count, makespan_s)
        best_bound = max(best_bound, bound, key=lambda b: b.seconds)
        if bound.seconds <= limit_s:
            high_s = limit_s
        limit_s = (best_bound.seconds + high_s) / 2.0
    return best_bound


def compute_surface_bound_s(area_mm2: float, volume_mm3: float, printer_count: int, cost: CostModel) -> float:
    """Compute a lower bound on the makespan of any partition that prints a surface and a volume.

    In the best case, all of the surface is either horizontal skin or the flattest slope without skin. Cuts,
    supports, brims and minimum layer times only add to the time. At most `printer_count` parts share the
    work, and each part takes its fixed time in addition. The bound subtracts the time that each part saves
    because its inner walls are shorter than its outer walls, and because walls are printed instead of skin
    along the edges of its skin.

    Parameters
    ----------
    area_mm2, volume_mm3
        Area of the original surface, and volume of the solid that has to be printed.
    printer_count
        Maximum number of parts.
    cost
        Cost model for print times.

    Returns
    -------
    float
        Seconds.
    """
    slope_s_per_mm2 = cost.lateral_s_per_mm2 * math.sqrt(max(0.0, 1.0 - cost.skin_cos**2))
    surface_s = area_mm2 * min(slope_s_per_mm2, cost.skin_s_per_mm2)
    # Skin of area S costs c S - r sqrt(S), with the price c of skin in s/mm2 and that of its rim, r, in s/mm.
    # For any share k, this is at least (1 - k) c S - r^2 / (4 k c).
    rim_s = (
        cost.skin_rim_s_per_mm**2 / (4.0 * MAX_INSET_SHARE * cost.skin_s_per_mm2)
        if cost.skin_s_per_mm2
        else 0.0
    )
    shared_s = (1.0 - MAX_INSET_SHARE) * surface_s + cost.volume_s_per_mm3 * volume_mm3
    return cost.fixed_s + max(0.0, shared_s / printer_count - rim_s)
