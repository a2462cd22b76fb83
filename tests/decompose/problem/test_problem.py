"""End times of pieces on the printers of a problem, and proof of its bound."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from gc import collect
from weakref import ref

import numpy as np
import pytest

from decompose.decompose import decompose_model
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options, ParalleloboxOptions
from decompose.pieces import Piece
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem

BOXES_MM = ((100.0, 100.0, 100.0),)
OPTIONS = Options(
    Engine.GUILLOTINE,
    granularity=5,
    parallelobox=ParalleloboxOptions(tries=1),
    prove=False,
    fit_first_layer=False,
)


def make_fleet(*factors: float) -> list[TargetPrinter]:
    return [TargetPrinter(str(i), BOXES_MM, factor) for i, factor in enumerate(factors)]


def make_block(size_mm: float, printer: TargetPrinter | None = None) -> Piece:
    return Piece(Solid.box((0, 0, 0), (size_mm,) * 3), np.zeros((0, 4)), np.zeros((0, 2, 3)), printer)


def make_problem(cost: CostModel, printers: Sequence[TargetPrinter], **options: object) -> Problem:
    model = Model(Solid.box((0, 0, 0), (90, 90, 90)), (), 1.0)
    return Problem(model, tuple(printers), cost, replace(OPTIONS, **options))  # type: ignore[arg-type]


def compute_price_s(cost: CostModel, size_mm: float) -> float:
    (pose,) = make_problem(cost, make_fleet(1.0)).find_poses([make_block(size_mm)])
    assert pose is not None
    return pose.price_s


def test_longest_piece_goes_to_the_quickest_printer(cost: CostModel) -> None:
    problem = make_problem(cost, make_fleet(1.5, 0.5))
    short_s, long_s = compute_price_s(cost, 30.0), compute_price_s(cost, 60.0)
    expected_s = max(1.5 * short_s, 0.5 * long_s)
    slow_printer, quick_printer = problem.printers
    assert problem.compute_makespan_s([make_block(30.0), make_block(60.0)]) == pytest.approx(expected_s)
    assert problem.compute_makespan_s(
        [make_block(30.0, quick_printer), make_block(60.0, slow_printer)]
    ) == pytest.approx(expected_s)
    assert make_problem(cost, make_fleet(1.5)).compute_makespan_s([make_block(30.0)]) == pytest.approx(
        1.5 * short_s
    )


def test_pose_is_found_once_while_its_solid_is_in_use(
    cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, calls = make_problem(cost, make_fleet(1.0)), []
    find_pose = Problem.find_pose
    monkeypatch.setattr(
        Problem, "find_pose", lambda self, piece: calls.append(piece.boxes_mm) or find_pose(self, piece)
    )
    piece = make_block(30.0)
    assert problem.find_poses([piece, piece]) == 2 * problem.find_poses([piece])
    assert len(calls) == 1
    solid = ref(piece.solid)
    del piece
    collect()
    assert solid() is None  # the cache does not keep it


def test_time_of_a_part_that_does_not_fit_is_infinite(cost: CostModel) -> None:
    problem = make_problem(cost, make_fleet(1.0), prove=True)
    for pieces in ([make_block(130.0)], [make_block(30.0), make_block(30.0)]):
        assert problem.compute_makespan_s(pieces) == math.inf
        assert not problem.needs_proof(pieces)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_bound_is_proven_for_candidates_only(factor: float, cost: CostModel) -> None:
    """Expect a proof only of partitions that end no later than the best known one."""
    problem = make_problem(cost, make_fleet(factor, factor), prove=True)
    pieces = [make_block(30.0), make_block(60.0)]
    end_s = factor * compute_price_s(cost, 60.0)
    assert problem.needs_proof(pieces)
    assert replace(problem, best_known_s=end_s).needs_proof(pieces)
    assert replace(problem, best_known_s=1.001 * end_s).needs_proof(pieces)
    assert not replace(problem, best_known_s=0.999 * end_s).needs_proof(pieces)
    assert not replace(problem, options=OPTIONS).needs_proof(pieces)


@pytest.mark.parametrize("engine", [Engine.GUILLOTINE, Engine.PARALLELOBOX, Engine.CUBE_SKELETON])
def test_bound_scales_with_the_speed_of_the_printers(
    engine: Engine, ring_with_bar: Solid, cost: CostModel
) -> None:
    options = replace(OPTIONS, engine=engine, prove=True)
    model = Model(ring_with_bar, (), 1.0)
    normal_result, fast_result = (
        decompose_model(model, make_fleet(*[f] * 8), options, cost) for f in (1.0, 0.5)
    )
    assert fast_result.makespan_s == pytest.approx(0.5 * normal_result.makespan_s)
    assert fast_result.grid_makespan_s == pytest.approx(0.5 * normal_result.grid_makespan_s)
    assert fast_result.lower_bound_s == pytest.approx(0.5 * normal_result.lower_bound_s)
    assert fast_result.compute_possible_gain(make_fleet(*[0.5] * 8)) == pytest.approx(
        normal_result.compute_possible_gain(make_fleet(*[1.0] * 8))
    )


def test_bound_holds_on_unequal_printers_for_common_boxes(ring_with_bar: Solid, cost: CostModel) -> None:
    options = replace(OPTIONS, engine=Engine.PARALLELOBOX, prove=True)
    result = decompose_model(Model(ring_with_bar, (), 1.0), make_fleet(0.5, *[1.0] * 7), options, cost)
    equal_result = decompose_model(Model(ring_with_bar, (), 1.0), make_fleet(*[1.0] * 8), options, cost)
    assert 0.5 * equal_result.grid_makespan_s <= result.grid_makespan_s <= equal_result.grid_makespan_s
    assert 0.0 < result.lower_bound_s <= result.grid_makespan_s
    assert result.lower_bound_s == pytest.approx(0.5 * equal_result.lower_bound_s)


def test_reported_time_includes_every_attempt(ring_with_bar: Solid, cost: CostModel) -> None:
    options = replace(OPTIONS, engine=Engine.BEST)
    result = decompose_model(Model(ring_with_bar, (), 1.0), make_fleet(*[1.0] * 4), options, cost)
    assert result.attempts[0].compute_s > 0.0
    assert result.compute_s["total"] >= sum(item.compute_s for item in result.attempts)


@pytest.mark.parametrize("threads", [0, 1])
def test_started_work_is_done_once(threads: int, cost: CostModel) -> None:
    calls: list[int] = []
    with ThreadPoolExecutor(1) as executor:
        problem = replace(make_problem(cost, make_fleet(1.0)), executor=executor if threads else None)
        get_result = problem.start_work(lambda: calls.append(len(calls)) or len(calls))
        assert get_result() == get_result() == 1
    assert calls == [0]
