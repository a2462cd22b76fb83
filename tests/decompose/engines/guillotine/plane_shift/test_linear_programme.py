"""Shifts of planes with the least makespan, within their limits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from decompose.engines.guillotine.plane_shift.linear_programme import ShiftLimits, solve_plane_shifts

ROW = np.full((3, 2, 3), -1)  # three boxes in a row along x, with two planes between them
ROW[0, 1, 0] = ROW[1, 0, 0] = 0
ROW[1, 1, 0] = ROW[2, 0, 0] = 1
SLOPES = np.where(ROW >= 0, np.array([-1.0, 1.0])[None, :, None], 0.0)  # 1 s for each mm
NO_LIMIT = np.full((3, 3), math.inf)
MAX_SHIFTS_MM = np.full(2, 100.0)
MIN_GAIN_S_PER_MM = 0.05


def test_load_is_balanced_across_a_box_in_between() -> None:
    moves_mm, seconds = solve_plane_shifts(
        np.array([20.0, 14.0, 8.0]),
        SLOPES,
        ROW,
        ShiftLimits(NO_LIMIT, NO_LIMIT, -MAX_SHIFTS_MM, MAX_SHIFTS_MM),
        MIN_GAIN_S_PER_MM,
    )
    assert seconds == pytest.approx(14.0)
    assert moves_mm == pytest.approx([-6.0, -6.0])


def test_only_useful_planes_are_moved() -> None:
    moves_mm, seconds = solve_plane_shifts(
        np.array([20.0, 20.0, 8.0]),
        SLOPES,
        ROW,
        ShiftLimits(NO_LIMIT, NO_LIMIT, np.array([0.0, -1.0]), MAX_SHIFTS_MM),
        MIN_GAIN_S_PER_MM,
    )
    assert seconds == pytest.approx(20.0)  # the first box cannot get shorter
    assert moves_mm == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("direction", ["longer", "shorter", "step"])
def test_planes_move_up_to_their_limit(direction: str) -> None:
    max_growth_mm, max_shrinkage_mm, max_shift_mm = NO_LIMIT.copy(), NO_LIMIT.copy(), MAX_SHIFTS_MM
    if direction == "longer":
        max_growth_mm[2, 0] = 1.0
    elif direction == "shorter":
        max_shrinkage_mm[0, 0] = 3.0
    else:
        max_shift_mm = np.array([3.0, 100.0])
    limits = ShiftLimits(max_growth_mm, max_shrinkage_mm, -max_shift_mm, max_shift_mm)
    moves_mm, seconds = solve_plane_shifts(np.array([20.0, 0.0, 8.0]), SLOPES, ROW, limits, MIN_GAIN_S_PER_MM)
    if direction == "longer":
        assert moves_mm[1] == pytest.approx(-1.0)
        assert seconds == pytest.approx(9.5)
    else:
        assert moves_mm[0] == pytest.approx(-3.0)
        assert seconds == pytest.approx(17.0)


def test_planes_stay_that_gain_too_little_for_their_moves() -> None:
    """Move only the first plane: the second one would gain 6 s, and both would move by 6 mm more in total."""
    limits = ShiftLimits(NO_LIMIT, NO_LIMIT, -MAX_SHIFTS_MM, MAX_SHIFTS_MM)
    times_s = np.array([40.0, 14.0, 8.0])
    moves_mm, seconds = solve_plane_shifts(times_s, SLOPES, ROW, limits, 0.45)
    assert moves_mm == pytest.approx([-13.0, 0.0])
    assert seconds == pytest.approx(27.0)
