"""Holes and grooves that print without support in every pose of their part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.connectors.strokes import draw_strokes
from decompose.connectors.tools import (
    MAX_GROOVE_SIN,
    MAX_HOLE_SIN,
    compute_overhang_sin,
    make_groove,
    make_hole,
    needs_bridge,
)

UP_AXIS = np.array([0.0, 0.0, 1.0])
SIZE_MM = (3.25, 7.0)
angles_rad = st.floats(-np.pi, np.pi)


@settings(deadline=None, max_examples=60)
@given(angles_rad, angles_rad, angles_rad)
def test_hole_in_any_direction_has_a_printable_ceiling_and_fits_the_pin(
    turn_rad: float, tilt_rad: float, slot_rad: float
) -> None:
    axis = np.array(
        [np.cos(turn_rad) * np.cos(tilt_rad), np.sin(turn_rad) * np.cos(tilt_rad), np.sin(tilt_rad)]
    )
    u = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    hole = make_hole(
        0, np.zeros(3), axis, UP_AXIS, SIZE_MM, 0.25 * (np.cos(slot_rad) * u + np.sin(slot_rad) * v)
    )
    assert hole is not None
    assert compute_overhang_sin(hole.points_mm, axis, UP_AXIS) <= MAX_HOLE_SIN
    flat_points = hole.points_mm @ np.stack([u, v]).T
    is_floor = np.isclose(hole.points_mm @ axis, 7.0)
    assert shapely.MultiPoint(flat_points[is_floor]).convex_hull.contains(
        shapely.Point(0, 0).buffer(3.24 / 2.0)
    )


@pytest.mark.parametrize(
    ("axis", "expected_mm"),
    [((1.0, 0.0, 0.0), 1.9 * 1.625), ((0.0, 0.0, 1.0), 7.0 + 1.75 * 1.625)],
    ids=["lying: a roof", "upwards: a tip"],
)
def test_ceiling_rises_away_from_the_bed(axis: tuple[float, ...], expected_mm: float) -> None:
    hole = make_hole(0, np.zeros(3), np.array(axis), UP_AXIS, SIZE_MM, np.zeros(3))
    assert hole is not None
    height_mm = (hole.points_mm @ UP_AXIS).max()
    assert height_mm == pytest.approx(expected_mm)


def test_hole_that_opens_upwards_is_a_plain_hexagon():
    hole = make_hole(0, np.zeros(3), -UP_AXIS, UP_AXIS, SIZE_MM, np.zeros(3))
    assert hole is not None and len(hole.points_mm) == 12


@pytest.mark.parametrize("outward", [(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.6, 0.0, 0.8)])
def test_groove_prints_on_upright_lower_and_upper_faces(outward: tuple[float, ...]) -> None:
    axis = -np.array(outward)
    for ends in ([[0.0, 0.0], [3.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]):
        right_direction = np.cross(axis, [0.0, 1.0, 0.0])
        groove = make_groove(0, np.array(ends) @ np.stack([right_direction, [0.0, 1.0, 0.0]]), axis)
        assert compute_overhang_sin(groove.points_mm, axis, UP_AXIS) <= MAX_GROOVE_SIN


def test_groove_on_a_leaning_face_overhangs():
    axis = np.array([-0.8, 0.0, 0.6])
    assert (
        compute_overhang_sin(make_groove(0, np.zeros((2, 3)), axis).points_mm, axis, UP_AXIS) > MAX_GROOVE_SIN
    )


def test_ceiling_that_ends_in_a_point_needs_a_bridge_and_a_ridge_does_not():
    hole = make_hole(0, np.zeros(3), UP_AXIS, UP_AXIS, SIZE_MM, np.zeros(3))
    assert hole is not None and not needs_bridge(hole, UP_AXIS)
    top = hole.points_mm[:, 2].argsort()[-2:]
    pointed_mm = hole.points_mm.copy()
    pointed_mm[top, :2] = 0.0  # a slice of this shape had 1.3 mm3 of support in the hole
    assert needs_bridge(replace(hole, points_mm=pointed_mm), UP_AXIS)
    assert compute_overhang_sin(pointed_mm, UP_AXIS, UP_AXIS) <= MAX_HOLE_SIN


def test_ceiling_of_a_conical_dot_needs_a_bridge():
    cone = make_groove(0, np.zeros((2, 3)), UP_AXIS)
    assert needs_bridge(cone, UP_AXIS)
    assert not needs_bridge(make_groove(0, np.array([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]), UP_AXIS), UP_AXIS)
    assert not needs_bridge(make_groove(0, np.zeros((2, 3)), -UP_AXIS), UP_AXIS)  # it opens upwards


def test_letters_are_all_different_and_text_is_centred():
    letters = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ-^."
    drawings = {letter: np.sort(draw_strokes(letter), axis=1) for letter in letters}
    keys = {tuple(map(tuple, np.unique(d.reshape(-1, 4), axis=0).tolist())) for d in drawings.values()}
    assert len(keys) == len(letters)
    box = draw_strokes("10-14").reshape(-1, 2)
    assert box[:, 1].max() == pytest.approx(3.0) and box[:, 1].min() == pytest.approx(-3.0)
