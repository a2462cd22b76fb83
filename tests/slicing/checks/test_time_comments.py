"""Times of layers in which CuraEngine resets the position of the extruder."""

import numpy as np
import pytest
import trimesh

from slicing.checks import MotionLimits, read_toolpath, remove_reset_times
from slicing.engine import EngineLimits, run_engine
from slicing.plate import slice_plate

# The head moves 60 mm at 10 mm/s in each layer. The second layer begins with a reset of the extruder, from
# which CuraEngine concludes that 1500 mm of filament are pulled back at 45 mm/s.
TWO_LAYERS = b"""G28
G92 E0
G1 F600 X10 E1500
;LAYER_COUNT:2
;LAYER:0
G1 X70 E1502
;TIME_ELAPSED:6.0
G92 E0
;LAYER:1
G1 X10 E2
;TIME_ELAPSED:%b
"""


@pytest.fixture
def limits():
    return MotionLimits(
        acceleration_mm_s2=3000.0,
        max_acceleration_mm_s2=np.array([9000.0, 9000.0, 100.0, 10000.0]),
        max_feed_mm_s=np.array([300.0, 300.0, 40.0, 45.0]),
        jerk_mm_s=np.array([20.0, 20.0, 0.4, 5.0]),
    )


def read_layers_s(gcode):
    return np.diff([0.0, *(end_s for _, end_s in read_toolpath(gcode).list_layer_ends())])


@pytest.mark.parametrize("end_s", [b"39.4", b"12.0"], ids=["time added", "no time added"])
def test_time_of_a_reset_is_removed_only_where_it_was_added(limits, end_s):
    gcode = TWO_LAYERS % end_s
    corrected_gcode = remove_reset_times(gcode, read_toolpath(gcode), limits)
    assert read_layers_s(corrected_gcode) == pytest.approx([6.0, 6.0], abs=0.1)
    assert [line for line in corrected_gcode.splitlines() if b"TIME" not in line] == [
        line for line in gcode.splitlines() if b"TIME" not in line
    ]


def test_file_without_resets_is_unchanged(limits):
    gcode = (TWO_LAYERS % b"12.0").replace(b"6.0\nG92 E0\n", b"6.0\n")
    assert remove_reset_times(gcode, read_toolpath(gcode), limits) is gcode


def test_layers_with_a_reset_take_as_long_as_their_neighbours(make_request):
    """Slice a block of more than 30 cm3 of filament; every layer is equal to the second one below it."""
    request = make_request(trimesh.creation.box((70, 70, 40)))
    settings = request.settings
    run = run_engine(
        request.engine, request.stl, settings.global_, settings.extruder, EngineLimits(1000, 60.0)
    )
    toolpath = read_toolpath(run.gcode)
    resets = [
        command.next_move
        for command in toolpath.commands
        if command.code == "G92" and toolpath.layer[command.next_move] > 0
    ]
    assert len(resets) >= 2
    layers = toolpath.layer[resets]
    corrected_gcode = remove_reset_times(run.gcode, toolpath, MotionLimits.from_settings(settings.global_))
    added_s, corrected_s = read_layers_s(run.gcode)[layers], read_layers_s(corrected_gcode)
    assert corrected_s[layers] == pytest.approx(corrected_s[layers - 2], rel=0.02)
    assert (added_s > corrected_s[layers] + 30.0).all()
    assert slice_plate(request).sliced_s == pytest.approx(corrected_s.sum(), abs=0.001)
