"""Partitioner, compared with a plain recursion on random tables."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import assume, given, reject, settings
from hypothesis import strategies as st

from box_tables import Shape, tables
from decompose.engines.guillotine import Partitioner
from decompose.engines.guillotine.partitioner import OtherClass
from decompose.engines.guillotine.recursion import AREA_MM2, UNREACHABLE
from decompose.grid import Box, BoxTables, box_at, box_index
from decompose.grid.boxes import list_rooms
from decompose.pieces import assign_bottleneck
from decompose.printers import PrinterRoom

Worth = tuple[int, int, int]  # parts, seconds, units of cut area
Parts = tuple[int, ...]  # of each class of printers


def best_by_recursion(boxes: BoxTables, needed: np.ndarray, limit_s: float) -> Worth:
    @cache
    def best(box: Box) -> Worth:
        inside = np.argwhere(needed[box[0] : box[3], box[1] : box[4], box[2] : box[5]])
        if not len(inside):
            return 0, 0, 0
        lo, hi = inside.min(axis=0) + box[:3], inside.max(axis=0) + box[:3] + 1
        box = (*map(int, lo), *map(int, hi))  # type: ignore[assignment]
        at = box_index(box, boxes.shape)
        results = [(UNREACHABLE, 0, 0)]
        if boxes.seconds[at] <= limit_s:
            results = [(int(boxes.pieces[at]), round(boxes.seconds[at]), round(boxes.cut_mm2[at] / AREA_MM2))]
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                near, far = list(box), list(box)
                near[axis + 3] = far[axis] = plane
                a, b = best(tuple(near)), best(tuple(far))  # type: ignore[arg-type]
                results.append((a[0] + b[0], a[1] + b[1], a[2] + b[2]))
        return min(results)

    return best((0, 0, 0, *boxes.shape))


def fewest_by_recursion(boxes: BoxTables, needed: np.ndarray, limit_s: float) -> int:
    return best_by_recursion(boxes, needed, limit_s)[0]


shapes = st.tuples(st.integers(1, 4), st.integers(1, 3), st.integers(1, 3))


@settings(max_examples=40, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.05, 1.2))
def test_minimum_number_of_parts_at_a_time_limit(shape: Shape, seed: int, share: float) -> None:
    boxes, needed = tables(shape, seed)
    limit = share * 130.0 * float(np.prod(shape))
    solver = Partitioner(boxes)
    expected = fewest_by_recursion(boxes, needed, limit)
    for ties in (False, True):
        result = solver.solve(limit, ties)
        assert result == expected
    if result >= UNREACHABLE:
        return
    chosen = solver.list_chosen_boxes()
    assert sum(int(boxes.pieces[box_index(b, shape)]) for b in chosen) == result
    cover = np.zeros(shape, int)
    for x0, y0, z0, x1, y1, z1 in chosen:
        cover[x0:x1, y0:y1, z0:z1] += 1
    assert cover.max(initial=0) <= 1
    assert (cover[needed] == 1).all()
    assert all(boxes.seconds[box_index(b, shape)] <= limit for b in chosen)


@settings(max_examples=40, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.2, 1.2), alike=st.booleans())
def test_ties_are_broken_by_work_then_by_cut_area(shape: Shape, seed: int, share: float, alike: bool) -> None:
    boxes, needed = tables(shape, seed)
    if alike:  # so that only cuts decide
        boxes.seconds[np.isfinite(boxes.seconds)] = 100.0
    limit = share * 130.0 * float(np.prod(shape))
    solver = Partitioner(boxes)
    if solver.solve(limit, ties=True) >= UNREACHABLE:
        return
    at = [box_index(box, shape) for box in solver.list_chosen_boxes()]
    worth = (
        sum(int(boxes.pieces[i]) for i in at),
        sum(round(boxes.seconds[i]) for i in at),
        sum(round(boxes.cut_mm2[i] / AREA_MM2) for i in at),
    )
    assert worth == best_by_recursion(boxes, needed, limit)


@settings(max_examples=25, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), printers=st.integers(1, 6))
def test_minimum_makespan_equals_an_exhaustive_search(shape: Shape, seed: int, printers: int) -> None:
    boxes, needed = tables(shape, seed)
    limits = np.unique(boxes.seconds[np.isfinite(boxes.seconds)])
    reachable = [t for t in limits if fewest_by_recursion(boxes, needed, float(t)) <= printers]
    result = Partitioner(boxes).find_min_makespan(printers, 0.0, tolerance_s=1e-3)
    if not needed.any() or not reachable:
        assert result is None
    else:
        assert result == pytest.approx(float(reachable[0]), abs=2e-3)


@settings(max_examples=25, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), printers=st.integers(1, 6), share=st.floats(0.0, 1.0))
def test_minimum_makespan_is_independent_of_the_lower_bound(
    shape: Shape, seed: int, printers: int, share: float
) -> None:
    boxes, _ = tables(shape, seed)
    found = Partitioner(boxes).find_min_makespan(printers, 0.0, tolerance_s=1e-3)
    bound_s = share * (found or 1.0)
    near = Partitioner(boxes)
    assert near.find_min_makespan(printers, bound_s, 1e-3, is_near=True) == (
        None if found is None else pytest.approx(found, abs=2e-3)
    )
    if found is not None:
        assert len(near.list_chosen_boxes()) <= printers


def shares_by_recursion(
    classes: list[BoxTables], needed: np.ndarray, limit_s: float, most: int
) -> set[Parts]:
    """List all ways to distribute the parts of a partition among the classes, at most `most` to each."""

    @cache
    def find_shares(box: Box) -> frozenset[Parts]:
        inside = np.argwhere(needed[box[0] : box[3], box[1] : box[4], box[2] : box[5]])
        if not len(inside):
            return frozenset([(0,) * len(classes)])
        lo, hi = inside.min(axis=0) + box[:3], inside.max(axis=0) + box[:3] + 1
        box = (*map(int, lo), *map(int, hi))  # type: ignore[assignment]
        at = box_index(box, classes[0].shape)
        able = [i for i, boxes in enumerate(classes) if boxes.seconds[at] <= limit_s]
        takers = combinations_with_replacement(able, int(classes[0].pieces[at]))
        results = {tuple(item.count(i) for i in range(len(classes))) for item in takers}
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                near, far = list(box), list(box)
                near[axis + 3] = far[axis] = plane
                sides = find_shares(tuple(near)), find_shares(tuple(far))  # type: ignore[arg-type]
                results |= {tuple(np.add(a, b).tolist()) for a in sides[0] for b in sides[1]}
        return frozenset(share for share in results if max(share) <= most)

    return set(find_shares((0, 0, 0, *classes[0].shape)))


def make_classes(shape: Shape, seed: int, number: int) -> tuple[list[BoxTables], np.ndarray]:
    """Tables of the same boxes on printers of another speed that have no room for some of them."""
    boxes, needed = tables(shape, seed)
    rng = np.random.default_rng(seed)
    results = []
    for _ in range(number):
        seconds = boxes.seconds * np.float32(rng.uniform(0.5, 1.5))
        seconds[rng.random(len(seconds)) < 0.2] = np.inf
        results.append(replace(boxes, seconds=seconds))
    return results, needed


@settings(max_examples=60, deadline=None)
@given(
    shape=st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(1, 2)),
    seed=st.integers(0, 10**6),
    share=st.floats(0.05, 1.2),
    counts=st.lists(st.integers(0, 2), min_size=1, max_size=2),
)
def test_unequal_printers_match_an_exhaustive_distribution(
    shape: Shape, seed: int, share: float, counts: list[int]
) -> None:
    classes, needed = make_classes(shape, seed, 1 + len(counts))
    limit = share * 130.0 * float(np.prod(shape))
    solver = Partitioner(classes[0], [OtherClass(*item) for item in zip(classes[1:], counts, strict=True)])
    shares = shares_by_recursion(classes, needed, limit, most=12)
    within = [
        parts_by_class[0]
        for parts_by_class in shares
        if all(n <= m for n, m in zip(parts_by_class[1:], counts, strict=True))
    ]
    expected = min(within, default=UNREACHABLE)
    for ties in (False, True):
        assert solver.solve(limit, ties) == expected
        if expected >= UNREACHABLE:
            continue
        at = [
            box_index(box, shape)
            for box in solver.list_chosen_boxes()
            for _ in range(classes[0].pieces[box_index(box, shape)])
        ]
        printers = [classes[0]] * expected + [
            c for c, n in zip(classes[1:], counts, strict=True) for _ in range(n)
        ]
        cover = np.zeros(shape, int)
        for x0, y0, z0, x1, y1, z1 in solver.list_chosen_boxes():
            cover[x0:x1, y0:y1, z0:z1] += 1
        assert cover.max(initial=0) <= 1
        assert (cover[needed] == 1).all()
        times = np.array([[table.seconds[i] for table in printers] for i in at]).reshape(
            len(at), len(printers)
        )
        assert not len(at) or assign_bottleneck(np.where(times <= limit, times, np.inf)) is not None


@settings(max_examples=25, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), printers=st.integers(1, 4), others=st.integers(0, 2))
def test_more_printers_of_another_class_never_end_later(
    shape: Shape, seed: int, printers: int, others: int
) -> None:
    (first, second), _ = make_classes(shape, seed, 2)
    alone_s = Partitioner(first).find_min_makespan(printers, 0.0, tolerance_s=1e-3)
    both = Partitioner(first, [OtherClass(second, others)])
    both_s = both.find_min_makespan(printers, 0.0, tolerance_s=1e-3)
    if alone_s is not None:
        assert both_s is not None
        assert both_s <= alone_s + 1e-3
        assert both.find_min_makespan(printers, 0.0, max_s=0.5 * both_s) is None


def cut_at_random(boxes: BoxTables, box: Box, limit_s: float, rng: np.random.Generator) -> list[Box] | None:
    """Make a guillotine partition of a box by random cuts, down to boxes that end in time, or None."""
    at = int(boxes.trimmed[box_index(box, boxes.shape)])
    if at < 0:
        return []
    box = box_at(at, boxes.shape)
    if boxes.seconds[at] <= limit_s and boxes.pieces[at] == 1:
        return [box]
    cuts = [(axis, plane) for axis in range(3) for plane in range(box[axis] + 1, box[axis + 3])]
    if not cuts:
        return None
    axis, plane = cuts[rng.integers(len(cuts))]
    near, far = list(box), list(box)
    near[axis + 3] = far[axis] = plane
    sides = [cut_at_random(boxes, tuple(side), limit_s, rng) for side in (near, far)]  # type: ignore[arg-type]
    return None if sides[0] is None or sides[1] is None else sides[0] + sides[1]


@settings(max_examples=40, deadline=None)
@given(shape=st.tuples(*[st.integers(1, 6)] * 3), seed=st.integers(0, 10**6), share=st.floats(0.05, 0.8))
def test_random_cuts_give_no_better_partition(shape: Shape, seed: int, share: float) -> None:
    boxes, needed = tables(shape, seed)
    rng = np.random.default_rng(seed)
    result = cut_at_random(boxes, (0, 0, 0, *shape), share * 130.0 * float(np.prod(shape)), rng)
    if result is None or not needed.any():
        reject()
    solver = Partitioner(boxes)
    least = solver.find_min_makespan(len(result), 0.0, tolerance_s=1e-3)
    assert least is not None
    assert solver.longest_s() <= boxes.longest_s(result)
    assert solver.solve(boxes.longest_s(result)) <= len(result)


def greedy_partition(boxes: BoxTables, printers: int) -> list[Box]:
    """Cut the costliest box at its best plane as long as printers are left."""

    def trim(box: list[int]) -> Box | None:
        at = int(boxes.trimmed[box_index((*box,), boxes.shape)])  # type: ignore[arg-type]
        return None if at < 0 else box_at(at, boxes.shape)

    def seconds(box: Box) -> float:
        return float(boxes.seconds[box_index(box, boxes.shape)])

    def halves(box: Box) -> list[list[Box]]:
        results = []
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                near, far = list(box), list(box)
                near[axis + 3] = far[axis] = plane
                results.append([side for side in (trim(near), trim(far)) if side is not None])
        return results

    box_of_all = trim([0, 0, 0, *boxes.shape])
    parts = [] if box_of_all is None else [box_of_all]
    while parts and sum(int(boxes.pieces[box_index(box, boxes.shape)]) for box in parts) < printers:
        worst = max(parts, key=seconds)
        cuts = halves(worst)
        if not cuts:
            break
        parts.remove(worst)
        parts += min(cuts, key=lambda sides: max(seconds(side) for side in sides))
    return parts


@settings(max_examples=40, deadline=None)
@given(shape=st.tuples(*[st.integers(1, 6)] * 3), seed=st.integers(0, 10**6), printers=st.integers(1, 12))
def test_greedy_cuts_give_no_better_partition(shape: Shape, seed: int, printers: int) -> None:
    boxes, _ = tables(shape, seed)
    result = greedy_partition(boxes, printers)
    assume(result and np.isfinite(boxes.longest_s(result)))
    count = sum(int(boxes.pieces[box_index(box, shape)]) for box in result)
    solver = Partitioner(boxes)
    assert solver.find_min_makespan(count, 0.0, tolerance_s=1e-3) is not None
    assert solver.longest_s() <= boxes.longest_s(result) + 1e-3


def rotate_tables(
    boxes: BoxTables, axes: tuple[int, int, int], mirrored: tuple[bool, bool, bool]
) -> BoxTables:
    """Permute and mirror the axes of the tables of a model."""
    shape = (boxes.shape[axes[0]], boxes.shape[axes[1]], boxes.shape[axes[2]])

    def place(box: Box) -> Box:
        lo, hi = list(box[:3]), list(box[3:])
        for axis in range(3):
            if mirrored[axis]:
                lo[axis], hi[axis] = boxes.shape[axis] - box[axis + 3], boxes.shape[axis] - box[axis]
        a, b, c = axes
        return lo[a], lo[b], lo[c], hi[a], hi[b], hi[c]

    new_index = np.array([box_index(place(box_at(i, boxes.shape)), shape) for i in range(len(boxes.seconds))])
    result = BoxTables(shape, *(np.empty_like(t) for t in (boxes.seconds, boxes.trimmed, boxes.pieces)))
    result.seconds[new_index], result.pieces[new_index] = boxes.seconds, boxes.pieces
    result.trimmed[new_index] = np.where(boxes.trimmed < 0, -1, new_index[boxes.trimmed])
    return result


@settings(max_examples=40, deadline=None)
@given(
    shape=shapes,
    seed=st.integers(0, 10**6),
    axes=st.permutations(range(3)),
    mirrored=st.tuples(*[st.booleans()] * 3),
    printers=st.integers(1, 8),
)
def test_turned_or_mirrored_model_takes_the_same_time(
    shape: Shape, seed: int, axes: list[int], mirrored: tuple[bool, bool, bool], printers: int
) -> None:
    boxes, _ = tables(shape, seed)
    other = rotate_tables(boxes, (axes[0], axes[1], axes[2]), mirrored)
    times = [Partitioner(item).find_min_makespan(printers, 0.0, tolerance_s=1e-3) for item in (boxes, other)]
    assert (times[0] is None) == (times[1] is None)
    assert times[0] is None or times[0] == pytest.approx(times[1], abs=2e-3)


def test_every_room_limits_the_parts() -> None:
    rooms = list_rooms(
        [PrinterRoom("a", ((1.0, 2.0, 3.0),)), PrinterRoom("b", ((4.0, 5.0, 6.0), (7.0, 1.0, 1.0)))]
    )
    assert rooms.shape == (2, 2, 3)
    assert (rooms[0, 1] == -1.0).all()
