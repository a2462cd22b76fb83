"""Rules for the moves of planes: stops of faces, and the minimum gain for each mm."""

from __future__ import annotations

import numpy as np
import pytest

from decompose.engines.guillotine import FaceStop, MoveRules, shift_box_planes
from decompose.geometry import Model, Solid
from decompose.options import Engine, Options
from decompose.pieces import cut_box
from decompose.print_time import CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter
from decompose.problem import Problem

PLANE_MM = 112.0
BOXES_MM = np.array(
    [[[-1.0, -1.0, -1.0], [PLANE_MM, 41.0, 41.0]], [[PLANE_MM, -1.0, -1.0], [201.0, 41.0, 41.0]]]
)


def move_plane(rules: MoveRules) -> float:
    """Cut a bar of 200 mm into unequal halves, move the plane between them, and return its position."""
    bar = Solid.box((0, 0, 0), (200, 40, 40))
    printers = [TargetPrinter(name, ((200.0, 200.0, 200.0),)) for name in "ab"]
    cost = CostModel.from_settings(PrintTimeSettings())
    problem = Problem(Model(bar, (), 1.0), printers, cost, Options(Engine.GUILLOTINE, 4, prove=False))
    pieces = [cut_box(bar, *box) for box in BOXES_MM]
    grid = problem.build_grid(problem.model)
    low_part, _ = shift_box_planes(problem, grid, BOXES_MM, pieces, rules=rules)
    return float(low_part.solid.bounds_mm[1, 0])


def test_plane_moves_to_the_middle_without_rules() -> None:
    assert move_plane(MoveRules()) == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize("box", [0, 1])
def test_plane_is_not_moved_past_a_stop_of_one_of_its_faces(box: int) -> None:
    stop = FaceStop(box, (1 - box, 0), 106.0, False)
    assert move_plane(MoveRules(stops=(stop,))) == pytest.approx(106.0, abs=0.1)


@pytest.mark.parametrize("face", [(0, 0), (1, 1)])
def test_stop_of_a_face_that_cannot_move_changes_nothing(face: tuple[int, int]) -> None:
    stop = FaceStop(0, face, 0.0, True)
    assert move_plane(MoveRules(stops=(stop,))) == move_plane(MoveRules())


def test_stop_in_the_other_direction_changes_nothing() -> None:
    stop = FaceStop(0, (1, 0), PLANE_MM, True)
    assert move_plane(MoveRules(stops=(stop,))) == move_plane(MoveRules())


def test_plane_stays_if_it_gains_less_than_the_minimum() -> None:
    assert move_plane(MoveRules(min_gain_s_per_mm=1e4)) == PLANE_MM
