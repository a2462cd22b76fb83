"""Shorter travel on an angle with two arms, whose inner corner must not be crossed."""

import numpy as np
import shapely

from slicing.checks import read_toolpath
from slicing.glued_parts.rewriting import replace_moves
from slicing.glued_parts.travel import Trail, shorten_travel

OUTLINE = [(0, 60), (0, 0), (60, 0), (60, 15), (15, 15), (15, 60), (0, 60)]  # from the first arm
RING = [(1, 1), (59, 1), (59, 14), (14, 14), (14, 59), (1, 59), (1, 1)]
SECOND_ARM = (50, 8)


def write_gcode(*travel):
    """Write a layer of outer wall, travel, inner wall, and infill that begins in the second arm."""
    lines = [";LAYER:0", "G0 F9000 X0 Y60 Z1", ";TYPE:WALL-OUTER"]
    lines += [f"G1 F1200 X{x} Y{y} E{e}" for e, (x, y) in enumerate(OUTLINE[1:], 1)]
    lines += [f"G0 F9000 X{x} Y{y}" for x, y in travel]
    lines += [";TYPE:WALL-INNER", *(f"G1 F1200 X{x} Y{y} E{e}" for e, (x, y) in enumerate(RING[1:], 7))]
    lines += ["G0 F9000 X{} Y{}".format(*SECOND_ARM), ";TYPE:FILL", "G1 F1200 X50 Y5 E13"]
    return ("\n".join(lines) + "\n").encode()


def list_travel_mm(gcode, removed, is_skipped):
    """Return the lines of the travel after the outer wall if moves of a file are removed."""
    path = read_toolpath(gcode)
    shares = np.zeros(len(path.layer))
    shares[removed] = 1.0
    segments = {move: [] for move in removed} if is_skipped else {}
    shorten_travel(path, np.zeros_like(shares), shares, (shares > 0.0) & is_skipped, segments)
    new_path = read_toolpath(replace_moves(gcode, path, segments))
    is_travel = (new_path.extruded_mm == 0.0) & (np.arange(len(new_path.layer)) > len(OUTLINE) - 1)
    return np.stack((new_path.start[is_travel, :2], new_path.end[is_travel, :2]), axis=1)


def test_travel_past_a_skipped_ring_stays_within_the_part():
    travel_mm = list_travel_mm(write_gcode((8, 50), RING[0]), range(9, 15), is_skipped=True)
    assert travel_mm[-1][1].tolist() == list(SECOND_ARM)
    assert shapely.Polygon(OUTLINE).covers(shapely.MultiLineString(list(travel_mm)))


def test_points_that_straight_travel_does_not_need_are_left_out():
    travel_mm = list_travel_mm(write_gcode((8, 50), (8, 30), RING[0]), range(10, 16), is_skipped=True)
    assert travel_mm.tolist() == [[[0.0, 60.0], list(RING[0])], [list(RING[0]), list(SECOND_ARM)]]


def test_straight_travel_that_leaves_the_area_only_by_rounding():
    """Use a line from an edge inward: it is not covered, though nothing of it remains outside."""
    area = shapely.Polygon([(98.084, 68.554), (65.046, 68.845), (38.892, 13.51)])
    begin_mm, end_mm = (74.24746821666793, 68.76395310699648), (60.194114827866635, 41.032000000000004)
    straight = shapely.LineString([begin_mm, end_mm])
    assert not area.covers(straight)
    assert straight.difference(area).is_empty
    trail = Trail(np.array([begin_mm, (90.0, 68.0), end_mm]))
    assert trail.find_route(begin_mm, end_mm, area).tolist() == [list(begin_mm), list(end_mm)]
