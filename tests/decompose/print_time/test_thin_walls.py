"""Walls without room for infill, or for inner walls."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from decompose.geometry import Solid
from decompose.print_time.thin_walls import SheetLimits, ThinWalls, WallWidths, measure_thin_walls

WIDTHS = WallWidths(0.35, 0.7, 1.4)
SIDES_MM2 = 2 * 50.0 * 20.0


def measure_solid(solid: Solid, turn_deg: float = 0.0) -> ThinWalls:
    turned_solid = solid.rotate(Rotation.from_euler("z", turn_deg, degrees=True).as_matrix())
    vertices, faces = turned_solid.arrays()
    return measure_thin_walls(vertices[faces], WIDTHS, SheetLimits(1.6, 0.2, 0.7))


@pytest.mark.parametrize(
    "thickness_mm, bare_share, gap_share, full_share",
    [(0.6, 1, 0, 1), (0.9, 1, 1, 1), (1.2, 0, 0, 1), (1.6, 0, 1, 1), (2.0, 0, 0, 0), (9.0, 0, 0, 0)],
)
@pytest.mark.parametrize("turn_deg", [0.0, 30.0])
def test_kind_of_thin_wall_depends_on_its_width(
    thickness_mm: float, bare_share: int, gap_share: int, full_share: int, turn_deg: float
) -> None:
    thin_walls = measure_solid(Solid.box((0, 0, 0), (50, thickness_mm, 20)), turn_deg)
    for found_mm2, share in zip(thin_walls[:3], (bare_share, gap_share, full_share), strict=True):
        assert found_mm2 == pytest.approx(share * SIDES_MM2, rel=0.08, abs=0.05 * SIDES_MM2)


def test_thin_fins_on_a_thick_block_are_measured_without_the_block() -> None:
    fins = [Solid.box((0, y, 0), (50, y + 1.6, 20)) for y in (0.0, 10.0)]
    thin_walls = measure_solid(Solid.union([*fins, Solid.box((0, 20, 0), (50, 40, 20))]))
    assert thin_walls.gap_mm2 == pytest.approx(2 * SIDES_MM2, rel=0.08)


def test_leaning_wall_has_its_area_and_its_horizontal_width() -> None:
    lean_rad = np.radians(20.0)
    wall = Solid.box((0, 0, 0), (50, 1.6 * np.cos(lean_rad), 20 / np.cos(lean_rad)))
    leaning_wall = measure_solid(wall.rotate(Rotation.from_euler("x", -20.0, degrees=True).as_matrix()))
    assert leaning_wall.solid_wall_mm2 == pytest.approx(SIDES_MM2 / np.cos(lean_rad), rel=0.1)


@pytest.mark.parametrize("height_mm, layers", [(1.2, 2), (1.6, 0), (3.0, 0)])
def test_skins_overlap_in_a_thin_sheet(height_mm: float, layers: int) -> None:
    """Use skins of 4 layers on each side, which overlap by 2 layers in a sheet of 6 layers."""
    overlap_mm3 = measure_solid(Solid.box((0, 0, 0), (30, 30, height_mm))).overlap_mm3
    assert overlap_mm3 == pytest.approx(layers * 0.2 * 900.0, rel=0.05)
