"""Order of the pieces of inner walls: the same lines are printed once, with less travel, inside the part."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from printers.printed_lines import (
    assert_same_lines,
    list_printed_lines,
    list_travel,
    measure_travel_mm,
)
from slicing.checks import read_toolpath
from slicing.glued_parts import HiddenSide, reorder_inner_walls
from slicing.plate import slice_plate

RING = [(40, 0), (40, 40), (0, 40), (0, 0), (40, 0)]  # counter-clockwise from the seam
ANGLE = [(60, 15), (15, 15), (15, 60), (0, 60), (0, 0), (60, 0), (60, 15)]  # two arms, seam at the end of one
INFILL_END = (0, 20)
LAYER_S = 60.0
ROUNDING_MM = 0.002


def write_layers(ring, removed, infill_end=INFILL_END, layer_s=LAYER_S, before_wall=()):
    """Write a layer of infill, and one of an inner wall without some sides and its outer wall 1 mm away."""
    lines = [";LAYER:1", ";TYPE:FILL", "G0 F9000 X20 Y20 Z1"]
    lines += ["G1 F3000 X{} Y{} E1".format(*infill_end), "G0 F600 X{} Y{} Z2".format(*infill_end)]
    lines += ["G0 F9000 X{} Y{}".format(*ring[0]), f";TIME_ELAPSED:{layer_s}", ";LAYER:2", *before_wall]
    lines += [";TYPE:WALL-INNER"]
    extruded_mm = 1.0
    for number, (start, end) in enumerate(pairwise(ring)):
        if number in removed:
            lines.append("G0 F9000 X{} Y{}".format(*end))
        else:
            extruded_mm += 0.1 * np.hypot(*np.subtract(end, start))
            lines.append("G1 F1800 X{} Y{} E{:.5f}".format(*end, extruded_mm))
    outline = np.round(shapely.Polygon(ring).buffer(1.0, join_style="mitre").exterior.coords, 3).tolist()
    lines += ["G0 F9000 X{} Y{}".format(*ring[0]), "G0 F9000 X{} Y{}".format(*outline[0]), ";TYPE:WALL-OUTER"]
    for number, end in enumerate(outline[1:], 1):
        lines.append("G1 F1200 X{} Y{} E{:.5f}".format(*end, extruded_mm + number))
    lines += [f";TIME_ELAPSED:{2.0 * layer_s}"]
    return ("\n".join(lines) + "\n").encode()


@pytest.fixture
def reorder(make_settings):
    """Return a function that reorders a file, and returns its bytes and the paths before and after."""

    def reorder_file(gcode, **overrides):
        path = read_toolpath(gcode)
        new_gcode = reorder_inner_walls(gcode, path, make_settings(**overrides))
        return new_gcode, path, read_toolpath(new_gcode)

    return reorder_file


def test_wall_begins_where_its_removed_side_ends(reorder):
    _, path, new_path = reorder(write_layers(RING, removed={2}))
    walls = new_path.is_feature("WALL-INNER") & (new_path.extruded_mm > 0.0)
    assert new_path.start[walls][0, :2].tolist() == [0.0, 40.0]
    assert new_path.end[walls][-1, :2].tolist() == [0.0, 0.0]
    assert measure_travel_mm(new_path) == pytest.approx(20.0 + np.hypot(41.0, 1.0), abs=ROUNDING_MM)
    assert measure_travel_mm(path) > 80.0


def test_extrusion_of_each_line_stays_the_same(reorder):
    _, path, new_path = reorder(write_layers(RING, removed={2}))
    assert_same_lines(new_path, path)


def test_travel_goes_around_an_inner_corner(reorder):
    gcode = write_layers(ANGLE, removed={1, 3}, infill_end=(5, 58))
    _, path, new_path = reorder(gcode)
    assert measure_travel_mm(new_path) < measure_travel_mm(path)
    outline = shapely.Polygon(ANGLE).buffer(1.06, join_style="mitre")
    assert outline.covers(list_travel(new_path, 2))
    assert_same_lines(new_path, path)


@pytest.mark.parametrize(
    "options",
    [
        {"removed": set()},
        {"removed": {2}, "layer_s": 5.0},
        {"removed": {2}, "before_wall": ["M106 S255"], "infill_end": (40, 0)},
    ],
    ids=["closed wall", "layer of the minimum time", "command in the travel"],
)
def test_walls_stay_as_they_are(reorder, options):
    gcode = write_layers(RING, **options)
    assert reorder(gcode)[0] is gcode


def test_walls_stay_as_they_are_if_long_travel_retracts(reorder):
    gcode = write_layers(RING, removed={2})
    assert reorder(gcode, retraction_combing_max_distance="30")[0] is gcode


@given(
    radii_mm=st.lists(st.floats(10.0, 40.0), min_size=5, max_size=12),
    removed=st.sets(st.integers(0, 11), min_size=1, max_size=3),
    infill_end=st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0)),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)
def test_any_wall_is_printed_once_with_no_more_travel(reorder, radii_mm, removed, infill_end):
    angles = np.linspace(0.0, 2.0 * np.pi, len(radii_mm), endpoint=False)
    ring = (np.array(radii_mm)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])).round(3).tolist()
    gcode = write_layers([*ring, ring[0]], removed, [round(x, 3) for x in infill_end])
    _, path, new_path = reorder(gcode)
    assert_same_lines(new_path, path)
    assert measure_travel_mm(new_path) <= measure_travel_mm(path)
    assert shapely.Polygon(ring).buffer(1.1, join_style="mitre").covers(list_travel(new_path, 2))


def test_slice_of_a_block_has_the_same_lines_and_less_travel(make_request, monkeypatch):
    block = trimesh.creation.box((100.0, 80.0, 8.0), trimesh.transformations.translation_matrix((0, 0, 4.0)))
    sides = (HiddenSide((1.0, 0.0), 50.0), HiddenSide((-1.0, 0.0), 50.0))
    request = make_request(block, hidden_sides=sides)
    request = replace(request, settings=replace(request.settings, hidden_wall_ratio=1.0))
    new_result = slice_plate(request)
    new_path = read_toolpath(new_result.gcode.read_bytes())
    monkeypatch.setattr("slicing.plate.reorder_inner_walls", lambda gcode, path, settings: gcode)
    result = slice_plate(request)
    path = read_toolpath(result.gcode.read_bytes())
    assert len(list_printed_lines(new_path)[0]) == len(list_printed_lines(path)[0])
    new_mm, old_mm = (p.extruded_mm[p.is_feature("WALL-INNER")].sum() for p in (new_path, path))
    assert new_mm == pytest.approx(old_mm, abs=0.01)
    assert measure_travel_mm(new_path) < 0.8 * measure_travel_mm(path)
    assert new_result.sliced_s < result.sliced_s
