"""Layers that are so short that the slicer prints them more slowly."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from decompose.print_time import CostModel, PrintTimeSettings, measure_pose
from decompose.print_time.pose_prices import SLAB_COUNT, _sum_slabs, price_short_layers_s

COST = CostModel.from_settings(PrintTimeSettings())


def make_pyramid(side_mm: float, height_mm: float, top_mm: float) -> trimesh.Trimesh:
    """Make a truncated square pyramid."""
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    points = [(x * side_mm / 2, y * side_mm / 2, 0.0) for x, y in corners]
    points += [(x * top_mm / 2, y * top_mm / 2, height_mm) for x, y in corners]
    return trimesh.convex.convex_hull(np.array(points))


def test_slabs_add_up_to_the_part() -> None:
    ball = trimesh.creation.icosphere(3, 20.0)
    ball.apply_translation([3.0, -2.0, -ball.bounds[0, 2]])
    height_mm = float(ball.bounds[1, 2])
    lateral_mm2, section_mm2 = _sum_slabs(ball.triangles.copy(), height_mm)
    upright_mm2 = ball.area_faces * np.sqrt(np.maximum(0.0, 1.0 - ball.face_normals[:, 2] ** 2))
    assert lateral_mm2.sum() == pytest.approx(upright_mm2.sum())
    assert section_mm2.sum() * height_mm / SLAB_COUNT == pytest.approx(ball.volume, rel=0.01)
    for slab in (3, 16, 28):
        above_mm = height_mm * (slab + 0.5) / SLAB_COUNT - height_mm / 2.0
        assert section_mm2[slab] == pytest.approx(math.pi * (20.0**2 - above_mm**2), rel=0.03)


def test_equal_layers_need_no_extra_time() -> None:
    for side_mm in (4.0, 12.0, 60.0):
        assert price_short_layers_s(make_pyramid(side_mm, 50.0, side_mm).triangles, COST) == pytest.approx(
            0.0, abs=1e-6
        )


def test_short_layers_of_a_tip_are_slowed_down() -> None:
    """Compare with the sum of the times of all layers' lines."""
    side_mm, height_mm, top_mm, layer_mm = 40.0, 120.0, 2.0, PrintTimeSettings().layer_height_mm
    tip = make_pyramid(side_mm, height_mm, top_mm)
    heights_mm = np.arange(layer_mm / 2.0, height_mm, layer_mm)
    sides_mm = side_mm + (top_mm - side_mm) * heights_mm / height_mm
    lines_s = layer_mm * (
        COST.volume_s_per_mm3 * sides_mm**2
        + 4.0 * sides_mm * COST.lateral_s_per_mm2
        - np.minimum(COST.inset_s_per_mm, 0.1 * 4.0 * sides_mm * COST.lateral_s_per_mm2)
    )
    min_s = np.minimum(PrintTimeSettings().min_layer_s, 4.0 * lines_s)
    expected_s = np.maximum(0.0, min_s - lines_s).sum()
    assert expected_s > 100.0
    assert price_short_layers_s(tip.triangles, COST) == pytest.approx(expected_s, rel=0.03)
    pose = measure_pose(tip.vertices, tip.faces, np.zeros(len(tip.faces), np.bool_), np.eye(3), COST)
    cost_without_min_layer = CostModel.from_settings(PrintTimeSettings(min_layer_s=0.0))
    unlimited_pose = measure_pose(
        tip.vertices, tip.faces, np.zeros(len(tip.faces), np.bool_), np.eye(3), cost_without_min_layer
    )
    assert pose.price_s - unlimited_pose.price_s == pytest.approx(expected_s, rel=0.03)


@pytest.mark.parametrize(("layer_mm", "angle_deg"), [(0.25, 45.0), (0.1, 45.0), (0.25, 60.0)])
def test_face_at_exactly_the_support_angle_is_supported(layer_mm: float, angle_deg: float) -> None:
    """Price the support that CuraEngine prints under a face at this angle because of rounding."""
    cost = CostModel.from_settings(PrintTimeSettings(layer_height_mm=layer_mm, support_angle_deg=angle_deg))
    assert (
        math.sin(math.radians(angle_deg - 1.6)) < cost.overhang_cos < math.sin(math.radians(angle_deg - 0.15))
    )
    pose_at_angle, steeper_pose = (
        measure_pose(wedge.vertices, wedge.faces, np.zeros(len(wedge.faces), np.bool_), np.eye(3), cost)
        for wedge in (make_leaning_block(angle_deg), make_leaning_block(angle_deg - 3.0))
    )
    assert pose_at_angle.support_mm3 > 1000.0
    assert steeper_pose.support_mm3 == 0.0


def make_leaning_block(angle_deg: float) -> trimesh.Trimesh:
    """Make a block with one side that leans out by this angle from the vertical."""
    out_mm = 30.0 * math.tan(math.radians(angle_deg))
    outline = [(0, 0), (40, 0), (40 + out_mm, 30), (0, 30)]
    return trimesh.convex.convex_hull(np.array([(x, y, z) for x, z in outline for y in (0.0, 30.0)]))
