"""Shift of planes off the grid: the slowest part ends sooner and the partition stays valid.

The file is longer than others because all tests share the same blocks and the search that cuts them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.engines.guillotine.plane_shift import part_cutter, plane_shift
from decompose.engines.guillotine.plane_shift.box_part import BoxPart, find_longest_time_s
from decompose.engines.guillotine.plane_shift.part_cutter import PartCutter
from decompose.engines.guillotine.plane_shift.plane_moves import move_groups
from decompose.engines.guillotine.plane_shift.plane_shift import _PlaneShift, shift_planes
from decompose.geometry import Model, Solid
from decompose.grid import PLANE_CLEARANCE_MM, Box, NeededCells, find_flat_faces
from decompose.options import Engine, Interior, Options
from decompose.pieces import Piece, cut_box, cut_cells
from decompose.print_time import CostModel, Pose
from decompose.printers import TargetPrinter
from decompose.problem import Effort, Problem, Work

BOXES_MM = ((220.0, 220.0, 200.0),)


def make_problem(
    solid: Solid, cost: CostModel, printers: int, cells: int, interior: Interior = Interior.KEEP
) -> Problem:
    options = Options(Engine.GUILLOTINE, cells, interior, min_wall_mm=3.0, fit_first_layer=False)
    target_printers = tuple(TargetPrinter(f"p{i}", BOXES_MM) for i in range(printers))
    return Problem(Model(solid, (), 1.0), target_printers, cost, options)


def compute_longest_s(problem: Problem, pieces: list[Piece]) -> float:
    poses = zip(pieces, problem.find_poses(pieces), strict=True)
    return max(np.inf if pose is None else pose.price_s * piece.time_factor for piece, pose in poses)


def shift_boxes(problem: Problem, partition: list[Box]) -> tuple[list[Piece], list[Piece]]:
    """Return the pieces of a partition before and after the shift."""
    grid = problem.build_grid(problem.model)
    pieces_by_box = {box: cut_cells(problem.model.solid, grid, box) for box in partition}
    return [piece for pieces in pieces_by_box.values() for piece in pieces], shift_planes(
        problem, grid, pieces_by_box
    )


@pytest.fixture(scope="module")
def tapered_block() -> Solid:
    """Make a tapered block of 240 mm; one of its halves takes far longer than the other."""
    corners = np.array([[x, y, z] for x in (0.0, 240.0) for y in (0.0, 80.0) for z in (0.0, 80.0)])
    corners[4:, 1:] = corners[4:, 1:] * 0.3 + 28.0
    faces = [
        [0, 1, 2], [2, 1, 3], [4, 6, 5], [5, 6, 7], [0, 4, 1], [1, 4, 5],
        [2, 3, 6], [6, 3, 7], [0, 2, 4], [4, 2, 6], [1, 5, 3], [3, 5, 7],
    ]  # fmt: skip
    return Solid.from_arrays(corners, faces)


def test_tapered_block_is_cut_into_two_parts_of_equal_time(tapered_block: Solid, cost: CostModel) -> None:
    problem = make_problem(tapered_block, cost, 2, cells=2)
    nx, ny, nz = problem.build_grid(problem.model).shape
    middle = nx // 2
    old_pieces, new_pieces = shift_boxes(problem, [(0, 0, 0, middle, ny, nz), (middle, 0, 0, nx, ny, nz)])
    assert compute_longest_s(problem, new_pieces) < 0.95 * compute_longest_s(problem, old_pieces)
    times_s = [pose.price_s for pose in problem.find_poses(new_pieces) if pose is not None]
    assert max(times_s) <= 1.02 * min(times_s)
    assert sum(piece.solid.volume_mm3 for piece in new_pieces) == pytest.approx(tapered_block.volume_mm3)
    assert (
        new_pieces[0].boxes_mm[0, 1, 0] == new_pieces[1].boxes_mm[0, 0, 0] < old_pieces[0].boxes_mm[0, 1, 0]
    )


def test_other_parts_are_balanced_if_one_pose_would_get_worse(
    tapered_block: Solid, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Use a thin end that would need another pose if it were longer, so that the other cut moves."""
    problem = make_problem(tapered_block, cost, 3, cells=4)
    nx, ny, nz = problem.build_grid(problem.model).shape
    thirds = [0, nx // 3, 2 * nx // 3, nx]
    boxes = [(a, 0, 0, b, ny, nz) for a, b in pairwise(thirds)]
    end_mm = problem.build_grid(problem.model).planes[0][thirds[2]]
    find_pose = Problem.find_pose

    def worsen_pose(self: Problem, piece: Piece) -> Pose | None:
        result = find_pose(self, piece)
        is_longer = bool(piece.solid.bounds_mm[1, 0] > 239.0 and piece.solid.bounds_mm[0, 0] < end_mm - 0.1)
        return replace(result, price_s=10.0 * result.price_s) if result and is_longer else result

    monkeypatch.setattr(Problem, "find_pose", worsen_pose)
    old_pieces, new_pieces = shift_boxes(problem, boxes)
    assert compute_longest_s(problem, new_pieces) < 0.96 * compute_longest_s(problem, old_pieces)
    assert max(piece.solid.bounds_mm[0, 0] for piece in new_pieces) >= end_mm - 0.1


class RoundCounter:
    """Counter of the rounds of plane shifts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.started_count = 0
        take_steps = _PlaneShift._take_steps

        def count_round(shift: _PlaneShift, parts: list[BoxPart], slopes: np.ndarray) -> list[BoxPart]:
            self.started_count += 1
            return take_steps(shift, parts, slopes)

        monkeypatch.setattr(_PlaneShift, "_take_steps", count_round)


def make_halves(problem: Problem) -> list[Box]:
    nx, ny, nz = problem.build_grid(problem.model).shape
    return [(0, 0, 0, nx // 2, ny, nz), (nx // 2, 0, 0, nx, ny, nz)]


def start_shift(problem: Problem, partition: list[Box] | None = None) -> tuple[_PlaneShift, list[BoxPart]]:
    """Start the search for a partition of a model, or its halves; return it with the parts in their poses."""
    grid = problem.build_grid(problem.model)
    partition = make_halves(problem) if partition is None else partition
    pieces_by_box = {box: cut_cells(problem.model.solid, grid, box) for box in partition}
    boxes_mm = np.array([grid.find_bounds_mm(box) for box in pieces_by_box])
    cell_mm = np.array([np.diff(item).min() for item in grid.planes])
    cells = NeededCells(grid.planes, grid.is_needed)
    result = _PlaneShift(problem, cells, cell_mm, boxes_mm, list(pieces_by_box.values()))
    return result, result.pose_start_parts()


def test_planes_move_once_after_the_budget_is_spent(
    tapered_block: Solid, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    rounds = RoundCounter(monkeypatch)
    problem = replace(make_problem(tapered_block, cost, 2, cells=2), effort=Effort(0.0))
    old_pieces, new_pieces = shift_boxes(problem, make_halves(problem))
    assert compute_longest_s(problem, new_pieces) < 0.95 * compute_longest_s(problem, old_pieces)
    assert rounds.started_count == 1
    assert problem.effort.is_cut_short


def test_planes_stay_if_the_best_makespan_is_out_of_reach(tapered_block: Solid, cost: CostModel) -> None:
    search, parts = start_shift(make_problem(tapered_block, cost, 2, cells=2))
    longest_s = find_longest_time_s(parts)
    assert search.improve_parts(parts, 0.5 * longest_s) is parts
    assert search.improve_parts(parts, longest_s) is not parts


def test_poses_are_not_sought_for_parts_that_miss_the_best_makespan(
    tapered_block: Solid, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, parts = start_shift(make_problem(tapered_block, cost, 2, cells=2))
    moved_s = find_longest_time_s(search.improve_parts(parts))
    assert moved_s < 0.95 * find_longest_time_s(parts)
    rounds = RoundCounter(monkeypatch)
    for ratio, posed_counts in ((0.995, []), (1.001, [2])):  # neither is out of reach of the linear programme
        search, parts = start_shift(make_problem(tapered_block, cost, 2, cells=2))
        counts: list[int] = []
        monkeypatch.setattr(search.cutter, "pose_parts", lambda new, _, c=counts: c.append(len(new)) or new)
        rounds.started_count = 0
        new_parts = search.improve_parts(parts, ratio * moved_s)
        assert rounds.started_count > 0
        assert (counts, new_parts is parts) == (posed_counts, not posed_counts)


def test_last_round_prices_every_part(
    tapered_block: Solid, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plane_shift, "MAX_ROUNDS", 1)
    problem = replace(make_problem(tapered_block, cost, 2, cells=2), effort=Effort(0.0))
    old_pieces, new_pieces = shift_boxes(problem, make_halves(problem))
    assert compute_longest_s(problem, new_pieces) < 0.95 * compute_longest_s(problem, old_pieces)
    assert not problem.effort.is_cut_short


@pytest.mark.parametrize("is_faulty", [False, True])
def test_useless_round_is_not_repeated_after_the_budget_is_spent(
    is_faulty: bool, tapered_block: Solid, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Make every moved part ten times slower in its true pose, or give it faults."""
    problem = replace(make_problem(tapered_block, cost, 2, cells=2), effort=Effort(0.0))
    grid = problem.build_grid(problem.model)
    find_pose = Problem.find_pose

    def worsen_pose(self: Problem, piece: Piece) -> Pose | None:
        result = find_pose(self, piece)
        return result and replace(result, price_s=10.0 * result.price_s)

    pieces_by_box = {box: cut_cells(tapered_block, grid, box) for box in make_halves(problem)}
    problem.find_poses([piece for pieces in pieces_by_box.values() for piece in pieces])
    if is_faulty:
        monkeypatch.setattr(_PlaneShift, "_has_faults", lambda *_: True)
    else:
        monkeypatch.setattr(Problem, "find_pose", worsen_pose)
    rounds = RoundCounter(monkeypatch)
    shift_planes(problem, grid, pieces_by_box)
    assert rounds.started_count == 1
    assert problem.effort.is_cut_short


def test_fixed_longest_part_does_not_stop_other_faces(
    tapered_block: Solid, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Check that an identical round is not repeated."""
    shifts = []
    monkeypatch.setattr(
        _PlaneShift, "_take_steps", lambda _, parts, slopes: shifts.append(len(parts)) or [*parts]
    )
    problem = make_problem(tapered_block, cost, 2, cells=2)
    shift_boxes(problem, make_halves(problem))
    assert shifts == [2]


def test_only_the_face_that_slows_a_part_is_limited(tapered_block: Solid, cost: CostModel) -> None:
    problem = make_problem(tapered_block, cost, 2, cells=2)
    search, parts = start_shift(problem)
    (group,) = np.unique(search.groups[search.groups >= 0])
    box = parts[0].box_mm + np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    slower_part = replace(parts[0], box_mm=box, seconds=2.0 * parts[0].seconds)
    assert search.face_limits.limit_faces(parts, [slower_part, parts[1]], [0], 0.5)
    assert search.face_limits.limits_mm.tolist() == [[-math.inf, parts[0].box_mm[1, 0]]] * (group + 1)
    assert problem.effort.done_units[Work.FACE_MEASURED] > 0
    assert not search.face_limits.limit_faces(
        parts, [slower_part, parts[1]], [0], 0.5
    )  # its face is already limited
    search.face_limits.limits_mm[:] = -math.inf, math.inf
    assert not search.face_limits.limit_faces(parts, [slower_part, parts[1]], [], 0.5)
    assert np.isinf(search.face_limits.limits_mm).all()


@pytest.mark.parametrize("free_mm", [0.0, 8.0])
def test_time_that_jumps_limits_its_face_and_the_other_parts_still_improve(
    free_mm: float, monkeypatch: pytest.MonkeyPatch, cost: CostModel
) -> None:
    """Cut a bar for three printers, of which one part takes twice its time if a face moves too far."""
    bar = Solid.box((0.0, 0.0, 0.0), (300.0, 60.0, 60.0))
    problem = make_problem(bar, cost, 3, cells=6)
    grid = problem.build_grid(problem.model)
    ends_mm = [grid.planes[0][0], 90.0, 220.0, grid.planes[0][-1]]
    low_mm, high_mm = grid.find_bounds_mm((0, 0, 0, *grid.shape))
    boxes_mm = np.array(
        [[[a, *low_mm[1:]], [b, *high_mm[1:]]] for a, b in pairwise(ends_mm)], dtype=np.float64
    )
    pieces = [cut_box(bar, *box) for box in boxes_mm]
    search = _PlaneShift(
        problem, NeededCells(grid.planes, grid.is_needed), np.full(3, 50.0), boxes_mm, pieces
    )
    parts = search.pose_start_parts()
    cut = PartCutter.cut_in_old_poses

    def cut_with_jump(self: PartCutter, i: int, part: BoxPart, box_mm: np.ndarray) -> Any:
        new_part, poses = cut(self, i, part, box_mm)
        if i == 0 and abs(box_mm[1, 0] - boxes_mm[0, 1, 0]) > free_mm:
            poses = [replace(pose, price_s=2.0 * pose.price_s) for pose in poses if pose is not None]
        return new_part, poses

    monkeypatch.setattr(PartCutter, "cut_in_old_poses", cut_with_jump)
    new_parts = search.improve_parts(parts)
    assert 0.5 * free_mm <= new_parts[0].box_mm[1, 0] - parts[0].box_mm[1, 0] <= free_mm
    assert find_longest_time_s(new_parts) < 0.9 * find_longest_time_s(parts)


def test_new_pose_is_computed_once_and_recorded(
    tapered_block: Solid, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Give every part a new pose after its first move."""
    find_pose, posed_parts = Problem.find_pose, []

    def record_piece(self: Problem, piece: Piece) -> Pose | None:
        posed_parts.append(piece.solid)
        return find_pose(self, piece)

    monkeypatch.setattr(part_cutter, "measure_similar_pose", lambda *_: None)
    monkeypatch.setattr(Problem, "find_pose", record_piece)
    problem = make_problem(tapered_block, cost, 2, cells=2)
    old_pieces, new_pieces = shift_boxes(problem, make_halves(problem))
    assert new_pieces[0].solid is not old_pieces[0].solid
    assert len({*posed_parts}) == len(posed_parts) == problem.effort.done_units[Work.PIECE_POSED] > 4


def test_slower_of_two_printers_gets_less_work(tapered_block: Solid, cost: CostModel) -> None:
    problem = make_problem(tapered_block, cost, 2, cells=2)
    slow_printer, quick_printer = TargetPrinter("slow", BOXES_MM, 1.2), TargetPrinter("quick", BOXES_MM, 0.9)
    problem = replace(problem, printers=(slow_printer, quick_printer))
    grid = problem.build_grid(problem.model)
    nx, ny, nz = grid.shape
    pieces_by_box = {
        box: [replace(piece, printer=printer) for piece in cut_cells(tapered_block, grid, box)]
        for box, printer in (
            ((0, 0, 0, nx // 2, ny, nz), quick_printer),
            ((nx // 2, 0, 0, nx, ny, nz), slow_printer),
        )
    }
    before_s = compute_longest_s(problem, [piece for pieces in pieces_by_box.values() for piece in pieces])
    new_pieces = shift_planes(problem, grid, pieces_by_box)
    times_s = {p.printer: problem.find_pose(p).price_s * p.time_factor for p in new_pieces}  # type: ignore[union-attr]
    assert compute_longest_s(problem, new_pieces) < before_s
    assert times_s[quick_printer] == pytest.approx(times_s[slow_printer], rel=0.03)


def test_lid_moves_into_the_hollow_behind_it(cost: CostModel) -> None:
    """Use two cells of 45 mm in front of the hollow, where a wall of 24 mm is enough."""
    block = Solid.box((0.0, 0.0, 0.0), (180.0, 180.0, 180.0))
    problem = make_problem(block, cost, 6, cells=8, interior=Interior.LEAVE)
    problem = replace(problem, options=replace(problem.options, min_wall_mm=24.0))
    grid = problem.build_grid(problem.model)
    assert grid.shape == (8, 8, 8)
    assert not grid.is_needed[2:6, 2:6, 2:6].any()
    end_layers = [(0, 0, 0, 8, 8, 2), (0, 0, 6, 8, 8, 8)]
    walls = [(0, 0, 2, 2, 8, 6), (6, 0, 2, 8, 8, 6), (2, 0, 2, 6, 2, 6), (2, 6, 2, 6, 8, 6)]
    old_pieces, new_pieces = shift_boxes(problem, [*end_layers, *walls])
    assert compute_longest_s(problem, new_pieces) < 0.85 * compute_longest_s(problem, old_pieces)
    assert 24.0 <= new_pieces[0].boxes_mm[0, 1, 2] < 32.0


def test_next_search_continues_from_the_result_of_the_last(
    tapered_block: Solid, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Limit the reach of a search; with `thorough`, several searches reach the best position."""
    problem = replace(make_problem(tapered_block, cost, 2, cells=2), is_thorough=True)
    _, far_pieces = shift_boxes(problem, make_halves(problem))
    monkeypatch.setattr(plane_shift, "MAX_MOVE_SHARE", 0.05)
    old_pieces, new_pieces = shift_boxes(problem, make_halves(problem))
    assert compute_longest_s(problem, new_pieces) < 1.03 * compute_longest_s(problem, far_pieces)
    assert compute_longest_s(problem, new_pieces) < 0.95 * compute_longest_s(problem, old_pieces)
    _, quick_pieces = shift_boxes(replace(problem, is_thorough=False), make_halves(problem))
    assert compute_longest_s(problem, quick_pieces) > 1.05 * compute_longest_s(problem, new_pieces)


def test_planes_that_always_block_each_other_are_stopped_alone(
    tapered_block: Solid, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = make_problem(tapered_block, cost, 4, cells=4)
    length, width, height = problem.build_grid(problem.model).cells.shape
    search, parts = start_shift(problem, [(x, 0, 0, x + 2, width, height) for x in range(0, length, 2)])
    first_mm, second_mm, _ = search._find_positions_mm(search.start_boxes_mm)

    def pass_each_other(_: object, __: object, ___: object, step_mm: np.ndarray) -> tuple[np.ndarray, float]:
        shifts_mm = np.where(step_mm > 0.0, np.array([0.8, -0.8, 0.5]) * (second_mm - first_mm), 0.0)
        return move_groups(search.start_boxes_mm, search.groups, shifts_mm), 1.0

    monkeypatch.setattr(_PlaneShift, "_solve_step", pass_each_other)
    step_mm = np.full(3, 10.0)
    boxes_mm, expected_s = search._solve_valid_step(parts, np.zeros((4, 2, 3)), step_mm)
    assert expected_s == 1.0 and search.cells.is_partition(boxes_mm)
    assert step_mm.tolist() == [10.0, 0.0, 10.0]


def test_time_ratio_of_a_slice_is_used(tapered_block: Solid, cost: CostModel) -> None:
    problem = make_problem(tapered_block, cost, 2, cells=2)
    grid = problem.build_grid(problem.model)
    pieces_by_box = {
        box: [replace(piece, time_ratio=time_ratio) for piece in cut_cells(tapered_block, grid, box)]
        for box, time_ratio in zip(make_halves(problem), (1.0, 1.3), strict=True)
    }
    a, b = shift_planes(problem, grid, pieces_by_box)
    assert (a.time_ratio, b.time_ratio) == (1.0, 1.3)
    a_s, b_s = (pose.price_s for pose in problem.find_poses([a, b]) if pose is not None)
    assert a_s == pytest.approx(1.3 * b_s, rel=0.02)


def test_shifted_plane_keeps_its_distance_from_a_flat_face(cost: CostModel) -> None:
    """Check that no plane comes close to the shoulder where the thick end of a bar begins."""
    bar = Solid.union(
        [Solid.box((0.0, 0.0, 0.0), (300.0, 40.0, 40.0)), Solid.box((0.0, -20.0, -20.0), (95.0, 60.0, 60.0))]
    )
    problem = make_problem(bar, cost, 3, cells=4)
    nx, ny, nz = problem.build_grid(problem.model).shape
    thirds = [0, nx // 3, 2 * nx // 3, nx]
    old_pieces, new_pieces = shift_boxes(problem, [(a, 0, 0, b, ny, nz) for a, b in pairwise(thirds)])
    vertices, faces = bar.arrays()
    flats_mm = find_flat_faces(vertices[faces], 0).coordinates_mm
    new_planes_mm = {float(piece.boxes_mm[0, 0, 0]) for piece in new_pieces} - {
        float(piece.boxes_mm[0, 0, 0]) for piece in old_pieces
    }
    assert new_planes_mm
    assert all(np.abs(flats_mm - plane_mm).min() >= PLANE_CLEARANCE_MM - 1e-6 for plane_mm in new_planes_mm)
    assert compute_longest_s(problem, new_pieces) < compute_longest_s(problem, old_pieces)


def test_shifted_part_still_fits_its_printer(cost: CostModel) -> None:
    """Use a thin end that is faster to print, but already as long as a printer."""
    bar = Solid.union(
        [Solid.box((0.0, 10.0, 10.0), (280.0, 50.0, 50.0)), Solid.box((215.0, 0.0, 0.0), (400.0, 60.0, 60.0))]
    )
    problem = make_problem(bar, cost, 2, cells=8)
    grid = problem.build_grid(problem.model)
    nx, ny, nz = grid.shape
    index = int(np.searchsorted(grid.planes[0], 220.0)) - 1
    _, new_pieces = shift_boxes(problem, [(0, 0, 0, index, ny, nz), (index, 0, 0, nx, ny, nz)])
    assert all(pose is not None for pose in problem.find_poses(new_pieces))
    assert max(np.ptp(piece.solid.bounds_mm[:, 0]) for piece in new_pieces) <= 220.0


@settings(max_examples=3, deadline=None)
@given(corner=st.tuples(st.integers(1, 5), st.integers(1, 5), st.integers(1, 5)))
def test_shifted_planes_give_a_complete_and_no_slower_partition(
    ring_with_bar: Solid, cost: CostModel, corner: tuple[int, int, int]
) -> None:
    problem = make_problem(ring_with_bar, cost, 8, cells=6)
    grid = problem.build_grid(problem.model)
    nx, ny, nz = grid.shape
    x, y, z = (min(a, n - 1) for a, n in zip(corner, grid.shape, strict=True))
    left_boxes: list[Box] = [(0, 0, 0, x, y, nz), (0, y, 0, x, ny, z), (0, y, z, x, ny, nz)]
    partition: list[Box] = [*left_boxes, (x, 0, 0, nx, ny, z), (x, 0, z, nx, ny, nz)]
    partition = [box for box in partition if cut_cells(ring_with_bar, grid, box)]
    old_pieces, new_pieces = shift_boxes(problem, partition)
    assert len(new_pieces) <= len(old_pieces)
    assert compute_longest_s(problem, new_pieces) <= compute_longest_s(problem, old_pieces)
    assert sum(piece.solid.volume_mm3 for piece in new_pieces) == pytest.approx(ring_with_bar.volume_mm3)
    second_result = shift_boxes(problem, partition)[1]
    assert [p.boxes_mm.tolist() for p in second_result] == [p.boxes_mm.tolist() for p in new_pieces]
