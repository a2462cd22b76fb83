"""Order of the walls of a layer and of its infill: the same lines are printed once, with less travel."""

from dataclasses import replace
from itertools import groupby

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
from slicing.checks import Toolpath, read_toolpath
from slicing.glued_parts import HiddenSide, reorder_infill, reorder_outlines
from slicing.plate import slice_plate

OUTLINE = shapely.box(0.0, 0.0, 100.0, 40.0)
NEAR_HOLE, FAR_HOLE = (shapely.box(x, 15.0, x + 10.0, 25.0) for x in (5.0, 85.0))
LAYER_S = 60.0


def write_walls(rings, extruded_mm=1.0, wipe_mm=0.2):
    """Write the inner and outer wall of each ring, and the wipe; the inner walls lie within the outline."""
    lines = []
    for ring in rings:
        inner = ring.buffer(-1.0 if ring is OUTLINE else 1.0, join_style="mitre")
        for feature, polygon in (("WALL-INNER", inner), ("WALL-OUTER", ring)):
            points = np.round(polygon.exterior.coords, 3).tolist()
            lines += ["G0 F9000 X{} Y{}".format(*points[0]), f";TYPE:{feature}"]
            for number, end in enumerate(points[1:]):
                extruded_mm += 0.1 * np.hypot(*np.subtract(end, points[number]))
                lines.append("G1 F1200 X{} Y{} E{:.5f}".format(*end, extruded_mm))
        wipe = shapely.line_interpolate_point(ring.exterior, wipe_mm)
        lines.append(f"G0 F9000 X{wipe.x:.3f} Y{wipe.y:.3f}")
    return lines


def write_layers(rings, start=(2, 2), end=(2, 38), layer_s=LAYER_S, infill=(), **options):
    """Write a layer of infill that ends at a point, and one of walls and of infill that begins at a point."""
    lines = [";LAYER:1", ";TYPE:FILL", "G0 F9000 X20 Y5 Z1"]
    lines += ["G1 F3000 X{} Y{} E1".format(*start), "G0 F600 X{} Y{} Z2".format(*start)]
    lines += [f";TIME_ELAPSED:{layer_s}", ";LAYER:2", *write_walls(rings, **options)]
    lines += ["G0 F9000 X{} Y{}".format(*end), ";TYPE:FILL", "G1 F3000 X20 Y35 E200"]
    for number, (begin, end) in enumerate(infill, 1):
        lines += ["G0 F9000 X{} Y{}".format(*begin), "G1 F3000 X{} Y{} E{}".format(*end, 200 + number)]
    lines += [f";TIME_ELAPSED:{2.0 * layer_s}"]
    return ("\n".join(lines) + "\n").encode()


def list_wall_starts(path, feature):
    """List the X coordinates at which the walls of a feature begin."""
    moves = np.flatnonzero(path.is_feature(feature) & (path.extruded_mm > 0.0))
    return path.start[moves[np.diff(moves, prepend=-2) != 1], 0].tolist()


@pytest.fixture
def reorder(make_settings):
    """Return a function that reorders a file, and returns its bytes and the paths before and after."""

    def reorder_file(gcode, **overrides):
        path = read_toolpath(gcode)
        options = make_settings(**overrides)
        new_gcode = reorder_outlines(gcode, path, options)
        new_gcode = reorder_infill(new_gcode, read_toolpath(new_gcode), options)
        return new_gcode, path, read_toolpath(new_gcode)

    return reorder_file


def test_holes_are_printed_on_the_way(reorder):
    _, path, new_path = reorder(write_layers([FAR_HOLE, NEAR_HOLE, OUTLINE], end=(98, 2)))
    assert list_wall_starts(path, "WALL-OUTER") == [95.0, 15.0, 100.0]
    assert list_wall_starts(new_path, "WALL-OUTER") == [15.0, 95.0, 100.0]
    assert measure_travel_mm(new_path) < 0.8 * measure_travel_mm(path)


def test_each_inner_wall_stays_before_its_outer_wall(reorder):
    _, _, new_path = reorder(write_layers([FAR_HOLE, NEAR_HOLE, OUTLINE], end=(98, 2)))
    inner, outer = (list_wall_starts(new_path, feature) for feature in ("WALL-INNER", "WALL-OUTER"))
    assert np.abs(np.subtract(inner, outer)).max() <= 1.0
    features = [new_path.features[f] for f in new_path.feature[new_path.extruded_mm > 0.0]]
    assert [name for name, _ in groupby(features)] == ["FILL", *3 * ["WALL-INNER", "WALL-OUTER"], "FILL"]


@pytest.mark.parametrize(
    "infill", [(), [((x, 5), (x, 35)) for x in (90, 40, 60, 20)]], ids=["walls", "infill"]
)
def test_wipe_follows_its_outer_wall(reorder, infill):
    rings = [FAR_HOLE, NEAR_HOLE, OUTLINE]
    _, path, new_path = reorder(write_layers(rings, end=(98, 2), infill=infill))
    assert measure_travel_mm(new_path) < measure_travel_mm(path)
    outer = np.flatnonzero(new_path.is_feature("WALL-OUTER") & (new_path.extruded_mm > 0.0))
    ends = outer[np.diff(outer, append=outer[-1] + 2) != 1]
    wipes_mm = np.hypot(*(new_path.end - new_path.start)[ends + 1, :2].T)
    assert wipes_mm == pytest.approx([0.2, 0.2, 0.2], abs=0.002)


@pytest.mark.parametrize(
    "options",
    [
        {"rings": [OUTLINE]},
        {"rings": [NEAR_HOLE, FAR_HOLE, OUTLINE], "end": (98, 2)},
        {"rings": [FAR_HOLE, NEAR_HOLE, OUTLINE], "end": (98, 2), "layer_s": 5.0},
    ],
    ids=["no hole", "least travel", "layer of the minimum time"],
)
def test_walls_stay_as_they_are(reorder, options):
    gcode = write_layers(**options)
    assert reorder(gcode)[0] is gcode


def test_walls_stay_as_they_are_if_long_travel_retracts(reorder):
    gcode = write_layers([FAR_HOLE, NEAR_HOLE, OUTLINE], end=(98, 2))
    assert reorder(gcode, retraction_combing_max_distance="30")[0] is gcode


def test_infill_is_printed_on_the_way_and_backwards(reorder):
    infill = [((90, 5), (90, 35)), ((40, 5), (40, 35)), ((60, 5), (60, 35)), ((20, 30), (20, 10))]
    _, path, new_path = reorder(write_layers([OUTLINE], infill=infill))
    new_lines = new_path.is_feature("FILL") & (new_path.extruded_mm > 0.0) & (new_path.layer == 2)
    assert new_path.start[new_lines, 0].tolist() == [90.0, 60.0, 40.0, 20.0, 20.0]
    assert new_path.start[new_lines, 1].tolist() == [5.0, 35.0, 5.0, 35.0, 30.0]
    assert measure_travel_mm(new_path) < 0.8 * measure_travel_mm(path)
    assert_same_lines(new_path, path)


def test_extrusion_of_all_moves_is_not_computed_for_each_line(reorder, monkeypatch):
    compute_extruded_mm, counts = Toolpath.extruded_mm.fget, []

    def count(path):
        counts[-1] += 1
        return compute_extruded_mm(path)

    monkeypatch.setattr(Toolpath, "extruded_mm", property(count))
    for line_count in (4, 12):
        counts.append(0)
        infill = [((x, 5), (x, 35)) for x in (90, 20, *range(30, 22 + 4 * line_count, 4))]
        new_gcode, path, _ = reorder(write_layers([OUTLINE], infill=infill))
        assert measure_travel_mm(read_toolpath(new_gcode)) < measure_travel_mm(path)
    assert counts[0] == counts[1]


@given(
    holes=st.sets(st.tuples(st.integers(0, 5), st.integers(0, 1)), min_size=1, max_size=6),
    outline_at=st.integers(0, 6),
    ends=st.tuples(*2 * [st.tuples(st.integers(2, 98), st.integers(2, 3))]),
    infill=st.lists(st.tuples(*2 * [st.tuples(st.integers(2, 98), st.integers(36, 38))]), max_size=6),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)
def test_all_lines_are_printed_once_inside_the_part_with_no_more_travel(
    reorder, holes, outline_at, ends, infill
):
    rings = [shapely.box(5 + 16 * x, 6 + 16 * y, 13 + 16 * x, 14 + 16 * y) for x, y in sorted(holes)]
    gcode = write_layers([*rings[:outline_at], OUTLINE, *rings[outline_at:]], *ends, infill=infill)
    _, path, new_path = reorder(gcode)
    assert_same_lines(new_path, path)
    assert measure_travel_mm(new_path) <= measure_travel_mm(path)
    assert OUTLINE.buffer(0.06).covers(list_travel(new_path, 2))


def test_slice_of_a_block_with_recesses_has_the_same_lines_and_less_travel(make_request, monkeypatch):
    block = trimesh.creation.box((120.0, 40.0, 8.0), trimesh.transformations.translation_matrix((0, 0, 4.0)))
    for x_mm, y_mm in ((-50.0, 10.0), (50.0, -10.0), (0.0, 10.0)):
        recess = trimesh.creation.box((8.0, 4.0, 4.0))
        block = block.difference(recess.apply_translation((x_mm, y_mm, 8.0)), engine="manifold")
    request = make_request(block, hidden_sides=(HiddenSide((1.0, 0.0), 60.0),))
    request = replace(request, settings=replace(request.settings, hidden_wall_ratio=1.0))
    new_result = slice_plate(request)
    new_path = read_toolpath(new_result.gcode.read_bytes())
    for name in ("reorder_outlines", "reorder_infill"):
        monkeypatch.setattr(f"slicing.plate.{name}", lambda gcode, path, settings: gcode)
    result = slice_plate(request)
    path = read_toolpath(result.gcode.read_bytes())
    assert len(list_printed_lines(new_path)[0]) == len(list_printed_lines(path)[0])
    for feature in ("WALL-INNER", "WALL-OUTER"):
        new_mm, old_mm = (p.extruded_mm[p.is_feature(feature)].sum() for p in (new_path, path))
        assert new_mm == pytest.approx(old_mm, abs=0.02)
    assert measure_travel_mm(new_path) < measure_travel_mm(path)
    assert new_result.sliced_s < result.sliced_s
