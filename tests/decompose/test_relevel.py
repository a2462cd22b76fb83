"""Relevel by sliced times: the slow part ends sooner, and the partition stays valid."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from decompose.best import rotate_about_z
from decompose.decompose import decompose_model
from decompose.engines.guillotine import shift_box_planes
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.pieces import cut_box, sort_pieces
from decompose.print_time import CostModel
from decompose.printers import PrinterRoom
from decompose.problem import Problem
from decompose.relevel import _cut_previous_boxes, relevel_planes
from decompose.results import Attempt, Cutting, Decomposition, Part

ROOMS = tuple(PrinterRoom(name, ((220.0, 220.0, 200.0),)) for name in "abcd")
OPTIONS = Options(Engine.GUILLOTINE, 6, fit_first_layer=False, prove=False)
MODEL = Model(
    Solid.union([Solid.box((0, 0, 0), (400, 60, 60)), Solid.box((30, 20, 0), (130, 100, 90))]).rotate(
        Rotation.from_euler("z", 20.0, degrees=True).as_matrix()
    ),
    (),
    1.0,
)


@pytest.fixture(scope="module")
def cut(cost: CostModel) -> Decomposition:
    return decompose_model(MODEL, ROOMS, OPTIONS, cost)


def pass_to_process(cut: Decomposition) -> Decomposition:
    """Return the object as it arrives from another process."""
    return pickle.loads(pickle.dumps(cut.without_parts()))  # type: ignore[no-any-return]


def took_s(cut: Decomposition, slow: int, times: float = 1.2) -> np.ndarray:
    """Return the parts' sliced times, with one slower than its price."""
    seconds = np.array([part.price_s for part in cut.parts])
    seconds[slow] *= times
    return seconds


def number_in(after: Decomposition, cut: Decomposition, slow: int) -> int:
    """Find the number of a part after its borders have moved, as parts are numbered by position."""
    at = cut.parts[slow].solid.bounds_mm.mean(axis=0)
    return int(np.argmin([np.linalg.norm(p.solid.bounds_mm.mean(axis=0) - at) for p in after.parts]))


@pytest.mark.parametrize("slow", range(4))
def test_slow_part_gets_smaller(slow: int, cut: Decomposition, cost: CostModel) -> None:
    before_s = took_s(cut, slow)
    after = relevel_planes(MODEL, pass_to_process(cut), before_s, cost)
    assert after is not None
    number = number_in(after, cut, slow)
    assert took_s(after, number).max() < 0.97 * before_s.max()
    assert after.parts[number].price_s < cut.parts[slow].price_s
    assert after.coverage.surface_error < 1e-6
    assert sum(p.solid.volume_mm3 for p in after.parts) == pytest.approx(MODEL.solid.volume_mm3)


def test_relevel_with_true_prices_changes_nothing(cut: Decomposition, cost: CostModel) -> None:
    assert relevel_planes(MODEL, pass_to_process(cut), took_s(cut, 0, 1.0), cost) is None


def test_reported_repairs_are_kept(cut: Decomposition, cost: CostModel) -> None:
    attempts = (Attempt(Engine.GUILLOTINE, "auto", 15.0, 9.0),)
    was = replace(
        pass_to_process(cut), yaw_deg=15.0, attempts=attempts, options=replace(OPTIONS, engine=Engine.BEST)
    )
    after = relevel_planes(MODEL, was, took_s(cut, 1), cost)
    assert after is not None
    assert (after.yaw_deg, after.attempts, after.options) == (15.0, attempts, was.options)
    assert (after.serial_s, after.gap, after.cells) == (cut.serial_s, cut.gap, cut.cells)
    assert after.cutting is not None


def test_second_relevel_continues_from_the_first(cut: Decomposition, cost: CostModel) -> None:
    first = relevel_planes(MODEL, pass_to_process(cut), took_s(cut, 1), cost)
    assert first is not None
    slow = number_in(first, cut, 1)
    assert relevel_planes(MODEL, pass_to_process(first), took_s(first, slow), cost) is None  # it is level
    twice = relevel_planes(MODEL, pass_to_process(first), took_s(first, 2, 1.3), cost)
    assert twice is not None
    assert took_s(twice, number_in(twice, first, 2), 1.3).max() < took_s(first, 2, 1.3).max()


def test_rotated_model_is_relevelled_in_its_own_frame(cost: CostModel) -> None:
    from decompose.decompose import _run_engine

    task = rotate_about_z(Problem(MODEL, ROOMS, cost, OPTIONS), -20.0)
    cut = _run_engine(task, serial=lambda: (1.0, 1.0))
    after = relevel_planes(MODEL, pass_to_process(cut), took_s(cut, 1), cost)
    assert after is not None
    assert sum(p.solid.volume_mm3 for p in after.parts) == pytest.approx(MODEL.solid.volume_mm3)
    lo, hi = MODEL.solid.bounds_mm
    for part in after.parts:  # in the model's own frame
        assert (part.solid.bounds_mm[0] >= lo - 1e-6).all() and (part.solid.bounds_mm[1] <= hi + 1e-6).all()


@pytest.mark.parametrize("faster", [0.0, 0.03, 0.1])
def test_slow_part_ends_sooner_on_unequal_printers(faster: float, cost: CostModel) -> None:
    """Prices are deliberately uneven, so printers must not be assigned by them."""
    rooms = tuple(replace(room, time_factor=1.0 + faster * i) for i, room in enumerate(ROOMS))
    factors = {room.name: room.time_factor for room in rooms}
    cut = decompose_model(MODEL, rooms, OPTIONS, cost)
    before_s = took_s(cut, 0, 1.1)
    after = relevel_planes(MODEL, pass_to_process(cut), before_s, cost)
    assert after is not None and after.cutting is not None
    after_s = took_s(after, number_in(after, cut, 0), 1.1)

    def ends_s(parts: Sequence[Part], seconds: np.ndarray) -> float:
        return max(s * factors[part.printer] for part, s in zip(parts, seconds, strict=True))

    assert ends_s(after.parts, after_s) < 0.97 * ends_s(cut.parts, before_s)
    times_s = [s * factors[part.printer] for part, s in zip(after.parts, after_s, strict=True)]
    assert min(times_s) > 0.97 * max(times_s)
    assert len({part.printer for part in after.parts}) == len(after.parts)


def test_each_piece_of_a_box_keeps_its_time_ratio(cost: CostModel) -> None:
    """The left leg of a U is higher: sorted by height it is second, by position first."""
    u = Solid.union(
        [
            Solid.box((0, 0, 0), (200, 40, 60)),
            Solid.box((0, 0, 50), (40, 40, 150)),
            Solid.box((160, 0, 50), (200, 40, 110)),
        ]
    )
    problem = Problem(Model(u, (), 1.0), ROOMS[:3], cost, replace(OPTIONS, granularity=4))
    boxes_mm = np.array(
        [[[-1.0, -1.0, -1.0], [201.0, 41.0, 70.0]], [[-1.0, -1.0, 70.0], [201.0, 41.0, 151.0]]]
    )
    parts = sort_pieces(piece for box in boxes_mm for piece in cut_box(u, *box))
    prices_s = [pose.price_s for pose in problem.find_poses(parts) if pose is not None]
    cutting = Cutting(4, np.eye(3), boxes_mm[[0, 1, 1]], (None,) * 3, ROOMS[:3])
    result = _cut_previous_boxes(problem, cutting, [prices_s[0], 1.2 * prices_s[1], 1.1 * prices_s[2]])
    assert result is not None
    moved = shift_box_planes(problem, problem.build_grid(problem.model), boxes_mm, result)
    slower = {bool(piece.solid.bounds_mm[0, 0] < 100.0): piece.time_ratio for piece in moved[1:]}
    assert slower == pytest.approx({False: 1.2, True: 1.1})


def test_unrelated_parts_are_unchanged(cut: Decomposition, cost: CostModel) -> None:
    assert cut.cutting is not None
    assert relevel_planes(MODEL, pass_to_process(cut), took_s(cut, 0)[:-1], cost) is None
    twice = replace(cut.cutting, boxes_mm=cut.cutting.boxes_mm[[0, 0, 1, 2]])
    assert relevel_planes(MODEL, replace(pass_to_process(cut), cutting=twice), took_s(cut, 0), cost) is None


def test_parts_without_a_grid_are_unchanged(cost: CostModel) -> None:
    cut = decompose_model(MODEL, ROOMS, replace(OPTIONS, engine=Engine.PARALLELOBOX), cost)
    assert cut.cutting is None
    assert relevel_planes(MODEL, pass_to_process(cut), took_s(cut, 0), cost) is None
