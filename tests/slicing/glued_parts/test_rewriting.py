"""Replacement of moves in short files."""

import pytest

from slicing.checks import read_toolpath
from slicing.glued_parts.rewriting import Segment, replace_moves

GCODE = b""";LAYER:0
G0 F9000 X0 Y0
G1 F1200 X10 Y0 E1
G1 X20 Y0 E2
M106 S255
G1 X30 Y0 E3
G0 F9000 X40 Y5
G1 F600 E1.5
G92 E0
G1 F1200 X50 Y5 E1
G91
G1 F1500 E-4.5
G90
"""


def replace_and_read(gcode, segments):
    new_gcode = replace_moves(gcode, read_toolpath(gcode), segments)
    return new_gcode, read_toolpath(new_gcode)


def test_file_is_unchanged_without_segments():
    assert replace_and_read(GCODE, {})[0] == GCODE


def test_later_lines_extrude_the_same_after_a_skipped_move():
    gcode, path = replace_and_read(GCODE, {2: []})
    assert path.extruded_mm.tolist() == pytest.approx([0.0, 1.0, 1.0, 0.0, -1.5, 1.0, -4.5])
    assert b"M106 S255\nG1 X30 Y0 E2.00000\n" in gcode
    assert gcode.endswith(b"G92 E0\nG1 F1200 X50 Y5 E1\nG91\nG1 F1500 E-4.5\nG90\n")


def test_segments_extrude_in_proportion_to_their_length():
    segments = [Segment(15.0, 0.0, 9000.0), Segment(20.0, 12.0, 1200.0, 0.1)]
    _, path = replace_and_read(GCODE, {2: segments})
    assert path.end[2:4, :2].tolist() == [[15.0, 0.0], [20.0, 12.0]]
    assert path.extruded_mm[2:4].tolist() == pytest.approx([0.0, 1.3])


def test_feedrate_of_a_replaced_move_does_not_change_the_next():
    gcode, path = replace_and_read(GCODE, {2: [Segment(20.0, 0.0, 9000.0)]})
    assert path.feed_mm_min[3] == 1200.0
    assert b"G1 F1200 X30 Y0 E2.00000\n" in gcode
