"""Poses of pieces that hardly differ from pieces whose poses are known."""

from __future__ import annotations

import numpy as np
import pytest

from decompose.geometry import Model, Solid
from decompose.options import Options
from decompose.pieces import Piece, cut_box
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem, Work, keep_similar_poses, measure_similar_pose


def make_problem(solid: Solid, cost: CostModel) -> Problem:
    printer = TargetPrinter("one", ((100.0, 100.0, 100.0),))
    return Problem(Model(solid, (), 1.0), (printer,), cost, Options())


def cut_block(size_mm: tuple[float, float, float]) -> Piece:
    """Cut a block out of a larger one, so that it has cut faces."""
    (piece,) = cut_box(Solid.box((0.0, 0.0, 0.0), np.array(size_mm) + 5.0), (-1.0, -1.0, -1.0), size_mm)
    return piece


@pytest.mark.parametrize(("height_mm", "fits"), [(41.0, True), (60.0, True), (101.0, False)])
def test_pose_of_a_similar_piece_is_used_if_it_fits(cost: CostModel, height_mm: float, fits: bool) -> None:
    known_piece, piece = cut_block((60.0, 50.0, 40.0)), cut_block((60.0, 50.0, height_mm))
    problem = make_problem(known_piece.solid, cost)
    (known_pose,) = problem.find_poses([known_piece])
    assert known_pose is not None
    pose = measure_similar_pose(problem, piece, known_pose)
    assert (pose is not None) == fits
    if pose is not None:
        assert pose.to_model[:3, :3] == pytest.approx(known_pose.to_model[:3, :3])
        assert pose.price_s > known_pose.price_s
    assert measure_similar_pose(problem, piece, None) is None


def test_only_pieces_without_a_good_pose_are_posed(cost: CostModel) -> None:
    known_piece, *pieces = (cut_block((60.0, 50.0, z)) for z in (40.0, 41.0, 101.0))
    problem = make_problem(known_piece.solid, cost)
    (known_pose,) = problem.find_poses([known_piece])
    assert known_pose is not None
    keep_similar_poses(problem, pieces, [known_pose, known_pose])
    posed_count = problem.effort.done_units[Work.PIECE_POSED]
    similar_pose, missing_pose = problem.find_poses(pieces)
    assert similar_pose is not None
    assert similar_pose.to_model[:3, :3] == pytest.approx(known_pose.to_model[:3, :3])
    assert missing_pose is None
    assert problem.effort.done_units[Work.PIECE_POSED] == posed_count + 1
