"""Printing times of the features of a slice, compared with the firmware's planner."""

from dataclasses import astuple

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from drivers.emulator.firmware.planner import Limits, Planner
from drivers.printers import PROFILES
from slicing.checks import MotionLimits, measure_feature_times, read_toolpath
from slicing.checks.feature_times import estimate_move_seconds
from slicing.plate import slice_plate

PROFILE = PROFILES["ultimaker2_plus"]
LIMITS = MotionLimits(
    acceleration_mm_s2=PROFILE.acceleration_mm_s2,
    max_acceleration_mm_s2=np.array(PROFILE.max_acceleration_mm_s2),
    max_feed_mm_s=np.array(PROFILE.max_feedrate_mm_s),
    jerk_mm_s=np.array([PROFILE.jerk_mm_s[0], *PROFILE.jerk_mm_s]),
)
TWO_LAYERS = b"""G28
G1 F6000 X50
;LAYER:0
;TYPE:SKIRT
G1 F600 X60 E1
;TYPE:WALL-OUTER
G1 X90 E2
;TIME_ELAPSED:8.0
;LAYER:1
G0 F6000 X50
;TYPE:FILL
G1 F600 X40 E3
G1 F1500 E1
;TIME_ELAPSED:10.8
G28
"""


def simulate_move_times_s(toolpath):
    """Return the seconds (n,) that each move of a file takes in a planner that is kept full."""
    ends_s = []
    planner = Planner(Limits.from_profile(PROFILE), (0.0,) * 4, lambda e_mm, z_mm: None)
    position, queued_moves, now_s = np.zeros(4), [], 0.0
    seconds = np.zeros(len(toolpath.end))
    for index, (move, feed_mm_s) in enumerate(
        zip(toolpath.end - toolpath.start, np.maximum(toolpath.feed_mm_min / 60, 1.0), strict=True)
    ):
        position = position + move
        now_s = max(now_s, planner.compute_next_free_s())
        planner.advance(now_s)
        old_moves = planner.move_count
        planner.add(tuple(position), feed_mm_s, now_s)
        queued_moves += [index] * (planner.move_count - old_moves)
        ends_s.append((len(queued_moves) - len(planner), planner.moving_s))
    finished_moves = np.array(ends_s)
    busy_s = np.interp(
        np.arange(len(queued_moves) + 1),
        *finished_moves[np.unique(finished_moves[:, 0], return_index=True)[1]].T,
    )
    seconds[queued_moves] = np.diff(busy_s)
    return seconds


def test_time_of_a_layer_is_divided_among_its_features():
    times = measure_feature_times(read_toolpath(TWO_LAYERS), LIMITS)
    assert sum(astuple(times)) == pytest.approx(10.8)
    assert times.walls_s + times.supports_s == pytest.approx(8.0)
    assert times.walls_s == pytest.approx(6.0, abs=0.05)
    assert times.infill_s + times.travel_s == pytest.approx(2.8)
    assert times.travel_s > 0.4
    assert times.skins_s == 0.0


def test_features_take_no_time_in_a_file_without_layer_times():
    toolpath = read_toolpath(TWO_LAYERS.replace(b";TIME_ELAPSED", b";NOTHING"))
    assert astuple(measure_feature_times(toolpath, LIMITS)) == (0.0,) * 5


def test_feature_times_match_the_firmware_planner(make_request):
    model = trimesh.boolean.difference([trimesh.creation.box((30, 20, 6)), trimesh.creation.cylinder(6, 20)])
    result = slice_plate(make_request(model))
    toolpath = read_toolpath(result.gcode.read_bytes())
    assert sum(astuple(result.features)) == pytest.approx(result.sliced_s, rel=1e-6)
    assert min(astuple(result.features)) > 0.0
    planned_s = simulate_move_times_s(toolpath)
    estimated_s = estimate_move_seconds(toolpath, LIMITS)
    is_extrusion = (toolpath.extruded_mm > 0.0) & toolpath.is_head_move & (toolpath.layer >= 0)
    for name in ("WALL-OUTER", "WALL-INNER", "SKIN", "FILL", "SKIRT"):
        mask = toolpath.is_feature(name) & is_extrusion
        assert estimated_s[mask].sum() == pytest.approx(planned_s[mask].sum(), rel=0.03), name


def test_cached_slice_has_the_same_feature_times(make_request, tmp_path):
    request = make_request(trimesh.creation.box((12, 10, 4)), cache=tmp_path / "cache")
    first_result, second_result = slice_plate(request), slice_plate(request)
    assert second_result.is_cached
    assert first_result.features == second_result.features


@given(
    st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(0, 2)), min_size=1, max_size=30),
    st.floats(60, 12000),
)
def test_move_takes_at_least_its_length_divided_by_its_feed(moves, feed_mm_min):
    lines, x_mm, y_mm, e_mm = [b"G1 F%.3f" % feed_mm_min], 0.0, 0.0, 0.0
    for dx_mm, dy_mm, de_mm in moves:
        x_mm, y_mm, e_mm = x_mm + dx_mm, y_mm + dy_mm, e_mm + de_mm
        lines.append(b"G1 X%.4f Y%.4f E%.4f" % (x_mm, y_mm, e_mm))
    toolpath = read_toolpath(b"\n".join(lines) + b"\n")
    seconds = estimate_move_seconds(toolpath, LIMITS)
    delta_mm = np.linalg.norm((toolpath.end - toolpath.start)[:, :3], axis=1)
    assert np.all(np.isfinite(seconds))
    assert np.all(seconds >= delta_mm / np.maximum(toolpath.feed_mm_min / 60.0, 1.0 / 60.0) - 1e-9)
