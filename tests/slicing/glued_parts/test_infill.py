"""Infill beside removed inner walls: which runs it supports, and its extension in a short file."""

import numpy as np
import pytest

from slicing.checks import read_toolpath
from slicing.glued_parts import HiddenSide
from slicing.glued_parts.infill import Backing, Stretch, _Band, extend_infill
from slicing.glued_parts.rewriting import replace_moves

GCODE = b""";LAYER:0
G0 F9000 X5 Y5
G1 F1500 E-4.5
G0 F9000 X9.2 Y5
G1 F1500 E0
;TYPE:FILL
G1 F3600 X9.2 Y8 E1
G1 X2 Y8 E2
"""
SIDE, STRETCH = HiddenSide((1.0, 0.0), 10.0), Stretch(0, 0, 0.0, 10.0)


def test_lines_of_infill_reach_the_outer_wall_after_a_retraction():
    """Check that the line that follows a retraction keeps its start, and that the feeder moves as before."""
    path = read_toolpath(GCODE)
    segments = extend_infill(path, path.end[:, :2], [SIDE], [STRETCH], 0.7, 0.325)
    new_path = read_toolpath(replace_moves(GCODE, path, segments))
    assert new_path.extruded_mm[~new_path.is_head_move].tolist() == [-4.5, 4.5]
    assert new_path.end[4].tolist()[:2] == [9.525, 8.0]
    assert new_path.extruded_mm[5] == pytest.approx(7.525 / 7.2, abs=1e-5)


def make_backing(infill_mm):
    """Return infill at positions along each side in layer 0, below an outer wall along all of each side."""
    return Backing(
        infill=[_Band(np.zeros(len(p), np.int32), np.array(p, dtype=float)) for p in infill_mm],
        skin=[],
        outer_wall=[_Band(np.ones(2, np.int32), np.array([0.0, 100.0])) for _ in infill_mm],
    )


@pytest.mark.parametrize(
    ("lengths_mm", "infill_mm", "is_supported"),
    [
        ([30.0], [[10.0, 22.0]], True),
        ([30.0], [[8.0]], False),  # 22 mm without infill
        ([15.0], [[]], False),
        ([30.0, 7.0], [[10.0, 22.0], []], True),  # beside a side with infill
        ([30.0, 7.0, 30.0], [[10.0, 22.0], [], [10.0, 22.0]], True),
        ([30.0, 20.0], [[10.0, 22.0], []], False),
        ([15.0, 15.0], [[], []], False),
        ([30.0, 15.0, 15.0, 15.0], [[10.0, 22.0], [], [], []], False),  # the third has no side with infill
    ],
)
def test_bare_side_needs_infill_beside_a_neighbouring_side(lengths_mm, infill_mm, is_supported):
    run = [Stretch(0, side, 0.0, length_mm) for side, length_mm in enumerate(lengths_mm)]
    assert make_backing(infill_mm).supports(run) == is_supported


def test_side_at_which_a_ring_begins_is_one_stretch():
    backing = make_backing([[], [15.0]])
    ends = Stretch(0, 0, 0.0, 18.0), Stretch(0, 0, 18.0, 36.0)
    assert not backing.supports([ends[1], Stretch(0, 1, 0.0, 20.0), ends[0]])
    assert backing.supports([ends[1], Stretch(0, 1, 0.0, 20.0)])
