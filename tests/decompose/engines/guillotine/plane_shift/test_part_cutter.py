"""Parts that end inside their boxes, and slopes of the times of parts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from decompose.engines.guillotine.plane_shift.box_part import BoxPart
from decompose.engines.guillotine.plane_shift.part_cutter import PartCutter
from decompose.geometry import Model, Solid
from decompose.grid import FlatFaces, NeededCells
from decompose.options import Engine, Options
from decompose.pieces import cut_box
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem

NO_FLAT_FACES = FlatFaces(np.zeros(0), np.zeros(0))


@pytest.mark.parametrize(
    ("top_mm", "flat_mm", "end_mm"),
    [(80.0, None, 95.0), (89.0, None, 95.0), (91.0, None, 135.0), (91.0, 134.0, 136.0), (89.0, 96.0, 98.0)],
)
def test_side_inside_a_box_moves_only_to_cover_needed_cells(
    top_mm: float, flat_mm: float | None, end_mm: float, cost: CostModel
) -> None:
    """Use cells that are needed up to 90 mm along x, and above z = 90 mm up to 135 mm."""
    printer = TargetPrinter("p", ((220.0, 220.0, 200.0),))
    model = Model(Solid.box((0.0, 0.0, 0.0), (180.0, 180.0, 180.0)), (), 1.0)
    problem = Problem(model, (printer,), cost, Options(Engine.GUILLOTINE, 4))
    is_needed = np.zeros((3, 1, 2), dtype=bool)
    is_needed[0] = is_needed[1, :, 1] = True
    planes = np.array([-1.0, 90.0, 135.0, 181.0]), np.array([-1.0, 181.0]), np.array([-1.0, 90.0, 181.0])
    cut_box_mm = np.array([[-1.0, -1.0, -1.0], [95.0, 181.0, 80.0]])
    pieces = [replace(piece, printer=printer, time_ratio=1.5) for piece in cut_box(model.solid, *cut_box_mm)]
    box_mm = np.array([[-1.0, -1.0, -1.0], [181.0, 181.0, 80.0]])
    flat_faces = NO_FLAT_FACES if flat_mm is None else FlatFaces(np.array([flat_mm]), np.array([2.0]))
    cutter = PartCutter(
        problem,
        [BoxPart(box_mm, tuple(pieces), (), math.inf)],
        np.full(3, 20.0),
        NeededCells(planes, is_needed),
        [flat_faces, NO_FLAT_FACES, NO_FLAT_FACES],
    )
    moved_mm = box_mm.copy()
    moved_mm[1, 2] = top_mm
    part = cutter.cut_part(0, moved_mm)
    assert (part.box_mm == moved_mm).all()
    assert part.cut_box_mm.tolist() == [[-1.0, -1.0, -1.0], [end_mm, 181.0, top_mm]]
    (piece,) = part.pieces
    assert piece.solid.bounds_mm[1].tolist() == pytest.approx([end_mm, 180.0, top_mm])
    assert (piece.printer, piece.time_ratio) == (printer, 1.5)


def test_slopes_are_those_of_the_slowest_piece_on_its_printer(cost: CostModel) -> None:
    """Cut two blocks of unequal length, 20 and 30 mm wide, at one plane."""
    printer = TargetPrinter("p", ((220.0, 220.0, 200.0),), time_factor=1.2)
    blocks = [Solid.box((0.0, 0.0, 0.0), (60.0, 20.0, 20.0)), Solid.box((0.0, 40.0, 0.0), (50.0, 70.0, 30.0))]
    model = Model(Solid.union(blocks), (), 1.0)
    problem = Problem(model, (printer,), cost, Options(Engine.GUILLOTINE, 4))
    box_mm = np.array([[-1.0, -1.0, -1.0], [40.0, 80.0, 35.0]])
    pieces = [replace(piece, printer=printer, time_ratio=1.5) for piece in cut_box(model.solid, *box_mm)]
    part = BoxPart(box_mm, tuple(pieces), (), math.inf).with_poses(problem.find_poses(pieces))
    planes = (np.array([-1.0, 41.0]), np.array([-1.0, 80.0]), np.array([-1.0, 35.0]))
    cells = NeededCells(planes, np.ones((1, 1, 1), dtype=bool))
    cutter = PartCutter(problem, [part], np.full(3, 20.0), cells, [NO_FLAT_FACES] * 3)
    is_fixed = np.zeros((2, 3), dtype=bool)
    slopes_s_per_mm = cutter.measure_slopes(part, is_fixed)
    assert np.argwhere(slopes_s_per_mm).tolist() == [[1, 0]]
    moved_mm = box_mm.copy()
    moved_mm[1, 0] += 1.0
    moved_part, poses = cutter.cut_in_old_poses(0, part, moved_mm)
    measured_s_per_mm = moved_part.with_poses(poses).seconds - part.seconds
    assert slopes_s_per_mm[1, 0] == pytest.approx(measured_s_per_mm, rel=0.1)
    assert not cutter.measure_slopes(part, np.ones((2, 3), dtype=bool)).any()
    inner_part = replace(part, box_mm=moved_mm)  # its pieces end inside this box
    assert not cutter.measure_slopes(inner_part, is_fixed).any()
    low_mm = np.array([[20.0, -1.0, -1.0], [61.0, 80.0, 35.0]])
    low_part = cutter.cut_part(0, low_mm)
    low_part = low_part.with_poses(problem.find_poses(low_part.pieces))
    assert cutter.measure_slopes(low_part, is_fixed)[0, 0] < 0.0
