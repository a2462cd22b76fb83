"""Ceilings of hollows, measured in layers without the formulas of the search."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from decompose.connectors.tools import make_groove, make_hole
from decompose.geometry import Solid
from decompose.results import overhangs
from decompose.results.overhangs import measure_ceiling_mm2
from decompose.results.tool_groups import EPS_MM2

UP_AXIS = np.array([0.0, 0.0, 1.0])
X_AXIS = np.array([1.0, 0.0, 0.0])


def make_prism(profile: list[tuple[float, float]]) -> np.ndarray:
    """Make a hollow 6 mm deep along x behind an upright face, with a profile in y and z."""
    return np.array([(x, y, z) for x in (-0.1, 6.0) for y, z in profile])


def make_cone(width_mm: float, height_mm: float) -> np.ndarray:
    """Make a hollow that opens on the bed and ends in a point."""
    angles_rad = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(angles_rad), np.sin(angles_rad), np.zeros(24)], axis=1) * width_mm / 2.0
    return np.vstack([ring - 0.1 * UP_AXIS, ring + UP_AXIS, [[0.0, 0.0, 1.0 + height_mm]]])


@pytest.mark.parametrize(
    ("tool", "direction", "min_mm2", "max_mm2"),
    [
        (make_prism([(-2, 0), (2, 0), (2, 3), (-2, 3)]), X_AXIS, 15.0, 24.0),  # a flat ceiling
        (make_prism([(-2, 0), (2, 0), (2, 3), (0, 5.1), (-2, 3)]), X_AXIS, 0.0, 0.0),  # a roof of 45 degrees
        (make_prism([(-2, 0), (2, 0), (2, 3), (0, 4), (-2, 3)]), X_AXIS, 0.5, 24.0),  # too flat a roof
        (make_cone(3.0, 2.0), UP_AXIS, 0.005, 0.2),  # the slicer closes a point one layer early
        (make_cone(3.0, 0.5), UP_AXIS, 1.0, 8.0),
        (make_cone(3.0, 2.0) * [1, 1, -1], -UP_AXIS, 0.0, 0.0),  # it opens to the top
    ],
)  # fmt: skip
def test_ceiling_that_needs_support_is_found(
    tool: np.ndarray, direction: np.ndarray, min_mm2: float, max_mm2: float
) -> None:
    assert min_mm2 <= measure_ceiling_mm2([tool], direction, 0.0, UP_AXIS) <= max_mm2


@example(rise=0.4290, depth_mm=5.9)  # the layers above the mouth lie beside the upper end of the hole
@given(st.floats(-1.0, 1.0), st.floats(2.3, 8.0))
def test_no_hole_that_the_search_makes_has_a_ceiling_that_needs_support(rise: float, depth_mm: float) -> None:
    direction = np.array([np.sqrt(1.0 - rise**2), 0.0, rise])
    hole = make_hole(0, np.zeros(3), direction, UP_AXIS, (3.25, depth_mm), np.zeros(3))
    assert hole is not None
    assert measure_ceiling_mm2([hole.points_mm], direction, 0.0, UP_AXIS) <= EPS_MM2


def test_bodies_that_meet_are_one_hollow() -> None:
    """Join a roof, which alone needs no support, with a body through its ridge that has a flat ceiling."""
    roof = make_prism([(-2, 0), (2, 0), (2, 3), (0, 5.1), (-2, 3)])
    crossing_prism = make_prism([(-1, 3), (1, 3), (1, 6), (-1, 6)])
    assert measure_ceiling_mm2([roof, crossing_prism], X_AXIS, 0.0, UP_AXIS) > 5.0


@pytest.mark.parametrize("slope", [-0.3, 0.0, 0.4])
@pytest.mark.parametrize("roof_mm", [0.6, 1.9, 2.1])
def test_layers_between_corners_represent_the_others(
    slope: float, roof_mm: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compare with a cut of every layer, for a groove that is upright or leans, and a flat or steep roof."""
    ends = np.array([[0.0, 0.0, 1.0], [0.0, 40.0 * slope, 40.0]])
    roof = make_prism([(3, 12), (7, 12), (7, 23), (5, 23 + roof_mm), (3, 23)])
    tools = [make_groove(0, ends, X_AXIS).points_mm, roof]
    counts: list[int] = []
    cut = Solid.cut_sections

    def count_sections(solid: Solid, frame: np.ndarray, at_mm: np.ndarray) -> list[list[np.ndarray]]:
        counts.append(len(at_mm))
        return cut(solid, frame, at_mm)

    monkeypatch.setattr(Solid, "cut_sections", count_sections)
    area_mm2, section_count = measure_ceiling_mm2(tools, X_AXIS, 0.0, UP_AXIS), sum(counts)
    monkeypatch.setattr(overhangs, "MIN_OUTLINE_MM", 1e-9)  # keep all outlines
    all_mm2 = measure_ceiling_mm2(tools, X_AXIS, 0.0, UP_AXIS)
    monkeypatch.setattr(overhangs, "_list_end_layers", lambda run: run)  # cut every layer
    counts.clear()
    assert measure_ceiling_mm2(tools, X_AXIS, 0.0, UP_AXIS) == pytest.approx(all_mm2, abs=1e-6)
    assert area_mm2 == pytest.approx(all_mm2, abs=1e-6)
    assert section_count < sum(counts) / 2
    assert (area_mm2 > 0.1) is (roof_mm < 1.7)
