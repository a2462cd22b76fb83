"""Partitioner, compared with a plain recursion on random tables."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import combinations_with_replacement
from threading import Event

import numpy as np
import pytest
from hypothesis import assume, given, reject, settings
from hypothesis import strategies as st

from books.box_tables import Shape, make_tables
from decompose.engines.guillotine import Partitioner
from decompose.engines.guillotine.partitioner import OtherClass
from decompose.engines.guillotine.recursion import AREA_UNIT_MM2, UNREACHABLE_COUNT
from decompose.grid import Box, BoxTables, find_box, index_box
from decompose.grid.boxes import list_build_volumes
from decompose.pieces import solve_bottleneck_assignment
from decompose.printers import TargetPrinter

SortKey = tuple[int, int, int]  # parts, seconds, units of cut area
Parts = tuple[int, ...]  # of each class of printers


def find_best_by_recursion(tables: BoxTables, is_needed: np.ndarray, limit_s: float) -> SortKey:
    @cache
    def find_best(box: Box) -> SortKey:
        cells_inside = np.argwhere(is_needed[box[0] : box[3], box[1] : box[4], box[2] : box[5]])
        if not len(cells_inside):
            return 0, 0, 0
        lo, hi = cells_inside.min(axis=0) + box[:3], cells_inside.max(axis=0) + box[:3] + 1
        box = (*map(int, lo), *map(int, hi))  # type: ignore[assignment]
        index = index_box(box, tables.shape)
        results = [(UNREACHABLE_COUNT, 0, 0)]
        if tables.seconds[index] <= limit_s:
            results = [
                (
                    int(tables.piece_counts[index]),
                    round(tables.seconds[index]),
                    round(tables.cut_mm2[index] / AREA_UNIT_MM2),
                )
            ]
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                near_box, far_box = list(box), list(box)
                near_box[axis + 3] = far_box[axis] = plane
                a, b = find_best(tuple(near_box)), find_best(tuple(far_box))  # type: ignore[arg-type]
                results.append((a[0] + b[0], a[1] + b[1], a[2] + b[2]))
        return min(results)

    return find_best((0, 0, 0, *tables.shape))


def find_fewest_by_recursion(tables: BoxTables, is_needed: np.ndarray, limit_s: float) -> int:
    return find_best_by_recursion(tables, is_needed, limit_s)[0]


shapes = st.tuples(st.integers(1, 4), st.integers(1, 3), st.integers(1, 3))


@settings(max_examples=40, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.05, 1.2))
def test_part_count_at_a_time_limit_equals_that_of_a_recursion(shape: Shape, seed: int, share: float) -> None:
    tables, is_needed = make_tables(shape, seed)
    limit_s = share * 130.0 * float(np.prod(shape))
    solver = Partitioner(tables)
    expected_count = find_fewest_by_recursion(tables, is_needed, limit_s)
    for break_ties in (False, True):
        result = solver.solve(limit_s, break_ties)
        assert result == expected_count
    if result >= UNREACHABLE_COUNT:
        return
    partition = solver.list_chosen_boxes()
    assert sum(int(tables.piece_counts[index_box(b, shape)]) for b in partition) == result
    cover_count = np.zeros(shape, int)
    for x0, y0, z0, x1, y1, z1 in partition:
        cover_count[x0:x1, y0:y1, z0:z1] += 1
    assert cover_count.max(initial=0) <= 1
    assert (cover_count[is_needed] == 1).all()
    assert all(tables.seconds[index_box(b, shape)] <= limit_s for b in partition)


@settings(max_examples=40, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.2, 1.2), has_equal_costs=st.booleans())
def test_ties_are_broken_by_work_then_by_cut_area(
    shape: Shape, seed: int, share: float, has_equal_costs: bool
) -> None:
    tables, is_needed = make_tables(shape, seed)
    if has_equal_costs:  # then only the cut areas differ
        tables.seconds[np.isfinite(tables.seconds)] = 100.0
    limit_s = share * 130.0 * float(np.prod(shape))
    solver = Partitioner(tables)
    if solver.solve(limit_s, break_ties=True) >= UNREACHABLE_COUNT:
        return
    indices = [index_box(box, shape) for box in solver.list_chosen_boxes()]
    sort_key = (
        sum(int(tables.piece_counts[i]) for i in indices),
        sum(round(tables.seconds[i]) for i in indices),
        sum(round(tables.cut_mm2[i] / AREA_UNIT_MM2) for i in indices),
    )
    assert sort_key == find_best_by_recursion(tables, is_needed, limit_s)


@pytest.mark.parametrize("is_busy", [False, True])
@settings(max_examples=10, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), share=st.floats(0.2, 1.2))
def test_free_or_busy_executor_changes_no_solution(
    is_busy: bool, shape: Shape, seed: int, share: float
) -> None:
    tables, _ = make_tables(shape, seed)
    limit_s = share * 130.0 * float(np.prod(shape))
    serial_partitioner = Partitioner(tables)
    min_count = serial_partitioner.solve(limit_s, break_ties=True)
    release = Event()
    with ThreadPoolExecutor(1) as executor:
        if is_busy:
            executor.submit(release.wait)
        parallel_partitioner = Partitioner(tables, executor=executor)
        parallel_min_count = parallel_partitioner.solve(limit_s, break_ties=True)
        release.set()
    assert parallel_min_count == min_count
    assert (parallel_partitioner.counts == serial_partitioner.counts).all()
    if min_count < UNREACHABLE_COUNT:
        assert parallel_partitioner.list_chosen_boxes() == serial_partitioner.list_chosen_boxes()


@settings(max_examples=25, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), printers=st.integers(1, 6))
def test_minimum_makespan_equals_an_exhaustive_search(shape: Shape, seed: int, printers: int) -> None:
    tables, is_needed = make_tables(shape, seed)
    limits_s = np.unique(tables.seconds[np.isfinite(tables.seconds)])
    reachable_s = [t for t in limits_s if find_fewest_by_recursion(tables, is_needed, float(t)) <= printers]
    result = Partitioner(tables).find_min_makespan_s(printers, 0.0, tolerance_s=1e-3)
    if not is_needed.any() or not reachable_s:
        assert result is None
    else:
        assert result == pytest.approx(float(reachable_s[0]), abs=2e-3)


@settings(max_examples=25, deadline=None)
@given(
    shape=shapes,
    seed=st.integers(0, 10**6),
    printers=st.integers(1, 6),
    share=st.floats(0.0, 1.0),
    guess_ratio=st.floats(0.0, 4.0),
)
def test_minimum_makespan_is_independent_of_the_first_limits(
    shape: Shape, seed: int, printers: int, share: float, guess_ratio: float
) -> None:
    tables, _ = make_tables(shape, seed)
    makespan_s = Partitioner(tables).find_min_makespan_s(printers, 0.0, tolerance_s=1e-3)
    bound_s, guess_s = share * (makespan_s or 1.0), guess_ratio * (makespan_s or 1.0)
    partitioner = Partitioner(tables)
    assert partitioner.find_min_makespan_s(printers, bound_s, 1e-3, guess_s=guess_s) == (
        None if makespan_s is None else pytest.approx(makespan_s, abs=2e-3)
    )
    if makespan_s is not None:
        assert len(partitioner.list_chosen_boxes()) <= printers


def list_shares_by_recursion(
    classes: list[BoxTables], is_needed: np.ndarray, limit_s: float, max_count: int
) -> set[Parts]:
    """List all ways to distribute the parts of a partition among the classes, at most `max_count` to each."""

    @cache
    def find_shares(box: Box) -> frozenset[Parts]:
        cells_inside = np.argwhere(is_needed[box[0] : box[3], box[1] : box[4], box[2] : box[5]])
        if not len(cells_inside):
            return frozenset([(0,) * len(classes)])
        lo, hi = cells_inside.min(axis=0) + box[:3], cells_inside.max(axis=0) + box[:3] + 1
        box = (*map(int, lo), *map(int, hi))  # type: ignore[assignment]
        index = index_box(box, classes[0].shape)
        able_classes = [i for i, boxes in enumerate(classes) if boxes.seconds[index] <= limit_s]
        class_choices = combinations_with_replacement(able_classes, int(classes[0].piece_counts[index]))
        results = {tuple(item.count(i) for i in range(len(classes))) for item in class_choices}
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                near_box, far_box = list(box), list(box)
                near_box[axis + 3] = far_box[axis] = plane
                sides = find_shares(tuple(near_box)), find_shares(tuple(far_box))  # type: ignore[arg-type]
                results |= {tuple(np.add(a, b).tolist()) for a in sides[0] for b in sides[1]}
        return frozenset(share for share in results if max(share) <= max_count)

    return set(find_shares((0, 0, 0, *classes[0].shape)))


def make_classes(shape: Shape, seed: int, number: int) -> tuple[list[BoxTables], np.ndarray]:
    """Make tables of the same boxes for printers with different speeds, some with too little room."""
    tables, is_needed = make_tables(shape, seed)
    rng = np.random.default_rng(seed)
    results = []
    for _ in range(number):
        seconds = tables.seconds * np.float32(rng.uniform(0.5, 1.5))
        seconds[rng.random(len(seconds)) < 0.2] = np.inf
        results.append(replace(tables, seconds=seconds))
    return results, is_needed


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
    classes, is_needed = make_classes(shape, seed, 1 + len(counts))
    limit_s = share * 130.0 * float(np.prod(shape))
    solver = Partitioner(classes[0], [OtherClass(*item) for item in zip(classes[1:], counts, strict=True)])
    shares = list_shares_by_recursion(classes, is_needed, limit_s, max_count=12)
    feasible_counts = [
        parts_by_class[0]
        for parts_by_class in shares
        if all(n <= m for n, m in zip(parts_by_class[1:], counts, strict=True))
    ]
    expected_count = min(feasible_counts, default=UNREACHABLE_COUNT)
    for break_ties in (False, True):
        assert solver.solve(limit_s, break_ties) == expected_count
        if expected_count >= UNREACHABLE_COUNT:
            continue
        indices = [
            index_box(box, shape)
            for box in solver.list_chosen_boxes()
            for _ in range(classes[0].piece_counts[index_box(box, shape)])
        ]
        printers = [classes[0]] * expected_count + [
            c for c, n in zip(classes[1:], counts, strict=True) for _ in range(n)
        ]
        cover_count = np.zeros(shape, int)
        for x0, y0, z0, x1, y1, z1 in solver.list_chosen_boxes():
            cover_count[x0:x1, y0:y1, z0:z1] += 1
        assert cover_count.max(initial=0) <= 1
        assert (cover_count[is_needed] == 1).all()
        times_s = np.array([[table.seconds[i] for table in printers] for i in indices]).reshape(
            len(indices), len(printers)
        )
        assert (
            not len(indices)
            or solve_bottleneck_assignment(np.where(times_s <= limit_s, times_s, np.inf)) is not None
        )


@settings(max_examples=25, deadline=None)
@given(shape=shapes, seed=st.integers(0, 10**6), printers=st.integers(1, 4), other_count=st.integers(0, 2))
def test_more_printers_of_another_class_never_end_later(
    shape: Shape, seed: int, printers: int, other_count: int
) -> None:
    (first_tables, second_tables), _ = make_classes(shape, seed, 2)
    first_s = Partitioner(first_tables).find_min_makespan_s(printers, 0.0, tolerance_s=1e-3)
    partitioner = Partitioner(first_tables, [OtherClass(second_tables, other_count)])
    two_classes_s = partitioner.find_min_makespan_s(printers, 0.0, tolerance_s=1e-3)
    if first_s is not None:
        assert two_classes_s is not None
        assert two_classes_s <= first_s + 1e-3
        assert partitioner.find_min_makespan_s(printers, 0.0, max_s=0.5 * two_classes_s) is None


def cut_at_random(tables: BoxTables, box: Box, limit_s: float, rng: np.random.Generator) -> list[Box] | None:
    """Divide a box by random guillotine cuts until all boxes end in time; return None if that fails."""
    index = int(tables.trimmed_box[index_box(box, tables.shape)])
    if index < 0:
        return []
    box = find_box(index, tables.shape)
    if tables.seconds[index] <= limit_s and tables.piece_counts[index] == 1:
        return [box]
    cuts = [(axis, plane) for axis in range(3) for plane in range(box[axis] + 1, box[axis + 3])]
    if not cuts:
        return None
    axis, plane = cuts[rng.integers(len(cuts))]
    near_box, far_box = list(box), list(box)
    near_box[axis + 3] = far_box[axis] = plane
    sides = [cut_at_random(tables, tuple(side), limit_s, rng) for side in (near_box, far_box)]  # type: ignore[arg-type]
    return None if sides[0] is None or sides[1] is None else sides[0] + sides[1]


@settings(max_examples=40, deadline=None)
@given(shape=st.tuples(*[st.integers(1, 6)] * 3), seed=st.integers(0, 10**6), share=st.floats(0.05, 0.8))
def test_random_cuts_give_no_better_partition(shape: Shape, seed: int, share: float) -> None:
    tables, is_needed = make_tables(shape, seed)
    rng = np.random.default_rng(seed)
    result = cut_at_random(tables, (0, 0, 0, *shape), share * 130.0 * float(np.prod(shape)), rng)
    if result is None or not is_needed.any():
        reject()
    solver = Partitioner(tables)
    min_makespan_s = solver.find_min_makespan_s(len(result), 0.0, tolerance_s=1e-3)
    assert min_makespan_s is not None
    assert solver.find_longest_time_s() <= tables.find_longest_time_s(result)
    assert solver.solve(tables.find_longest_time_s(result)) <= len(result)


def make_greedy_partition(tables: BoxTables, printers: int) -> list[Box]:
    """Cut the slowest box at its best plane while printers are available."""

    def trim_box(box: list[int]) -> Box | None:
        index = int(tables.trimmed_box[index_box((*box,), tables.shape)])  # type: ignore[arg-type]
        return None if index < 0 else find_box(index, tables.shape)

    def get_seconds(box: Box) -> float:
        return float(tables.seconds[index_box(box, tables.shape)])

    def list_cuts(box: Box) -> list[list[Box]]:
        results = []
        for axis in range(3):
            for plane in range(box[axis] + 1, box[axis + 3]):
                near_box, far_box = list(box), list(box)
                near_box[axis + 3] = far_box[axis] = plane
                results.append([side for side in (trim_box(near_box), trim_box(far_box)) if side is not None])
        return results

    box_of_all = trim_box([0, 0, 0, *tables.shape])
    parts = [] if box_of_all is None else [box_of_all]
    while parts and sum(int(tables.piece_counts[index_box(box, tables.shape)]) for box in parts) < printers:
        slowest_box = max(parts, key=get_seconds)
        cuts = list_cuts(slowest_box)
        if not cuts:
            break
        parts.remove(slowest_box)
        parts += min(cuts, key=lambda sides: max(get_seconds(side) for side in sides))
    return parts


@settings(max_examples=40, deadline=None)
@given(shape=st.tuples(*[st.integers(1, 6)] * 3), seed=st.integers(0, 10**6), printers=st.integers(1, 12))
def test_greedy_cuts_give_no_better_partition(shape: Shape, seed: int, printers: int) -> None:
    tables, _ = make_tables(shape, seed)
    result = make_greedy_partition(tables, printers)
    assume(result and np.isfinite(tables.find_longest_time_s(result)))
    count = sum(int(tables.piece_counts[index_box(box, shape)]) for box in result)
    solver = Partitioner(tables)
    assert solver.find_min_makespan_s(count, 0.0, tolerance_s=1e-3) is not None
    assert solver.find_longest_time_s() <= tables.find_longest_time_s(result) + 1e-3


def rotate_tables(
    tables: BoxTables, axes: tuple[int, int, int], is_mirrored: tuple[bool, bool, bool]
) -> BoxTables:
    """Permute and mirror the axes of the tables of a model."""
    shape = (tables.shape[axes[0]], tables.shape[axes[1]], tables.shape[axes[2]])

    def rotate_box(box: Box) -> Box:
        lo, hi = list(box[:3]), list(box[3:])
        for axis in range(3):
            if is_mirrored[axis]:
                lo[axis], hi[axis] = tables.shape[axis] - box[axis + 3], tables.shape[axis] - box[axis]
        a, b, c = axes
        return lo[a], lo[b], lo[c], hi[a], hi[b], hi[c]

    new_index = np.array(
        [index_box(rotate_box(find_box(i, tables.shape)), shape) for i in range(len(tables.seconds))]
    )
    result = BoxTables(
        shape, *(np.empty_like(t) for t in (tables.seconds, tables.trimmed_box, tables.piece_counts))
    )
    result.seconds[new_index], result.piece_counts[new_index] = tables.seconds, tables.piece_counts
    result.trimmed_box[new_index] = np.where(tables.trimmed_box < 0, -1, new_index[tables.trimmed_box])
    return result


@settings(max_examples=40, deadline=None)
@given(
    shape=shapes,
    seed=st.integers(0, 10**6),
    axes=st.permutations(range(3)),
    is_mirrored=st.tuples(*[st.booleans()] * 3),
    printers=st.integers(1, 8),
)
def test_rotated_or_mirrored_model_takes_the_same_time(
    shape: Shape, seed: int, axes: list[int], is_mirrored: tuple[bool, bool, bool], printers: int
) -> None:
    tables, _ = make_tables(shape, seed)
    rotated_tables = rotate_tables(tables, (axes[0], axes[1], axes[2]), is_mirrored)
    times_s = [
        Partitioner(item).find_min_makespan_s(printers, 0.0, tolerance_s=1e-3)
        for item in (tables, rotated_tables)
    ]
    assert (times_s[0] is None) == (times_s[1] is None)
    assert times_s[0] is None or times_s[0] == pytest.approx(times_s[1], abs=2e-3)


def test_every_build_volume_limits_the_parts() -> None:
    volumes = list_build_volumes(
        [TargetPrinter("a", ((1.0, 2.0, 3.0),)), TargetPrinter("b", ((4.0, 5.0, 6.0), (7.0, 1.0, 1.0)))]
    )
    assert volumes.shape == (2, 2, 3)
    assert (volumes[0, 1] == -1.0).all()
