"""Partitions with the least total print time, compared with all guillotine partitions of small grids."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from decompose.engines.guillotine.least_work import (
    MAX_PART_PRICE_SHARE,
    MAX_SOLUTIONS,
    LeastWorkSearch,
)
from decompose.grid import Box, BoxTables, Shape, find_box, index_box

LIMIT_S = 100.0
shapes = st.tuples(*[st.integers(1, 3)] * 3)


def make_tables(shape: Shape, seed: int) -> BoxTables:
    """Make tables in which larger boxes take longer, each with a random share; some contain two pieces."""
    random = np.random.default_rng(seed)
    count = int(np.prod([n * (n + 1) // 2 for n in shape]))
    boxes = [find_box(index, shape) for index in range(count)]
    cells = np.array([np.prod([box[a + 3] - box[a] for a in range(3)]) for box in boxes])
    seconds = (20.0 + 12.0 * cells * random.uniform(0.8, 1.2, count)).astype(np.float32)
    seconds[random.random(count) < 0.1] = np.inf
    piece_counts = random.choice([1, 1, 1, 2], count).astype(np.int16)
    return BoxTables(shape, seconds, np.arange(count, dtype=np.int32), piece_counts)


def find_least_totals_s(tables: BoxTables, min_s: float = 0.0) -> dict[int, float]:
    """Find the least total time of all guillotine partitions within the limits, by their number of parts."""

    @cache
    def partition(box: Box) -> dict[int, float]:
        index = index_box(box, tables.shape)
        seconds = float(tables.seconds[index])
        totals = {int(tables.piece_counts[index]): seconds} if min_s <= seconds <= LIMIT_S else {}
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                lower, upper = list(box), list(box)
                lower[axis + 3] = upper[axis] = plane
                for a, a_s in partition(tuple(lower)).items():
                    for b, b_s in partition(tuple(upper)).items():
                        totals[a + b] = min(totals.get(a + b, np.inf), a_s + b_s)
        return totals

    return partition((0, 0, 0, *tables.shape))


def count_pieces(tables: BoxTables, boxes: list[Box]) -> int:
    return sum(int(tables.piece_counts[index_box(box, tables.shape)]) for box in boxes)


def sum_seconds(tables: BoxTables, boxes: list[Box]) -> float:
    return float(sum(tables.seconds[index_box(box, tables.shape)] for box in boxes))


@given(shapes, st.integers(0, 2**32 - 1), st.integers(1, 12), st.sampled_from([0.0, 40.0, 60.0]))
def test_boxes_cover_the_grid_and_keep_to_the_limits(
    shape: Shape, seed: int, part_count: int, min_s: float
) -> None:
    tables = make_tables(shape, seed)
    boxes = LeastWorkSearch(tables).find_boxes((min_s, LIMIT_S), part_count)
    least_totals_s = find_least_totals_s(tables, min_s)
    if not boxes:  # even the highest price that was tried leads to more parts
        price_s = MAX_PART_PRICE_SHARE * LIMIT_S * (1.0 - 0.5 ** (MAX_SOLUTIONS - 1))
        counts = sorted(least_totals_s, key=lambda count: least_totals_s[count] + price_s * count)
        assert not counts or counts[0] > part_count
        return
    covered = np.zeros(shape, np.int64)
    for a, b, c, d, e, f in boxes:
        covered[a:d, b:e, c:f] += 1
    count = count_pieces(tables, boxes)
    assert (covered == 1).all() and count <= part_count
    times_s = [tables.seconds[index_box(box, shape)] for box in boxes]
    assert min_s <= min(times_s) and max(times_s) <= LIMIT_S
    # A solution for any price of a part has the least total among the partitions with as many parts.
    assert sum_seconds(tables, boxes) == pytest.approx(least_totals_s[count], rel=1e-5)


@given(st.integers(0, 2**32 - 1))
def test_number_of_parts_is_reached_where_a_price_leads_to_it(seed: int) -> None:
    tables = make_tables((3, 3, 3), seed)
    least_totals_s = find_least_totals_s(tables)
    assume(least_totals_s)
    free_count = min(least_totals_s, key=lambda count: least_totals_s[count])
    boxes = LeastWorkSearch(tables).find_boxes((0.0, LIMIT_S), free_count)
    assert count_pieces(tables, boxes) == free_count
    assert sum_seconds(tables, boxes) == pytest.approx(least_totals_s[free_count], rel=1e-5)


def test_no_boxes_if_the_limit_is_too_short() -> None:
    tables = make_tables((2, 2, 2), 0)
    assert LeastWorkSearch(tables).find_boxes((0.0, 1.0), 8) == []
