"""Bound on the makespan, compared with brute force and the complete linear programme on random tables."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from books.box_tables import Shape, list_boxes, make_tables
from decompose.bound import bound_makespan, compute_surface_bound_s
from decompose.bound.makespan import TOLERANCE, Bound
from decompose.engines.guillotine import Partitioner
from decompose.geometry import Solid
from decompose.grid import Box, BoxTables, index_box
from decompose.print_time import CostModel, PrintTimeSettings, price_axis_poses_s

shapes = st.tuples(st.integers(1, 4), st.integers(1, 3), st.integers(1, 3))


def list_printable_boxes(tables: BoxTables) -> list[tuple[Box, float, int]]:
    """List all boxes that may be parts, with their times and numbers of pieces."""
    results = []
    for box in list_boxes(tables.shape):
        index = index_box(box, tables.shape)
        if tables.trimmed_box[index] == index and np.isfinite(tables.seconds[index]):
            results.append((box, float(tables.seconds[index]), int(tables.piece_counts[index])))
    return results


def compute_bound(tables: BoxTables, is_needed: np.ndarray, printers: int) -> tuple[Bound, float]:
    """Compute the bound, and the makespan of the best guillotine partition from which it started."""
    solver = Partitioner(tables)
    assume(is_needed.any())
    assume(solver.find_min_makespan_s(printers, 0.0, tolerance_s=1e-3) is not None)
    return bound_makespan(
        tables, is_needed, printers, solver.find_longest_time_s()
    ), solver.find_longest_time_s()


def find_min_makespan_by_recursion_s(tables: BoxTables, is_needed: np.ndarray, printers: int) -> float:
    """Search all sets of boxes that cover the needed cells, which include all partitions."""
    bits = {tuple(map(int, cell)): 1 << i for i, cell in enumerate(np.argwhere(is_needed))}
    choices = []
    for box, seconds, pieces in list_printable_boxes(tables):
        cells_inside = sum(
            bit for cell, bit in bits.items() if all(box[a] <= cell[a] < box[a + 3] for a in range(3))
        )
        choices.append((cells_inside, seconds, pieces))

    @cache
    def find_min_makespan_s(remaining: int, printer_count: int) -> float:
        if not remaining:
            return 0.0
        first_cell = remaining & -remaining
        return min(
            (
                max(seconds, find_min_makespan_s(remaining & ~cells_inside, printer_count - pieces))
                for cells_inside, seconds, pieces in choices
                if cells_inside & first_cell and pieces <= printer_count
            ),
            default=math.inf,
        )

    return find_min_makespan_s(sum(bits.values()), printers)


@settings(max_examples=40, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), printers=st.integers(1, 4))
def test_no_partition_is_below_the_bound(shape: Shape, seed: int, printers: int) -> None:
    tables, is_needed = make_tables(shape, seed)
    assume(is_needed.sum() <= 14)
    bound, makespan_s = compute_bound(tables, is_needed, printers)
    assert 0.0 < bound.seconds <= find_min_makespan_by_recursion_s(tables, is_needed, printers) <= makespan_s


@settings(max_examples=40, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), printers=st.integers(1, 12))
def test_weights_prove_the_bound(shape: Shape, seed: int, printers: int) -> None:
    """Check in exact integers that no box faster than the bound has the weight of an average part."""
    tables, is_needed = make_tables(shape, seed)
    bound, _ = compute_bound(tables, is_needed, printers)
    assert bound.weights.dtype == np.int64
    assert (bound.weights >= 0).all()
    assert not bound.weights[~is_needed].any()
    total = sum(bound.weights.ravel().tolist())
    for (x0, y0, z0, x1, y1, z1), seconds, pieces in list_printable_boxes(tables):
        if seconds < bound.seconds:
            assert sum(bound.weights[x0:x1, y0:y1, z0:z1].ravel().tolist()) * printers < pieces * total


@settings(max_examples=25, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), printers=st.integers(1, 6))
def test_bound_equals_that_of_the_complete_linear_programme(shape: Shape, seed: int, printers: int) -> None:
    """Solve the linear programme for all boxes at once, with at most one part per cell."""
    tables, is_needed = make_tables(shape, seed)
    bound, _ = compute_bound(tables, is_needed, printers)
    all_boxes = list_printable_boxes(tables)
    cells_inside = np.zeros((len(all_boxes), *shape))
    for row, ((x0, y0, z0, x1, y1, z1), _, _) in zip(cells_inside, all_boxes, strict=True):
        row[x0:x1, y0:y1, z0:z1] = 1.0
    cells_inside = cells_inside[:, is_needed]

    def is_refuted(limit_s: float) -> bool:
        rows = [i for i, (_, seconds, _) in enumerate(all_boxes) if seconds <= limit_s]
        parts = np.array([all_boxes[i][2] for i in rows], float)
        solution = linprog(-np.ones(cells_inside.shape[1]), cells_inside[rows], parts, bounds=(0.0, 1.0))
        return bool(-solution.fun > printers + 1e-3)

    limits_s = sorted(seconds for _, seconds, _ in all_boxes)
    proven_s = next(t for t in limits_s if not is_refuted(t))
    assert bound.seconds >= proven_s * (1.0 - 2.0 * TOLERANCE)


def test_row_of_equal_cells_is_bounded_by_the_longest_share() -> None:
    """Print seven cells on three printers, one of which must print three, even if boxes are divided."""
    shape = (7, 1, 1)
    tables, _ = make_tables(shape, 0)
    is_needed = np.ones(shape, bool)
    for box in list_boxes(shape):
        index = index_box(box, shape)
        tables.trimmed_box[index], tables.piece_counts[index] = index, 1
        tables.seconds[index] = 10.0 * (box[3] - box[0])
    assert bound_makespan(tables, is_needed, 3, 30.0).seconds == 30.0


def test_bound_stays_close_to_the_makespan_with_many_cells() -> None:
    """Use a grid that is too large for a simplex method."""
    tables, is_needed = make_tables((9, 8, 7), 3)
    solver = Partitioner(tables)
    assert solver.find_min_makespan_s(20, 0.0) is not None
    bound = bound_makespan(tables, is_needed, 20, solver.find_longest_time_s())
    assert 0.8 * solver.find_longest_time_s() <= bound.seconds <= solver.find_longest_time_s()


@settings(deadline=None)  # the first call compiles
@given(*[st.floats(3.0, 200.0)] * 3, st.integers(1, 9))
def test_slabs_of_a_block_never_end_before_the_bound(
    width_mm: float, depth_mm: float, height_mm: float, slabs: int
) -> None:
    """Include slabs so small that their skin is rim only and their walls are inset only."""
    cost = CostModel.from_settings(PrintTimeSettings(overhead_s=60.0))
    slab_s = price_axis_poses_s(*Solid.box((0, 0, 0), (width_mm, depth_mm, height_mm / slabs)).arrays(), cost)
    block = Solid.box((0, 0, 0), (width_mm, depth_mm, height_mm))
    assert slab_s.min() >= compute_surface_bound_s(block.area_mm2, block.volume_mm3, slabs, cost)
