"""The linear programme that says how far planes move."""

from __future__ import annotations

import math

import numpy as np
import pytest

from decompose.engines.guillotine.plane_programme import solve_plane_shifts

ROW = np.full((3, 2, 3), -1)  # three boxes in a row along x, with two planes between them
ROW[0, 1, 0] = ROW[1, 0, 0] = 0
ROW[1, 1, 0] = ROW[2, 0, 0] = 1
SLOPES = np.where(ROW >= 0, np.array([-1.0, 1.0])[None, :, None], 0.0)  # a second a mm
FREE = np.full((3, 3), math.inf)
FAR = np.full(2, 100.0)


def test_makes_all_equal_through_a_box_between() -> None:
    moves, seconds = solve_plane_shifts(np.array([20.0, 14.0, 8.0]), SLOPES, ROW, FREE, FREE, -FAR, FAR)
    assert seconds == pytest.approx(14.0)
    assert moves == pytest.approx([-6.0, -6.0])


def test_moves_only_what_helps() -> None:
    moves, seconds = solve_plane_shifts(
        np.array([20.0, 20.0, 8.0]), SLOPES, ROW, FREE, FREE, np.array([0.0, -1.0]), FAR
    )
    assert seconds == pytest.approx(20.0)  # the first box cannot get shorter
    assert moves == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("which", ["longer", "shorter", "step"])
def test_goes_as_far_as_it_may(which: str) -> None:
    longer, shorter, step = FREE.copy(), FREE.copy(), FAR
    if which == "longer":
        longer[2, 0] = 1.0
    elif which == "shorter":
        shorter[0, 0] = 3.0
    else:
        step = np.array([3.0, 100.0])
    moves, seconds = solve_plane_shifts(np.array([20.0, 0.0, 8.0]), SLOPES, ROW, longer, shorter, -step, step)
    if which == "longer":
        assert moves[1] == pytest.approx(-1.0)
        assert seconds == pytest.approx(9.5)
    else:
        assert moves[0] == pytest.approx(-3.0)
        assert seconds == pytest.approx(17.0)
