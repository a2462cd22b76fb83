"""The search against a plain recursion, on tables of invented costs."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from box_tables import Shape, tables
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.boxes import Box, Boxes, box_index, shared_rooms
from decompose.cost import PrinterRoom
from decompose.guillotine import AREA_MM2, UNREACHABLE, Partitioner

Worth = tuple[int, int, int]  # parts, seconds, units of cut area


def best_by_recursion(boxes: Boxes, needed: np.ndarray, limit_s: float) -> Worth:
    @cache
    def best(box: Box) -> Worth:
        inside = np.argwhere(needed[box[0] : box[3], box[1] : box[4], box[2] : box[5]])
        if not len(inside):
            return 0, 0, 0
        lo, hi = inside.min(axis=0) + box[:3], inside.max(axis=0) + box[:3] + 1
        box = (*map(int, lo), *map(int, hi))  # type: ignore[assignment]
        at = box_index(box, boxes.shape)
        found = [(UNREACHABLE, 0, 0)]
        if boxes.seconds[at] <= limit_s:
            found = [(int(boxes.pieces[at]), round(boxes.seconds[at]), round(boxes.cut_mm2[at] / AREA_MM2))]
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                near, far = list(box), list(box)
                near[axis + 3] = far[axis] = plane
                a, b = best(tuple(near)), best(tuple(far))  # type: ignore[arg-type]
                found.append((a[0] + b[0], a[1] + b[1], a[2] + b[2]))
        return min(found)

    return best((0, 0, 0, *boxes.shape))


def fewest_by_recursion(boxes: Boxes, needed: np.ndarray, limit_s: float) -> int:
    return best_by_recursion(boxes, needed, limit_s)[0]


shapes = st.tuples(st.integers(1, 4), st.integers(1, 3), st.integers(1, 3))


@settings(max_examples=40, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.05, 1.2))
def test_fewest_parts_at_a_limit(shape: Shape, seed: int, share: float) -> None:
    boxes, needed = tables(shape, seed)
    limit = share * 130.0 * float(np.prod(shape))
    solver = Partitioner(boxes)
    expected = fewest_by_recursion(boxes, needed, limit)
    for ties in (False, True):
        found = solver.parts(limit, ties)
        assert found == expected
    if found >= UNREACHABLE:
        return
    chosen = solver.chosen()
    assert sum(int(boxes.pieces[box_index(b, shape)]) for b in chosen) == found
    cover = np.zeros(shape, int)
    for x0, y0, z0, x1, y1, z1 in chosen:
        cover[x0:x1, y0:y1, z0:z1] += 1
    assert cover.max(initial=0) <= 1
    assert (cover[needed] == 1).all()
    assert all(boxes.seconds[box_index(b, shape)] <= limit for b in chosen)


@settings(max_examples=40, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.2, 1.2), alike=st.booleans())
def test_of_as_few_parts_the_least_work_then_the_least_cut(
    shape: Shape, seed: int, share: float, alike: bool
) -> None:
    boxes, needed = tables(shape, seed)
    if alike:  # so that only cuts decide
        boxes.seconds[np.isfinite(boxes.seconds)] = 100.0
    limit = share * 130.0 * float(np.prod(shape))
    solver = Partitioner(boxes)
    if solver.parts(limit, ties=True) >= UNREACHABLE:
        return
    at = [box_index(box, shape) for box in solver.chosen()]
    worth = (
        sum(int(boxes.pieces[i]) for i in at),
        sum(round(boxes.seconds[i]) for i in at),
        sum(round(boxes.cut_mm2[i] / AREA_MM2) for i in at),
    )
    assert worth == best_by_recursion(boxes, needed, limit)


@settings(max_examples=25, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), printers=st.integers(1, 6))
def test_least_makespan_is_least(shape: Shape, seed: int, printers: int) -> None:
    boxes, needed = tables(shape, seed)
    limits = np.unique(boxes.seconds[np.isfinite(boxes.seconds)])
    reachable = [t for t in limits if fewest_by_recursion(boxes, needed, float(t)) <= printers]
    found = Partitioner(boxes).least_makespan(printers, 0.0, tolerance_s=1e-3)
    if not needed.any() or not reachable:
        assert found is None
    else:
        assert found == pytest.approx(float(reachable[0]), abs=2e-3)


def test_all_rooms_count() -> None:
    rooms = shared_rooms(
        [PrinterRoom("a", ((1.0, 2.0, 3.0),)), PrinterRoom("b", ((4.0, 5.0, 6.0), (7.0, 1.0, 1.0)))]
    )
    assert rooms.shape == (2, 2, 3)
    assert (rooms[0, 1] == -1.0).all()
