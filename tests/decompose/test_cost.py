from __future__ import annotations

import math
from dataclasses import replace

import pytest

from decompose.cost import CostModel, PrinterRoom, Recipe, pose_axes, pose_costs
from decompose.solid import Solid


def test_cube_by_hand() -> None:
    cost = CostModel(7.0, 0.5, 0.25, 2.0, 100.0, 3.0, 11.0, brim_mm=8.0)
    ring = 8.0 * (2.0 * 20.0 + math.pi * 8.0)
    by_hand = 7.0 + 0.5 * 1000.0 + 0.25 * 400.0 + 2.0 * 200.0 + 3.0 * ring + 11.0 * 10.0
    times = pose_costs(*Solid.box((5, 5, 5), (15, 15, 15)).arrays(), cost)
    assert times == pytest.approx([by_hand] * 6)  # its underside lies on the bed: no support


def test_only_overhangs_off_the_bed_cost_support() -> None:
    cost = CostModel(0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, brim_mm=0.0)
    table = Solid.union([Solid.box((0, 0, 0), (10, 10, 30)), Solid.box((0, 0, 30), (40, 10, 35))])
    times = pose_costs(*table.arrays(), cost)
    assert times[4] == pytest.approx(30.0 * 10.0 * 30.0)  # upright: 300 mm2, 30 mm above the bed
    assert times[5] == pytest.approx(0.0)  # on its head
    assert times[2] == times[3] == pytest.approx(0.0)  # on its side


def test_slopes_up_to_45_degrees_need_no_support() -> None:
    cost = CostModel(0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, brim_mm=0.0)

    def wedge(reach: float) -> float:
        vertices = [(x, y, z) for y in (0.0, 5.0) for x, z in ((0, 0), (10, 0), (10 + reach, 10), (0, 10))]
        faces = [(0, 1, 2), (0, 2, 3), (4, 6, 5), (4, 7, 6)]
        faces += [f for i in range(4) for j in [(i + 1) % 4] for f in [(i, 4 + i, 4 + j), (i, 4 + j, j)]]
        return float(pose_costs(*Solid.from_arrays(vertices, faces).arrays(), cost)[4])

    assert wedge(9.9) == 0.0
    assert wedge(10.1) == pytest.approx(5.0 * 10.1 * 5.0, rel=0.01)


def test_thinner_layers_and_slower_walls_take_longer() -> None:
    base = CostModel.from_recipe(Recipe())
    thin = CostModel.from_recipe(replace(Recipe(), layer_height_mm=0.125))
    assert thin.lateral_s_mm2 == pytest.approx(2.0 * base.lateral_s_mm2)
    assert thin.volume_s_mm3 == pytest.approx(2.0 * base.volume_s_mm3)
    slow = CostModel.from_recipe(replace(Recipe(), outer_wall_mm_s=20.0))
    assert slow.lateral_s_mm2 > base.lateral_s_mm2
    none = CostModel.from_recipe(replace(Recipe(), infill_line_distance_mm=0.0, support_line_distance_mm=0.0))
    assert none.volume_s_mm3 == none.overhang_s_mm3 == 0.0


def test_a_part_may_be_turned_about_the_vertical_only() -> None:
    room = PrinterRoom("p", ((200.0, 100.0, 50.0),))
    assert room.fits(200.0, 100.0, 50.0)
    assert room.fits(100.0, 200.0, 50.0)
    assert not room.fits(100.0, 50.0, 200.0)
    assert sorted(pose_axes(3)) == [0, 1, 2]
    assert pose_axes(3)[2] == 1
