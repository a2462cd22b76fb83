"""Exact search, which also shifts the planes of partitions with less work."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from decompose.engines.guillotine import exact_search
from decompose.engines.guillotine.exact_search import TIME_RANGES, ExactSearch
from decompose.engines.guillotine.partitioner import Partitioner
from decompose.errors import NoFit
from decompose.geometry import Model
from decompose.grid import Box, count_cuts, index_box
from decompose.options import Engine, Options
from decompose.pieces import Piece
from decompose.print_time import CostModel, Pose
from decompose.printers import TargetPrinter
from decompose.problem import Effort, Problem

PRINTERS = tuple(TargetPrinter(str(i), ((220.0, 220.0, 200.0),)) for i in range(7))


@pytest.fixture
def problem(ball: Model, cost: CostModel) -> Problem:
    options = Options(Engine.GUILLOTINE, 7, fit_first_layer=False, prove=False)
    return Problem(ball, PRINTERS, cost, options, is_thorough=True)


@pytest.fixture
def search_result(problem: Problem) -> tuple[ExactSearch, list[Box]]:
    grid = problem.build_grid(problem.model)
    search = ExactSearch(problem, grid, problem.price_boxes(grid), 0.0)
    return search, list(search.run())


def compute_work_s(search: ExactSearch, boxes: list[Box]) -> float:
    return float(sum(search.tables.seconds[index_box(box, search.tables.shape)] for box in boxes))


def test_partitions_within_looser_limits_are_complete_without_more_work(
    search_result: tuple[ExactSearch, list[Box]],
) -> None:
    search, best_partition = search_result
    results = [list(partition) for partition in search.list_looser_partitions(best_partition)]
    assert 0 < len(results) <= len(TIME_RANGES)
    assert len({frozenset(partition) for partition in [best_partition, *results]}) == len(results) + 1
    for partition in results:
        cover_count = np.zeros(search.grid.shape, dtype=np.int64)
        for a, b, c, d, e, f in partition:
            cover_count[a:d, b:e, c:f] += 1
        assert cover_count.max() == 1
        assert cover_count[search.grid.is_needed].all()
        assert sum(len(search.pieces_by_box[box]) for box in partition) <= len(PRINTERS)
    assert min(compute_work_s(search, partition) for partition in results) <= compute_work_s(
        search, best_partition
    )


def test_earliest_end_after_plane_shifts_is_chosen(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """Expect the second of the partitions within a looser limit."""
    ends_s: dict[int, float] = {}
    results: list[tuple[Piece, ...]] = []

    def record_partition(
        problem: Problem, grid: object, cut: dict[Box, list[Piece]], cells: object, best_s: float = 0.0
    ) -> list[Piece]:
        pieces = tuple(piece for pieces_of_box in cut.values() for piece in pieces_of_box)
        results.append(pieces)
        ends_s[id(pieces[0])] = (9.0, 8.0, 5.0, 7.0)[min(len(results), 4) - 1]
        return list(pieces)

    monkeypatch.setattr(exact_search, "shift_planes", record_partition)
    monkeypatch.setattr(Problem, "compute_makespan_s", lambda _, pieces: ends_s[id(pieces[0])])
    monkeypatch.setattr(ExactSearch, "compute_mean_s", lambda *_: 0.0)
    result = exact_search.cut_for_uniform_printers(problem)
    assert len(results) > 2
    assert result.pieces == results[2]


@pytest.mark.parametrize(("mean_ratio", "is_shifted"), [(1.0, True), (1.1, False)])
@pytest.mark.parametrize("time_factor", [1.0, 0.8])
def test_planes_move_only_if_the_mean_time_is_near_the_best_makespan(
    mean_ratio: float,
    is_shifted: bool,
    time_factor: float,
    problem: Problem,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Expect times of a printer with factor 1, like those of the pieces, as the makespan to beat."""
    printers = tuple(replace(printer, time_factor=time_factor) for printer in problem.printers)
    problem = replace(problem, printers=printers)
    pieces_by_shift: list[list[Piece]] = []
    best_known_times_s: list[float] = []

    def record_shift(
        problem: Problem, grid: object, cut: dict[Box, list[Piece]], cells: object, best_s: float = np.inf
    ) -> list[Piece]:
        pieces_by_shift.append([piece for pieces_of_box in cut.values() for piece in pieces_of_box])
        best_known_times_s.append(best_s)
        return pieces_by_shift[0]

    def find_longest_s() -> float:
        return max(pose.price_s for pose in problem.find_poses(pieces_by_shift[0]) if pose is not None)

    monkeypatch.setattr(exact_search, "shift_planes", record_shift)
    monkeypatch.setattr(ExactSearch, "compute_mean_s", lambda *_: mean_ratio * find_longest_s())
    exact_search.cut_for_uniform_printers(problem)
    assert (len(pieces_by_shift) > 1) == is_shifted
    assert best_known_times_s[0] == np.inf
    assert best_known_times_s[1:] == pytest.approx([find_longest_s()] * (len(pieces_by_shift) - 1))


def test_mean_time_counts_every_piece_of_a_box(search_result: tuple[ExactSearch, list[Box]]) -> None:
    search, boxes = search_result
    partition = {box: search.cut_box(box) for box in boxes}
    total_s = sum(search.true_times_s[box] for box in boxes)
    assert search.compute_mean_s(partition) == pytest.approx(total_s / len(boxes))
    partition[boxes[0]] = 2 * partition[boxes[0]]
    assert search.compute_mean_s(partition) == pytest.approx(total_s / (len(boxes) + 1))


@pytest.mark.parametrize(
    ("best_known_s", "budget_s", "thorough"),
    [(1.0, np.inf, True), (np.inf, 0.0, True), (np.inf, np.inf, False)],
)
def test_partitions_far_above_the_best_are_not_improved(
    best_known_s: float, budget_s: float, thorough: bool, problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse_to_list(self: ExactSearch, best_partition: list[Box]) -> Iterator[dict[Box, list[Piece]]]:
        raise AssertionError

    monkeypatch.setattr(ExactSearch, "list_looser_partitions", refuse_to_list)
    exact_search.cut_for_uniform_printers(
        replace(problem, best_known_s=best_known_s, effort=Effort(budget_s), is_thorough=thorough)
    )


def test_pieces_of_earlier_rounds_are_dropped_without_another_result(
    problem: Problem, search_result: tuple[ExactSearch, list[Box]], monkeypatch: pytest.MonkeyPatch
) -> None:
    search, partition = search_result
    assert len(search.pieces_by_box) > len(partition)
    monkeypatch.setattr(exact_search, "MAX_KEPT_FACES", 0)
    grid = problem.build_grid(problem.model)
    frugal_search = ExactSearch(problem, grid, problem.price_boxes(grid), 0.0)
    pieces_by_box = frugal_search.run()
    assert list(pieces_by_box) == partition
    assert set(frugal_search.pieces_by_box) == set(partition)
    assert sum(len(pieces) for pieces in pieces_by_box.values()) <= len(PRINTERS)


@pytest.mark.parametrize("budget_s", [np.inf, 0.0])
def test_corrected_piece_counts_need_few_solves(
    budget_s: float, problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check that each correction starts from the last makespan, with and without a budget."""
    corrections, max_solves = iter(range(10)), 2
    monkeypatch.setattr(
        ExactSearch, "_correct_piece_counts", lambda self, _: next(corrections, None) is not None
    )
    monkeypatch.setattr(ExactSearch, "_exclude_faulty_boxes", lambda self, _: False)
    monkeypatch.setattr(ExactSearch, "_compute_true_makespan_s", lambda self, _: self.min_s)
    monkeypatch.setattr(ExactSearch, "_improve_partition", lambda self, _: [])
    problem = replace(problem, effort=Effort(budget_s))
    grid = problem.build_grid(problem.model)
    tables = problem.price_boxes(grid)
    solver = Partitioner(tables)
    assert solver.find_min_makespan_s(len(PRINTERS), 1.0) is not None
    search = ExactSearch(problem, grid, tables, 1.0)
    search.run()
    assert search.solver.sum_count <= solver.sum_count + 10 * max_solves * count_cuts(tables.shape)
    assert problem.effort.is_cut_short == (budget_s == 0.0)


def test_search_ends_when_its_share_of_the_budget_is_spent(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Use corrections that never end once a first partition has been found."""
    corrections = 0

    def correct_after_first_call(self: ExactSearch, partition: list[Box]) -> bool:
        nonlocal corrections
        corrections += 1
        assert corrections < 1000
        return corrections > 1

    monkeypatch.setattr(ExactSearch, "_correct_piece_counts", correct_after_first_call)
    monkeypatch.setattr(ExactSearch, "_exclude_faulty_boxes", lambda self, _: False)
    monkeypatch.setattr(ExactSearch, "_compute_true_makespan_s", lambda self, _: 1e9)
    monkeypatch.setattr(ExactSearch, "_improve_partition", lambda self, _: [])
    effort = Effort(0.1)
    problem = replace(problem, effort=effort)
    grid = problem.build_grid(problem.model)
    ExactSearch(problem, grid, problem.price_boxes(grid), 1.0).run()
    assert effort.is_cut_short
    assert effort.spent_s < effort.budget_s


def test_box_without_a_pose_is_replaced(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a part of each partition have no pose, for more partitions than a search has rounds."""
    grid = problem.build_grid(problem.model)
    search = ExactSearch(problem, grid, problem.price_boxes(grid), 0.0)
    find_poses = Problem.find_poses
    failed_count = 0

    def find_poses_except_first(self: Problem, pieces: Sequence[Piece]) -> list[Pose | None]:
        nonlocal failed_count
        poses = find_poses(self, pieces)
        if pieces and failed_count <= exact_search.MAX_ROUNDS:
            failed_count += 1
            poses[0] = None
        return poses

    monkeypatch.setattr(Problem, "find_poses", find_poses_except_first)
    partition = search.run()
    assert failed_count > exact_search.MAX_ROUNDS
    assert partition and all(np.isfinite(search.true_times_s[box]) for box in partition)


def test_parts_without_a_pose_are_no_weak_joints(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    grid = problem.build_grid(problem.model)
    search = ExactSearch(problem, grid, problem.price_boxes(grid), 0.0)
    monkeypatch.setattr(Problem, "find_poses", lambda _, pieces: [None] * len(pieces))
    with pytest.raises(NoFit, match=r"(?s)^(?!.*glue)"):
        search.run()


def test_tables_get_only_true_prices_while_estimates_are_searched(
    problem: Problem, search_result: tuple[ExactSearch, list[Box]]
) -> None:
    search, _ = search_result
    search._estimate_prices()
    first_seconds = problem.price_boxes(search.grid).seconds
    changed = np.flatnonzero(search.tables.seconds != first_seconds)
    true_indices = {index_box(box, search.tables.shape) for box in search.true_times_s}
    assert len(changed) > 0 and set(changed.tolist()) <= true_indices
    assert (search.excess.estimates.seconds > search.tables.seconds).any()


def test_least_makespan_is_found_after_estimates_have_fallen(problem: Problem) -> None:
    grid = problem.build_grid(problem.model)
    search = ExactSearch(problem, grid, problem.price_boxes(grid), 0.0)
    assert search._solve(len(PRINTERS), 1.0) is not None
    for box in search.solver.list_chosen_boxes():
        search.excess.record(box, 3.0 * float(search.tables.seconds[index_box(box, search.tables.shape)]))
    search.excess.update_estimates()
    high_s = search._solve(len(PRINTERS), 1.0)
    assert high_s is not None
    # Other boxes show that the excess arises in those boxes alone.
    for box in search.solver.list_chosen_boxes() * 9:
        search.excess.record(box, 0.0)
    search._estimate_prices()
    low_s = search._solve(len(PRINTERS), 1.0)
    search.guess_s = None
    expected_s = search._solve(len(PRINTERS), 1.0)
    assert low_s is not None and expected_s is not None
    assert low_s == pytest.approx(expected_s, abs=2.0) and low_s < 0.96 * high_s
