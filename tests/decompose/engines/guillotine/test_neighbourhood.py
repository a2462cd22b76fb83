"""Neighbourhood search: the result is valid, never slower, and not limited to guillotine cuts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from books.box_tables import Shape, list_boxes, make_tables
from decompose.engines.guillotine import Partitioner
from decompose.engines.guillotine.neighbourhood import (
    Window,
    improve_locally,
    list_pinwheel_boxes,
    sort_times_s,
)
from decompose.engines.guillotine.partitioner import UNREACHABLE_COUNT
from decompose.grid import Box, BoxTables, index_box

shapes = st.tuples(st.integers(2, 5), st.integers(1, 4), st.integers(1, 3))


def count_cover(shape: Shape, partition: list[Box]) -> np.ndarray:
    cells = np.zeros(shape, int)
    for x0, y0, z0, x1, y1, z1 in partition:
        cells[x0:x1, y0:y1, z0:z1] += 1
    return cells


def count_pieces(tables: BoxTables, partition: list[Box]) -> int:
    return sum(int(tables.piece_counts[index_box(box, tables.shape)]) for box in partition)


def make_feasible_partition(tables: BoxTables, limit_s: float) -> list[Box]:
    """Make a partition by guillotine cuts with the fewest parts within a high time limit."""
    solver = Partitioner(tables)
    assume(solver.solve(limit_s) < UNREACHABLE_COUNT)
    return solver.list_chosen_boxes()


@settings(max_examples=60, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), spare=st.integers(0, 3), share=st.floats(0.3, 1.2))
def test_improved_partition_is_valid_and_no_slower(shape: Shape, seed: int, spare: int, share: float) -> None:
    tables, is_needed = make_tables(shape, seed)
    partition = make_feasible_partition(tables, share * 130.0 * float(np.prod(shape)))
    assume(partition)
    printers = count_pieces(tables, partition) + spare
    improved_partition = improve_locally(tables, partition, printers)
    assert count_pieces(tables, improved_partition) <= printers
    cells = count_cover(shape, improved_partition)
    assert cells.max() <= 1
    assert (cells[is_needed] == 1).all()
    assert all(
        tables.trimmed_box[index_box(box, shape)] == index_box(box, shape) for box in improved_partition
    )
    assert sort_times_s(tables, improved_partition) <= sort_times_s(tables, partition)
    assert improve_locally(tables, partition, printers) == improved_partition


@settings(max_examples=60, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.1, 1.2))
def test_window_of_all_boxes_is_as_good_as_the_exact_search(shape: Shape, seed: int, share: float) -> None:
    tables, is_needed = make_tables(shape, seed)
    assume(is_needed.any())
    limit_s = share * 130.0 * float(np.prod(shape))
    window = Window(tables, [(0, 0, 0, *shape)], [])
    min_count = window.count_fewest_parts(limit_s)
    assert min(min_count, UNREACHABLE_COUNT) <= Partitioner(tables).solve(limit_s)
    if min_count < UNREACHABLE_COUNT:
        partition = window.list_chosen_boxes()
        assert count_pieces(tables, partition) == min_count
        assert (count_cover(shape, partition)[is_needed] == 1).all()
        assert max(sort_times_s(tables, partition)) <= limit_s


def make_even_tables(shape: Shape) -> BoxTables:
    """Make tables in which every cell is needed and the time of a box is its number of cells."""
    total = int(np.prod([n * (n + 1) // 2 for n in shape]))
    seconds = np.zeros(total, np.float32)
    for box in list_boxes(shape):
        seconds[index_box(box, shape)] = np.prod(np.subtract(box[3:], box[:3]))
    return BoxTables(shape, seconds, np.arange(total, dtype=np.int32), np.ones(total, np.int16))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("mirrored_axis", [0, 1])
def test_pinwheel_without_a_guillotine_cut_is_found(axis: int, mirrored_axis: int) -> None:
    shape: list[int] = [3, 3, 3]
    shape[axis] = 1
    tables = make_even_tables((shape[0], shape[1], shape[2]))
    wheel = list_pinwheel_boxes(tables.shape, (axis, mirrored_axis, 1, 2, 1, 2))
    allowed_indices = [index_box(box, tables.shape) for box in wheel]
    tables.seconds[[i for i in range(len(tables.seconds)) if i not in allowed_indices]] += 10.0
    tables.seconds[index_box((0, 0, 0, *tables.shape), tables.shape)] = 40.0
    assert Partitioner(tables).solve(2.0) >= UNREACHABLE_COUNT
    assert sorted(improve_locally(tables, [(0, 0, 0, *tables.shape)], 5)) == sorted(wheel)
    assert improve_locally(tables, [(0, 0, 0, *tables.shape)], 1) == [(0, 0, 0, *tables.shape)]


def test_face_is_moved_and_a_spare_printer_is_used() -> None:
    tables = make_even_tables((6, 2, 1))
    uneven_boxes: list[Box] = [(0, 0, 0, 5, 2, 1), (5, 0, 0, 6, 2, 1)]
    assert sort_times_s(tables, improve_locally(tables, uneven_boxes, 2)) == [6.0, 6.0]
    assert sort_times_s(tables, improve_locally(tables, uneven_boxes, 3)) == [4.0, 4.0, 4.0]


def test_l_shape_is_recut_between_other_boxes() -> None:
    """Use a slow box that does not form a box with its neighbours; other boxes do not change."""
    tables = make_even_tables((4, 4, 1))
    other_box: Box = (2, 2, 0, 4, 4, 1)
    l_shaped_boxes: list[Box] = [(0, 0, 0, 4, 2, 1), (0, 2, 0, 2, 4, 1)]
    tables.seconds[index_box(other_box, tables.shape)] = 0.5
    for box in list_boxes(tables.shape):  # only the other way to cut the L ends sooner
        if box not in (other_box, (0, 0, 0, 2, 4, 1), (2, 0, 0, 4, 2, 1)):
            tables.seconds[index_box(box, tables.shape)] += 5.0
    tables.seconds[index_box((0, 0, 0, 2, 4, 1), tables.shape)] = 4.0
    assert sorted(improve_locally(tables, [other_box, *l_shaped_boxes], 3)) == [
        (0, 0, 0, 2, 4, 1),
        (2, 0, 0, 4, 2, 1),
        other_box,
    ]
