"""Start times of features, computed from layer times and compared with the firmware's planner."""

import numpy as np
import pytest
import trimesh

from drivers.emulator.firmware.planner import CAPACITY, Limits, Planner
from drivers.gcode import Feature, read_program
from drivers.printers import PROFILES
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS
from slicing.checks import add_times, read_toolpath
from slicing.plate import slice_plate

TWO_LAYERS = b"""G28
G1 F6000 X50
;LAYER:0
;TYPE:SKIRT
G1 F600 X60 E1
;TYPE:WALL-OUTER
G1 X90 E2
;TIME_ELAPSED:8.0
;LAYER:1
G1 F6000 X50
;TYPE:FILL
G1 F600 X40 E3
;TIME_ELAPSED:10.8
G28
;TYPE:CUSTOM
"""


def test_time_is_distributed_by_the_duration_of_moves():
    timed_gcode = add_times(TWO_LAYERS, read_toolpath(TWO_LAYERS))
    assert b";TIME_ELAPSED:2.000000\n;TYPE:WALL-OUTER\n" in timed_gcode
    assert b";TIME_ELAPSED:8.800000\n;TYPE:FILL\n" in timed_gcode
    assert timed_gcode.count(b"TIME_ELAPSED") == 4
    other_lines = [line for line in timed_gcode.splitlines() if b"TIME" not in line]
    assert other_lines == [line for line in TWO_LAYERS.splitlines() if b"TIME" not in line]


def test_file_without_times_is_unchanged():
    untimed_gcode = TWO_LAYERS.replace(b";TIME_ELAPSED", b";NOTHING")
    assert add_times(untimed_gcode, read_toolpath(untimed_gcode)) == untimed_gcode


def compute_start_times_s(toolpath):
    """Return the times (n,) in seconds at which a planner that is kept full accepts each move."""
    planner = Planner(Limits.from_profile(PROFILES["ultimaker2_plus"]), (0.0,) * 4, lambda e_mm, z_mm: None)
    position, now_s, times_s = np.zeros(4), 0.0, []
    for move, feed_mm_s in zip(toolpath.end - toolpath.start, toolpath.feed_mm_min / 60, strict=True):
        position = position + move
        now_s = max(now_s, planner.compute_next_free_s())
        planner.advance(now_s)
        planner.add(tuple(position), max(feed_mm_s, 1.0), now_s)
        times_s.append(now_s)
    return np.array(times_s)


def test_times_within_layers_equal_those_of_the_planner_of_the_firmware(make_request):
    model = trimesh.boolean.difference([trimesh.creation.box((30, 20, 6)), trimesh.creation.cylinder(6, 20)])
    result = slice_plate(make_request(model))
    with result.gcode.open("rb") as lines:
        program = read_program(lines, ULTIMAKER2_PLUS)
    assert program.time_s == result.sliced_s
    assert program.layer_count == result.layers
    assert {mark.feature for mark in program.timeline} >= {Feature.SKIRT, Feature.WALL_OUTER, Feature.FILL}
    heights_mm = [mark.z_mm for mark in program.timeline]
    assert heights_mm == sorted(heights_mm)
    assert heights_mm[-1] == pytest.approx(result.height_mm)
    seconds = [mark.time_s for mark in program.timeline]
    assert seconds == sorted(seconds)

    toolpath = read_toolpath(result.gcode.read_bytes())
    planned_s = compute_start_times_s(toolpath)
    first_move = next(comment.next_move for comment in toolpath.comments if comment.text.startswith("LAYER:"))
    # A move begins when the queue has accepted as many more moves as fit into it.
    expected_times_s = planned_s[CAPACITY:] - planned_s[first_move + CAPACITY]
    marks = [
        (c.next_move, float(c.text[13:])) for c in toolpath.comments if c.text.startswith("TIME_ELAPSED:")
    ]
    errors_s = np.array(
        [seconds - expected_times_s[move] for move, seconds in marks if move < len(expected_times_s)]
    )
    assert len(errors_s) > 100
    assert np.abs(errors_s).max() < 0.01 * result.sliced_s
    assert np.abs(errors_s - np.median(errors_s)).mean() < 0.001 * result.sliced_s
