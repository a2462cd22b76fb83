"""Boxes that are trimmed to the needed cells in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decompose.engines.guillotine.plane_shift import trimming
from decompose.engines.guillotine.plane_shift.plane_moves import refine_needed_cells
from decompose.engines.guillotine.plane_shift.trimming import MARGIN_MM, trim_boxes
from decompose.geometry import Model, Solid
from decompose.grid import FlatFaces, NeededCells
from decompose.options import Engine, Interior, Options
from decompose.pieces import Piece, cut_cells
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem

WALL_MM = 24.0


@pytest.fixture
def problem(cost: CostModel) -> Problem:
    """Make a problem with a block of 180 mm, of which only a wall must be printed, for six printers."""
    block = Solid.box((0.0, 0.0, 0.0), (180.0, 180.0, 180.0))
    options = Options(Engine.GUILLOTINE, 8, Interior.LEAVE, min_wall_mm=WALL_MM, fit_first_layer=False)
    printers = tuple(TargetPrinter(f"p{i}", ((220.0, 220.0, 200.0),)) for i in range(6))
    return Problem(Model(block, (), 1.0), printers, cost, options)


def cut_walls(problem: Problem) -> tuple[np.ndarray, list[list[Piece]]]:
    """Cut six walls of two cells, 45 mm, out of the block; only the last two do not reach its corners."""
    grid = problem.build_grid(problem.model)
    boxes = [(0, 0, 0, 8, 8, 2), (0, 0, 6, 8, 8, 8), (0, 0, 2, 2, 8, 6)]
    boxes += [(6, 0, 2, 8, 8, 6), (2, 0, 2, 6, 2, 6), (2, 6, 2, 6, 8, 6)]
    pieces = [cut_cells(problem.model.solid, grid, box) for box in boxes]
    ratios = [[replace(piece, printer=problem.printers[0], time_ratio=2.0)] for (piece,) in pieces[4:]]
    return np.array([grid.find_bounds_mm(box) for box in boxes]), pieces[:4] + ratios


def test_walls_are_trimmed_and_cover_all_needed_cells(problem: Problem) -> None:
    boxes_mm, pieces = cut_walls(problem)
    cells = refine_needed_cells(problem, problem.build_grid(problem.model))
    trimmed_mm, trimmed_pieces = trim_boxes(problem, cells, boxes_mm, pieces)
    assert trimmed_pieces[:4] == pieces[:4]
    for (piece,) in trimmed_pieces[4:]:
        assert WALL_MM <= np.ptp(piece.solid.bounds_mm[:, 1]) < WALL_MM + MARGIN_MM + 4.0
        assert (piece.printer, piece.time_ratio) == (problem.printers[0], 2.0)
    assert cells.is_partition(trimmed_mm)
    assert (trimmed_mm == [piece.boxes_mm[0] for (piece,) in trimmed_pieces]).all()


def test_boxes_stay_if_trimmed_parts_are_slower_or_cannot_be_glued(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    boxes_mm, pieces = cut_walls(problem)
    cells = refine_needed_cells(problem, problem.build_grid(problem.model))
    weak_problem = replace(problem, options=replace(problem.options, min_glue_mm2=1e9))
    times_s = iter([10.0, 11.0])
    for failing_problem in (weak_problem, problem):
        same_boxes_mm, same_pieces = trim_boxes(failing_problem, cells, boxes_mm, pieces)
        assert (same_boxes_mm == boxes_mm).all()
        assert same_pieces == pieces
        monkeypatch.setattr(trimming, "compute_slowest_piece_s", lambda *_: next(times_s))
    assert next(times_s, None) is None


def test_box_without_solid_stays(problem: Problem) -> None:
    boxes_mm, pieces = cut_walls(problem)
    empty_mm = np.array([[[300.0] * 3, [310.0] * 3]])
    cells = refine_needed_cells(problem, problem.build_grid(problem.model))
    trimmed_mm, trimmed_pieces = trim_boxes(
        problem, cells, np.concatenate([boxes_mm, empty_mm]), [*pieces, []]
    )
    assert trimmed_mm[6].tolist() == empty_mm[0].tolist()
    assert trimmed_pieces[6] == []
    assert (trimmed_mm[4:6] != boxes_mm[4:6]).any()


@pytest.mark.parametrize(
    ("needed_mm", "flat_mm", "end_mm"),
    [
        (90.0, None, 90.0),
        (90.0, 80.0, 90.0),
        (90.0, 89.0, 91.0),
        (90.0, 91.5, 93.5),
        (90.0, 180.5, 90.0),
        (5.0, None, 181.0),  # only a sliver would remain
        (180.0, 180.0, 181.0),  # no position is clear of the flat face
    ],
)
def test_box_is_trimmed_to_its_needed_cells_but_not_beside_a_flat_face(
    needed_mm: float, flat_mm: float | None, end_mm: float
) -> None:
    is_needed = np.array([True, False]).reshape(2, 1, 1)
    ends_mm = np.array([-1.0, 181.0])
    cells = NeededCells((np.array([-1.0, needed_mm, 181.0]), ends_mm, ends_mm), is_needed)
    none = FlatFaces(np.zeros(0), np.zeros(0))
    flat_faces = none if flat_mm is None else FlatFaces(np.array([flat_mm]), np.array([2.0]))
    box_mm = np.array([[-1.0] * 3, [181.0] * 3])
    trimmed_mm = trimming._trim_box(box_mm, cells, [flat_faces, none, none])
    assert trimmed_mm.tolist() == [[-1.0] * 3, [end_mm, 181.0, 181.0]]
