"""Places of gutters on parts with several upright faces."""

from __future__ import annotations

import numpy as np
import pytest

from decompose.connectors import Blank
from decompose.connectors.faces import Workpieces
from decompose.connectors.gutters import MIN_RANGE_MM, _find_infill_ends, place_gutters
from decompose.geometry import Solid
from decompose.pieces import Piece, find_joints

UP, RIGHT = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


def place(solids, right=RIGHT, up=UP):
    """Place the gutters of parts that meet in the planes x = 0 and x = 20."""
    planes = np.array([[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 20.0]])
    joints = find_joints([Piece(solid, planes, np.zeros((0, 2, 3))) for solid in solids])
    blanks = [Blank(str(n), solid, up, right_direction=right) for n, solid in enumerate(solids)]
    return place_gutters(Workpieces(blanks), joints)


def make_stairs(x_mm, ends_mm):
    """Make a body of boxes side by side, 20 mm long from `x_mm` and 25 mm wide, with these ends in z."""
    return Solid.union(
        [
            Solid.box((x_mm, 25 * n, low), (x_mm + 20, 25 * n + 25, high))
            for n, (low, high) in enumerate(ends_mm)
        ]
    )


def test_gutter_is_near_a_corner_although_the_middle_is_a_little_higher():
    stairs = [make_stairs(x_mm, [(0, 40), (0, 50), (0, 40)]) for x_mm in (0, 20)]
    for gutter in place(stairs):
        assert min(gutter.line_mm[0, 1], 75.0 - gutter.line_mm[0, 1]) < 8.0
    # Much higher places are preferred.
    stairs = [make_stairs(x_mm, [(0, 25), (0, 75), (0, 25)]) for x_mm in (0, 20)]
    assert all(25.0 < gutter.line_mm[0, 1] < 50.0 for gutter in place(stairs))


def test_infill_ends_at_the_corners_of_the_pose():
    solid = Solid.box((0, 0, 0), (20, 60, 40))
    for right in (RIGHT, np.array([0.5**0.5, 0.5**0.5, 0.0])):
        blank = Blank("1", solid, UP, right_direction=right)
        corners = blank.project_onto_bed(np.array([(x, y, 0.0) for x in (0, 20) for y in (0, 60)]))
        ends = _find_infill_ends(blank).reshape(-1, 2)
        assert all(np.linalg.norm(corners - end, axis=1).min() < 1e-9 for end in ends)
    # Without a turn, each layer begins and ends at opposite corners.
    ends = _find_infill_ends(Blank("1", solid, UP, right_direction=RIGHT))
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) == pytest.approx(np.hypot(20.0, 60.0))


def test_second_gutter_only_covers_heights_without_one():
    """Check a middle part with a joint on both sides, each of which reaches over a part of its height."""
    middle = Solid.box((0, 0, 0), (20, 40, 80))
    left, right = Solid.box((-20, 0, 0), (0, 40, 50)), Solid.box((20, 0, 20), (40, 40, 80))
    spans_mm = sorted(
        gutter.line_mm[:, 2].tolist() for gutter in place([left, middle, right]) if gutter.part == 1
    )
    assert len(spans_mm) == 2
    assert spans_mm[0][1] == pytest.approx(spans_mm[1][0])
    assert all(high - low > MIN_RANGE_MM for low, high in spans_mm)
