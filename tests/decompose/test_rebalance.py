"""Rebalance by sliced times: the slow part ends sooner, and the partition stays valid."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from decompose import rebalance as rebalance_module
from decompose.best import rotate_about_z
from decompose.decompose import decompose_model
from decompose.engines.guillotine import shift_box_planes
from decompose.errors import GeometryError
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.pieces import cut_box, sort_pieces
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem
from decompose.rebalance import SlicedCuts, _cut_previous_boxes, rebalance_planes
from decompose.results import Attempt, Cutting, Decomposition, Part, finish_result

PRINTERS = tuple(TargetPrinter(name, ((220.0, 220.0, 200.0),)) for name in "abcd")
OPTIONS = Options(Engine.GUILLOTINE, 6, fit_first_layer=False, prove=False)
MODEL = Model(
    Solid.union([Solid.box((0, 0, 0), (400, 60, 60)), Solid.box((30, 20, 0), (130, 100, 90))]).rotate(
        Rotation.from_euler("z", 20.0, degrees=True).as_matrix()
    ),
    (),
    1.0,
)


@pytest.fixture(scope="module")
def decomposition(cost: CostModel) -> Decomposition:
    return decompose_model(MODEL, PRINTERS, OPTIONS, cost)


def pickle_and_unpickle(decomposition: Decomposition) -> Decomposition:
    """Return the object as it arrives from another process."""
    return pickle.loads(pickle.dumps(decomposition.without_parts()))  # type: ignore[no-any-return]


def make_times_s(decomposition: Decomposition, slow_part: int, factor: float = 1.2) -> np.ndarray:
    """Return sliced times of the parts, one of which exceeds its price by a factor."""
    seconds = np.array([part.price_s for part in decomposition.parts])
    seconds[slow_part] *= factor
    return seconds


def find_part_number(new_result: Decomposition, decomposition: Decomposition, slow_part: int) -> int:
    """Find the new number of a part whose borders have moved, because parts are numbered by position."""
    centre_mm = decomposition.parts[slow_part].solid.bounds_mm.mean(axis=0)
    return int(
        np.argmin([np.linalg.norm(p.solid.bounds_mm.mean(axis=0) - centre_mm) for p in new_result.parts])
    )


def make_cuts(decomposition: Decomposition, times_s: np.ndarray | None = None) -> SlicedCuts:
    """Return a decomposition with sliced times of its parts; by default, these are their prices."""
    times_s = make_times_s(decomposition, 0, 1.0) if times_s is None else times_s
    return SlicedCuts(pickle_and_unpickle(decomposition), times_s.tolist(), float(times_s.max()))


def rebalance(decomposition: Decomposition, times_s: np.ndarray, cost: CostModel) -> Decomposition | None:
    """Move the planes of a decomposition once."""
    return rebalance_planes(MODEL, [make_cuts(decomposition, times_s)], cost)


@pytest.mark.parametrize("slow_part", range(4))
def test_slow_part_gets_smaller(slow_part: int, decomposition: Decomposition, cost: CostModel) -> None:
    old_times_s = make_times_s(decomposition, slow_part)
    new_result = rebalance(decomposition, old_times_s, cost)
    assert new_result is not None
    number = find_part_number(new_result, decomposition, slow_part)
    assert make_times_s(new_result, number).max() < 0.97 * old_times_s.max()
    assert new_result.parts[number].price_s < decomposition.parts[slow_part].price_s
    assert new_result.coverage.surface_error < 1e-6
    assert sum(p.solid.volume_mm3 for p in new_result.parts) == pytest.approx(MODEL.solid.volume_mm3)


def test_planes_are_not_moved_for_a_gain_over_the_previous_result_alone(
    decomposition: Decomposition, cost: CostModel
) -> None:
    cuts, best_cuts = make_cuts(decomposition, make_times_s(decomposition, 1)), make_cuts(decomposition)
    assert rebalance_planes(MODEL, [cuts], cost) is not None
    assert rebalance_planes(MODEL, [replace(best_cuts, makespan_s=0.8 * cuts.makespan_s), cuts], cost) is None


def test_rebalance_with_true_prices_changes_nothing(decomposition: Decomposition, cost: CostModel) -> None:
    assert rebalance(decomposition, make_times_s(decomposition, 0, 1.0), cost) is None


def test_attempts_options_and_figures_are_kept(decomposition: Decomposition, cost: CostModel) -> None:
    attempts = (Attempt(Engine.GUILLOTINE, "auto", 15.0, 9.0),)
    old_result = replace(
        pickle_and_unpickle(decomposition),
        yaw_deg=15.0,
        attempts=attempts,
        options=replace(OPTIONS, engine=Engine.BEST),
    )
    new_result = rebalance(old_result, make_times_s(decomposition, 1), cost)
    assert new_result is not None
    assert (new_result.yaw_deg, new_result.attempts, new_result.options) == (
        15.0,
        attempts,
        old_result.options,
    )
    assert (new_result.serial_s, new_result.gap, new_result.cells) == (
        decomposition.serial_s,
        decomposition.gap,
        decomposition.cells,
    )
    assert new_result.cutting is not None


def test_second_rebalance_continues_from_the_first(decomposition: Decomposition, cost: CostModel) -> None:
    first_rebalance = rebalance(decomposition, make_times_s(decomposition, 1), cost)
    assert first_rebalance is not None
    slow_part = find_part_number(first_rebalance, decomposition, 1)
    # The parts are already balanced.
    assert rebalance(first_rebalance, make_times_s(first_rebalance, slow_part), cost) is None
    second_rebalance = rebalance(first_rebalance, make_times_s(first_rebalance, 2, 1.3), cost)
    assert second_rebalance is not None
    assert (
        make_times_s(second_rebalance, find_part_number(second_rebalance, first_rebalance, 2), 1.3).max()
        < make_times_s(first_rebalance, 2, 1.3).max()
    )


@pytest.mark.parametrize("time_factor", [1.0, 0.9, 1.1])
def test_planes_move_on_after_a_move_that_failed_and_then_back(time_factor: float, cost: CostModel) -> None:
    """Use a part that takes longer than before as soon as it becomes larger."""
    printers = tuple(replace(printer, time_factor=time_factor) for printer in PRINTERS)
    decomposition = decompose_model(MODEL, printers, OPTIONS, cost)
    first = make_cuts(decomposition, make_times_s(decomposition, 1))
    moved = rebalance_planes(MODEL, [first], cost)
    assert moved is not None and moved.cutting is not None and decomposition.cutting is not None
    neighbour = find_part_number(moved, decomposition, 2)
    failed = make_cuts(moved, make_times_s(moved, neighbour, 1.25))
    assert failed.makespan_s > first.makespan_s
    second = rebalance_planes(MODEL, [first, failed], cost)
    assert second is not None and second.cutting is not None
    relieved = find_part_number(second, moved, neighbour)
    assert second.parts[relieved].price_s < moved.parts[neighbour].price_s
    failed_again = make_cuts(second, make_times_s(second, relieved, 1.4))
    third = rebalance_planes(MODEL, [first, failed, failed_again], cost)
    assert third is not None and third.cutting is not None
    number = find_part_number(third, decomposition, 2)
    old_mm, failed_mm, new_mm = (
        np.ptp(result.parts[part].solid.bounds_mm, axis=0).max()
        for result, part in ((decomposition, 2), (moved, neighbour), (third, number))
    )
    assert old_mm < failed_mm
    assert new_mm <= old_mm + 0.5 * (failed_mm - old_mm) + 1e-6


def test_planes_move_again_from_where_they_were_best_if_they_cannot_move_on(
    decomposition: Decomposition, cost: CostModel
) -> None:
    """Use a failed round with a box that is there twice, whose planes cannot be moved."""
    first = make_cuts(decomposition, make_times_s(decomposition, 1))
    moved = rebalance_planes(MODEL, [first], cost)
    assert moved is not None and moved.cutting is not None
    broken_cutting = replace(moved.cutting, boxes_mm=moved.cutting.boxes_mm[[0, 0, 1, 2]])
    failed = replace(
        make_cuts(replace(moved, cutting=broken_cutting), make_times_s(moved, 0)),
        makespan_s=1.01 * first.makespan_s,
    )
    assert rebalance_planes(MODEL, [failed], cost) is None
    assert rebalance_planes(MODEL, [first, failed], cost) is not None


@pytest.mark.parametrize("error_count", [1, 4])
def test_move_that_breaks_a_rule_is_followed_by_another_one(
    error_count: int, decomposition: Decomposition, cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Use two starts and two minimum gains, and let the first results break a rule."""
    first = make_cuts(decomposition, make_times_s(decomposition, 1))
    moved = rebalance_planes(MODEL, [first], cost)
    assert moved is not None
    failed = make_cuts(moved, make_times_s(moved, find_part_number(moved, decomposition, 2), 1.25))
    assert failed.makespan_s > first.makespan_s
    calls = []

    def finish_with_errors(*args: Any) -> Decomposition:
        calls.append(args)
        if len(calls) <= error_count:
            raise GeometryError("wall", None, "thin")
        return finish_result(*args)

    monkeypatch.setattr(rebalance_module, "finish_result", finish_with_errors)
    if error_count == 1:
        assert rebalance_planes(MODEL, [first, failed], cost) is not None
        assert len(calls) == 2
    else:
        with pytest.raises(GeometryError, match="thin"):
            rebalance_planes(MODEL, [first, failed], cost)
        assert len(calls) == 4


def test_rotated_model_is_rebalanced_in_its_own_frame(cost: CostModel) -> None:
    from decompose.decompose import run_engine

    problem = rotate_about_z(Problem(MODEL, PRINTERS, cost, OPTIONS), -20.0)
    decomposition = run_engine(problem, lambda: (1.0, 1.0), MODEL.solid)
    new_result = rebalance(decomposition, make_times_s(decomposition, 1), cost)
    assert new_result is not None
    assert sum(p.solid.volume_mm3 for p in new_result.parts) == pytest.approx(MODEL.solid.volume_mm3)
    lo, hi = MODEL.solid.bounds_mm
    for part in new_result.parts:  # the parts are in the model's own frame
        assert (part.solid.bounds_mm[0] >= lo - 1e-6).all() and (part.solid.bounds_mm[1] <= hi + 1e-6).all()


@pytest.mark.parametrize("speed_step", [0.0, 0.03, 0.1])
def test_slow_part_ends_sooner_on_unequal_printers(speed_step: float, cost: CostModel) -> None:
    """Use uneven prices, so that printers must not be assigned by price."""
    printers = tuple(replace(printer, time_factor=1.0 + speed_step * i) for i, printer in enumerate(PRINTERS))
    factors = {printer.name: printer.time_factor for printer in printers}
    decomposition = decompose_model(MODEL, printers, OPTIONS, cost)
    old_times_s = make_times_s(decomposition, 0, 1.1)
    new_result = rebalance(decomposition, old_times_s, cost)
    assert new_result is not None and new_result.cutting is not None
    new_times_s = make_times_s(new_result, find_part_number(new_result, decomposition, 0), 1.1)

    def compute_end_s(parts: Sequence[Part], seconds: np.ndarray) -> float:
        return max(s * factors[part.printer] for part, s in zip(parts, seconds, strict=True))

    assert compute_end_s(new_result.parts, new_times_s) < 0.97 * compute_end_s(
        decomposition.parts, old_times_s
    )
    times_s = [s * factors[part.printer] for part, s in zip(new_result.parts, new_times_s, strict=True)]
    assert min(times_s) > 0.97 * max(times_s)
    assert len({part.printer for part in new_result.parts}) == len(new_result.parts)


def test_each_piece_of_a_box_keeps_its_time_ratio(cost: CostModel) -> None:
    """Use a U whose left leg is higher, so that it is second by height and first by position."""
    u_shape = Solid.union(
        [
            Solid.box((0, 0, 0), (200, 40, 60)),
            Solid.box((0, 0, 50), (40, 40, 150)),
            Solid.box((160, 0, 50), (200, 40, 110)),
        ]
    )
    problem = Problem(Model(u_shape, (), 1.0), PRINTERS[:3], cost, replace(OPTIONS, granularity=4))
    boxes_mm = np.array(
        [[[-1.0, -1.0, -1.0], [201.0, 41.0, 70.0]], [[-1.0, -1.0, 70.0], [201.0, 41.0, 151.0]]]
    )
    parts = sort_pieces(piece for box in boxes_mm for piece in cut_box(u_shape, *box))
    prices_s = [pose.price_s for pose in problem.find_poses(parts) if pose is not None]
    cutting = Cutting(4, np.eye(3), boxes_mm[[0, 1, 1]], (None,) * 3, PRINTERS[:3])
    result = _cut_previous_boxes(problem, cutting, [prices_s[0], 1.2 * prices_s[1], 1.1 * prices_s[2]])
    assert result is not None
    moved_pieces = shift_box_planes(problem, problem.build_grid(problem.model), boxes_mm, result)
    time_ratios = {bool(piece.solid.bounds_mm[0, 0] < 100.0): piece.time_ratio for piece in moved_pieces[1:]}
    assert time_ratios == pytest.approx({False: 1.2, True: 1.1})


def test_unrelated_parts_are_unchanged(decomposition: Decomposition, cost: CostModel) -> None:
    assert decomposition.cutting is not None
    assert rebalance(decomposition, make_times_s(decomposition, 0)[:-1], cost) is None
    repeated_cutting = replace(decomposition.cutting, boxes_mm=decomposition.cutting.boxes_mm[[0, 0, 1, 2]])
    assert (
        rebalance(replace(decomposition, cutting=repeated_cutting), make_times_s(decomposition, 0), cost)
        is None
    )


def test_parts_without_a_grid_are_unchanged(cost: CostModel) -> None:
    decomposition = decompose_model(MODEL, PRINTERS, replace(OPTIONS, engine=Engine.PARALLELOBOX), cost)
    assert decomposition.cutting is None
    assert rebalance(decomposition, make_times_s(decomposition, 0), cost) is None
