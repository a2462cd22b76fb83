"""Prices of boxes that were not cut, estimated from those that were."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decompose.engines.guillotine.price_excess import SPREAD_SHARE, PriceExcess, add_box_sums
from decompose.geometry import Model
from decompose.grid import VOLUME, Box, BoxTables, Grid, find_box, index_box
from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem


@pytest.fixture
def priced_grid(ball: Model, cost: CostModel) -> tuple[Grid, BoxTables]:
    printers = (TargetPrinter("a", ((400.0, 400.0, 400.0),)),)
    problem = Problem(ball, printers, cost, Options(Engine.GUILLOTINE, 5, fit_first_layer=False, prove=False))
    grid = problem.build_grid(ball)
    return grid, problem.price_boxes(grid)


def list_boxes(shape: tuple[int, int, int]) -> list[Box]:
    spans = [[(lo, hi) for lo in range(n) for hi in range(lo + 1, n + 1)] for n in shape]
    return [(x[0], y[0], z[0], x[1], y[1], z[1]) for x, y, z in product(*spans)]


@given(
    st.tuples(*[st.integers(1, 4)] * 3),
    st.integers(0, 2**32 - 1),
)
def test_estimate_of_each_box_is_its_price_and_the_sum_of_its_cells(
    shape: tuple[int, int, int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    boxes, values_s = list_boxes(shape), rng.random(shape)
    seconds = rng.random(len(boxes)).astype(np.float32)
    seconds[0] = math.inf
    estimates_s = np.full(len(boxes), -1.0, np.float32)
    add_box_sums(seconds, values_s, estimates_s)
    for box in boxes:
        cells = tuple(slice(box[axis], box[axis + 3]) for axis in range(3))
        number = index_box(box, shape)
        assert estimates_s[number] == pytest.approx(seconds[number] + values_s[cells].sum())


def trim_box(tables: BoxTables, box: Box) -> Box:
    return find_box(int(tables.trimmed_box[index_box(box, tables.shape)]), tables.shape)


def find_volume_mm3(grid: Grid, box: Box) -> float:
    cells = tuple(slice(box[axis], box[axis + 3]) for axis in range(3))
    return float(grid.sums[(*cells, VOLUME)].sum())


def test_boxes_get_a_share_of_the_excess_by_their_common_solid(priced_grid: tuple[Grid, BoxTables]) -> None:
    grid, tables = priced_grid
    table_seconds = tables.seconds.copy()
    nx, ny, nz = grid.shape
    lower_box, middle_box, upper_box = (
        trim_box(tables, (0, 0, a, nx, ny, b)) for a, b in ((0, nz // 2), (1, nz - 1), (nz // 2, nz))
    )
    lower, middle, upper = (index_box(box, tables.shape) for box in (lower_box, middle_box, upper_box))
    excess = PriceExcess(grid, tables)
    excess.record(lower_box, float(table_seconds[lower]) + 1000.0)
    excess.update_estimates()
    common_mm3 = find_volume_mm3(grid, (0, 0, 1, nx, ny, nz // 2))
    added_s = [float(excess.estimates.seconds[box] - table_seconds[box]) for box in (lower, middle, upper)]
    share = SPREAD_SHARE * common_mm3 / find_volume_mm3(grid, lower_box)
    assert added_s == pytest.approx([1000.0, 1000.0 * share, 0.0], abs=0.5)
    # The tables themselves stay lower bounds: only the price of the box that was cut has changed.
    changed = np.flatnonzero(tables.seconds != table_seconds)
    assert changed.tolist() == [lower]


def test_true_price_replaces_an_estimate_that_is_too_high(priced_grid: tuple[Grid, BoxTables]) -> None:
    grid, tables = priced_grid
    nx, ny, nz = grid.shape
    whole_box, lower_box = (trim_box(tables, (0, 0, 0, nx, ny, end)) for end in (nz, nz // 2))
    whole, lower = index_box(whole_box, tables.shape), index_box(lower_box, tables.shape)
    lower_s = float(tables.seconds[lower])
    excess = PriceExcess(grid, tables)
    excess.record(lower_box, lower_s + 500.0)
    whole_s = float(tables.seconds[whole]) + 100.0
    excess.record(whole_box, whole_s)
    excess.update_estimates()
    assert excess.estimates.seconds[[whole, lower]] == pytest.approx([whole_s, lower_s + 500.0])
    copy = excess.copy(replace(tables, seconds=tables.seconds.copy()))
    assert np.array_equal(copy.estimates.seconds, excess.estimates.seconds)
    copy.update_estimates()
    assert np.array_equal(copy.estimates.seconds, excess.estimates.seconds)


def test_excluded_box_stays_excluded(priced_grid: tuple[Grid, BoxTables]) -> None:
    grid, tables = priced_grid
    nx, ny, nz = grid.shape
    spans = (0, nz // 2), (nz // 2, nz)
    boxes = [trim_box(tables, (0, 0, start, nx, ny, end)) for start, end in spans]
    excess = PriceExcess(grid, tables)
    excess.exclude(boxes[0])
    excess.record(boxes[1], math.inf)
    excess.update_estimates()
    indices = [index_box(box, tables.shape) for box in boxes]
    assert np.isinf(tables.seconds[indices]).all() and np.isinf(excess.estimates.seconds[indices]).all()
