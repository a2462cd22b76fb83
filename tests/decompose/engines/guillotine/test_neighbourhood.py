"""Neighbourhood search: the result is a valid partition, never slower, not bound to guillotine cuts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from box_tables import Shape, every_box, tables
from decompose.engines.guillotine import Partitioner
from decompose.engines.guillotine.neighbourhood import (
    Window,
    improve_locally,
    list_pinwheel_boxes,
    sort_times_s,
)
from decompose.engines.guillotine.partitioner import UNREACHABLE
from decompose.grid import Box, BoxTables, box_index

shapes = st.tuples(st.integers(2, 5), st.integers(1, 4), st.integers(1, 3))


def cover(shape: Shape, chosen: list[Box]) -> np.ndarray:
    cells = np.zeros(shape, int)
    for x0, y0, z0, x1, y1, z1 in chosen:
        cells[x0:x1, y0:y1, z0:z1] += 1
    return cells


def count(boxes: BoxTables, chosen: list[Box]) -> int:
    return sum(int(boxes.pieces[box_index(box, boxes.shape)]) for box in chosen)


def feasible(boxes: BoxTables, limit_s: float) -> list[Box]:
    """Make a partition by guillotine cuts with the fewest parts at a high limit, far from the best."""
    solver = Partitioner(boxes)
    assume(solver.solve(limit_s) < UNREACHABLE)
    return solver.list_chosen_boxes()


@settings(max_examples=60, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), spare=st.integers(0, 3), share=st.floats(0.3, 1.2))
def test_improved_partition_is_valid_and_no_slower(shape: Shape, seed: int, spare: int, share: float) -> None:
    boxes, needed = tables(shape, seed)
    before = feasible(boxes, share * 130.0 * float(np.prod(shape)))
    assume(before)
    printers = count(boxes, before) + spare
    after = improve_locally(boxes, before, printers)
    assert count(boxes, after) <= printers
    cells = cover(shape, after)
    assert cells.max() <= 1
    assert (cells[needed] == 1).all()
    assert all(boxes.trimmed[box_index(box, shape)] == box_index(box, shape) for box in after)
    assert sort_times_s(boxes, after) <= sort_times_s(boxes, before)
    assert improve_locally(boxes, before, printers) == after


@settings(max_examples=60, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.1, 1.2))
def test_window_of_all_boxes_is_as_good_as_the_exact_search(shape: Shape, seed: int, share: float) -> None:
    boxes, needed = tables(shape, seed)
    assume(needed.any())
    limit_s = share * 130.0 * float(np.prod(shape))
    window = Window(boxes, [(0, 0, 0, *shape)], [])
    fewest = window.fewest_parts(limit_s)
    assert min(fewest, UNREACHABLE) <= Partitioner(boxes).solve(limit_s)
    if fewest < UNREACHABLE:
        chosen = window.list_chosen_boxes()
        assert count(boxes, chosen) == fewest
        assert (cover(shape, chosen)[needed] == 1).all()
        assert max(sort_times_s(boxes, chosen)) <= limit_s


def even(shape: Shape) -> BoxTables:
    """Tables in which every cell is needed and the time of a box is its number of cells."""
    total = int(np.prod([n * (n + 1) // 2 for n in shape]))
    seconds = np.zeros(total, np.float32)
    for box in every_box(shape):
        seconds[box_index(box, shape)] = np.prod(np.subtract(box[3:], box[:3]))
    return BoxTables(shape, seconds, np.arange(total, dtype=np.int32), np.ones(total, np.int16))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("mirrored", [0, 1])
def test_pinwheel_without_a_guillotine_cut_is_found(axis: int, mirrored: int) -> None:
    shape: list[int] = [3, 3, 3]
    shape[axis] = 1
    boxes = even((shape[0], shape[1], shape[2]))
    wheel = list_pinwheel_boxes(boxes.shape, (axis, mirrored, 1, 2, 1, 2))
    allowed = [box_index(box, boxes.shape) for box in wheel]
    boxes.seconds[[i for i in range(len(boxes.seconds)) if i not in allowed]] += 10.0
    boxes.seconds[box_index((0, 0, 0, *boxes.shape), boxes.shape)] = 40.0
    assert Partitioner(boxes).solve(2.0) >= UNREACHABLE
    assert sorted(improve_locally(boxes, [(0, 0, 0, *boxes.shape)], 5)) == sorted(wheel)
    assert improve_locally(boxes, [(0, 0, 0, *boxes.shape)], 1) == [(0, 0, 0, *boxes.shape)]


def test_face_is_moved_and_a_spare_printer_is_used() -> None:
    boxes = even((6, 2, 1))
    uneven: list[Box] = [(0, 0, 0, 5, 2, 1), (5, 0, 0, 6, 2, 1)]
    assert sort_times_s(boxes, improve_locally(boxes, uneven, 2)) == [6.0, 6.0]
    assert sort_times_s(boxes, improve_locally(boxes, uneven, 3)) == [4.0, 4.0, 4.0]


def test_l_shape_is_recut_between_other_boxes() -> None:
    """The slow box and its neighbours do not form a box; other boxes stay as they are."""
    boxes = even((4, 4, 1))
    other: Box = (2, 2, 0, 4, 4, 1)
    ell: list[Box] = [(0, 0, 0, 4, 2, 1), (0, 2, 0, 2, 4, 1)]
    boxes.seconds[box_index(other, boxes.shape)] = 0.5
    for box in every_box(boxes.shape):  # only the other way to cut the L ends sooner
        if box not in (other, (0, 0, 0, 2, 4, 1), (2, 0, 0, 4, 2, 1)):
            boxes.seconds[box_index(box, boxes.shape)] += 5.0
    boxes.seconds[box_index((0, 0, 0, 2, 4, 1), boxes.shape)] = 4.0
    assert sorted(improve_locally(boxes, [other, *ell], 3)) == [(0, 0, 0, 2, 4, 1), (2, 0, 0, 4, 2, 1), other]
