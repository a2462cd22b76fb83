"""Parts cut out of boxes that extend beyond the needed cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

from decompose.engines.guillotine.plane_shift.box_part import BoxPart
from decompose.engines.guillotine.plane_shift.part_cutter import PartCutter
from decompose.engines.guillotine.plane_shift.plane_moves import refine_needed_cells
from decompose.engines.guillotine.plane_shift.plane_shift import shift_planes
from decompose.geometry import Model, Solid
from decompose.grid import FlatFaces, NeededCells
from decompose.options import Engine, Interior, Options
from decompose.pieces import Piece, cut_box, cut_cells
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem

WALL_MM = 24.0
NO_FLAT_FACES = FlatFaces(np.zeros(0), np.zeros(0))


@pytest.fixture
def problem(cost: CostModel) -> Problem:
    """Make a problem with a block of 180 mm, of which only a wall must be printed, for six printers."""
    block = Solid.box((0.0, 0.0, 0.0), (180.0, 180.0, 180.0))
    options = Options(Engine.GUILLOTINE, 8, Interior.LEAVE, min_wall_mm=WALL_MM, fit_first_layer=False)
    printers = tuple(TargetPrinter(f"p{i}", ((220.0, 220.0, 200.0),)) for i in range(6))
    return Problem(Model(block, (), 1.0), printers, cost, options)


def test_parts_beside_the_hollow_are_as_thick_as_their_wall(problem: Problem) -> None:
    """Cut six walls of two cells, 45 mm; the last two have no plane that can move towards the hollow."""
    grid = problem.build_grid(problem.model)
    boxes = [(0, 0, 0, 8, 8, 2), (0, 0, 6, 8, 8, 8), (0, 0, 2, 2, 8, 6)]
    boxes += [(6, 0, 2, 8, 8, 6), (2, 0, 2, 6, 2, 6), (2, 6, 2, 6, 8, 6)]
    pieces_by_box = {box: cut_cells(problem.model.solid, grid, box) for box in boxes}
    pieces = shift_planes(problem, grid, pieces_by_box)
    assert all(WALL_MM <= np.ptp(piece.solid.bounds_mm[:, 1]) < 33.0 for piece in pieces[4:])
    boxes_mm = np.concatenate([piece.boxes_mm for piece in pieces])
    assert refine_needed_cells(problem, grid).is_partition(boxes_mm)
    assert sum(piece.solid.volume_mm3 for piece in pieces) < 0.85 * problem.model.solid.volume_mm3


def cut_half(problem: Problem, flat_faces: FlatFaces) -> tuple[Piece, ...]:
    """Cut a box of which only the half with x below 90 mm is needed, beside flat faces along x."""
    is_needed = np.ones((2, 1, 1), dtype=bool)
    is_needed[1] = False
    ends_mm = np.array([-1.0, 181.0])
    cells = NeededCells((np.array([-1.0, 90.0, 181.0]), ends_mm, ends_mm), is_needed)
    box_mm = np.array([[-1.0] * 3, [181.0] * 3])
    part = BoxPart(box_mm, tuple(cut_box(problem.model.solid, *box_mm)), (), math.inf)
    cutter = PartCutter(problem, [part], np.full(3, 5.0), cells, [flat_faces, NO_FLAT_FACES, NO_FLAT_FACES])
    (trimmed_part,) = cutter.trim_parts([part])
    assert (trimmed_part.box_mm == box_mm).all()
    assert cutter.trim_parts([trimmed_part])[0] is trimmed_part
    return trimmed_part.pieces


@pytest.mark.parametrize(
    ("flat_mm", "end_mm"), [(None, 90.0), (80.0, 90.0), (89.0, 91.0), (91.5, 93.5), (180.0, 90.0)]
)
def test_box_is_trimmed_to_its_needed_cells_but_not_beside_a_flat_face(
    flat_mm: float | None, end_mm: float, problem: Problem
) -> None:
    flat_faces = NO_FLAT_FACES if flat_mm is None else FlatFaces(np.array([flat_mm]), np.array([2.0]))
    (piece,) = cut_half(problem, flat_faces)
    assert piece.boxes_mm[0].tolist() == [[-1.0] * 3, [end_mm, 181.0, 181.0]]
    assert piece.solid.bounds_mm[1, 0] == pytest.approx(end_mm)
