"""Extension of infill to the outer wall in a short file."""

import pytest

from slicing.checks import read_toolpath
from slicing.glued_parts import HiddenSide
from slicing.glued_parts.infill import Stretch, extend_infill
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
