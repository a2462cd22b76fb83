"""Gutters: upright grooves on hidden faces, which hide the seams of the outer walls and leave space for glue.

The slicer begins each ring at its sharpest inner corner. Without an inner corner, it begins at an edge
between two cut faces, or at a fold of the visible surface, and leaves a bump there. A gutter is sharper than
the grooves of keys and marks, so that the slicer leaves no bump in the groove of a key.

After the outer wall the head travels to an end of the infill, which is at a corner of the part, so gutters
are placed near corners.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.connectors.faces import Blank, Side, Workpieces, find_sides
from decompose.connectors.records import RIM_MM, Gutter
from decompose.connectors.tools import LIP_MM, make_groove
from decompose.pieces import Joint

UPRIGHT_SIN = 0.02  # maximum sine of the angle between an upright face and the vertical
PLACE_PITCH_MM = 4.0  # pitch of the places that are tried
MIN_RANGE_MM = 15.0  # minimum range of heights that a gutter adds
MAX_GUTTERS = 3  # maximum number of gutters of a part
MIN_GAIN_SHARE = 0.7  # minimum range of heights of a gutter, as a share of the largest possible one
# Directions across the lines of infill in successive layers, in which their first and last line are extreme.
INFILL_DIRECTIONS = np.array([[1.0, 1.0], [1.0, -1.0]])
ROUNDING_MARGIN_MM = 0.05  # margin for buffers, which may cut inner corners
GUTTER_DEPTH_MM = 0.4
WIDTH_RATIO = 0.9  # half of the width over the depth: an angle of 84 degrees


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Line (2, 3) on a side from the lower to the upper end, and the heights of the ends in the pose.

    `travel_mm` is the mean distance to the nearer end of the infill.
    """

    side: Side
    line_mm: Floats
    low_mm: float
    high_mm: float
    travel_mm: float


def place_gutters(workpieces: Workpieces, joints: Sequence[Joint]) -> list[Gutter]:
    """Place gutters on the upright faces of each part, so that most of its layers have one.

    Their grooves are added to the tools of the workpieces.

    Parameters
    ----------
    workpieces
        Parts, with the tools of pins and marks; the new tools are added.
    joints
        Joints of these parts, in the same frame.

    Returns
    -------
    list of Gutter
        Gutters in the order of the parts, at most `MAX_GUTTERS` for each.
    """
    sides: dict[int, list[Side]] = defaultdict(list)
    for number, joint in enumerate(joints):
        for pair in find_sides(workpieces.blanks, number, joint):
            for side in pair:
                if abs(float(side.inward_normal @ workpieces.blanks[side.part].up_direction)) < UPRIGHT_SIN:
                    sides[side.part].append(side)
    gutters = []
    for part, part_sides in sorted(sides.items()):
        places = [place for side in part_sides for place in _find_places(workpieces, side)]
        covered_span = shapely.LineString()
        for _ in range(MAX_GUTTERS):
            gains = [_make_span(place).difference(covered_span).length for place in places]
            if not gains or max(gains) < MIN_RANGE_MM:
                break
            is_long = np.array(gains) >= max(MIN_RANGE_MM, MIN_GAIN_SHARE * max(gains))
            travels_mm = np.where(is_long, [place.travel_mm for place in places], np.inf)
            best = _trim_place(
                places[int(np.lexsort((-np.array(gains), travels_mm.round(1)))[0])], covered_span
            )
            covered_span = covered_span.union(_make_span(best))
            places = [place for place in places if place.side is not best.side]
            groove = make_groove(part, best.line_mm, best.side.inward_normal, GUTTER_DEPTH_MM, WIDTH_RATIO)
            workpieces.add_tools([groove])
            gutters.append(Gutter(part, best.side.joint, best.line_mm, groove))
    return gutters


def _make_span(place: _Place) -> shapely.LineString:
    """Make a line from the lower to the upper height of a place."""
    return shapely.LineString([(place.low_mm, 0.0), (place.high_mm, 0.0)])


def _trim_place(place: _Place, covered_span: shapely.Geometry) -> _Place:
    """Trim a place to its longest range of heights without another gutter."""
    new_span = _make_span(place).difference(covered_span)
    longest = max(getattr(new_span, "geoms", [new_span]), key=lambda span: span.length)
    low_mm, _, high_mm, _ = longest.bounds
    shares = (np.array([low_mm, high_mm]) - place.low_mm) / (place.high_mm - place.low_mm)
    line_mm = place.line_mm[0] + shares[:, None] * (place.line_mm[1] - place.line_mm[0])
    return replace(place, line_mm=line_mm, low_mm=low_mm, high_mm=high_mm)


def _find_places(workpieces: Workpieces, side: Side) -> Iterator[_Place]:
    """Yield the places on a side where a gutter keeps its distance from the rim and from other tools."""
    reach_mm = GUTTER_DEPTH_MM + LIP_MM + RIM_MM + ROUNDING_MARGIN_MM
    free_area = workpieces.find_tool_area(side, GUTTER_DEPTH_MM).buffer(-reach_mm)
    if free_area.is_empty:
        return
    blank = workpieces.blanks[side.part]
    up = blank.up_direction
    infill_ends_mm = _find_infill_ends(blank)
    upwards = side.face.axes @ up
    frame = np.stack([[upwards[1], -upwards[0]], upwards]) / np.linalg.norm(upwards)
    rotated_area = shapely.transform(free_area, lambda flat: flat @ frame.T)
    low_x, low_y, high_x, high_y = rotated_area.bounds
    for x in np.arange(
        (low_x + high_x) / 2.0 % PLACE_PITCH_MM + low_x // PLACE_PITCH_MM * PLACE_PITCH_MM,
        high_x,
        PLACE_PITCH_MM,
    ):
        inside_line = rotated_area.intersection(shapely.LineString([(x, low_y - 1.0), (x, high_y + 1.0)]))
        for run in getattr(inside_line, "geoms", [inside_line]):
            if run.length >= MIN_RANGE_MM:
                ends = np.array(run.coords)[[0, -1]]
                line_mm = side.lift(ends[ends[:, 1].argsort()] @ frame)
                distances_mm = np.linalg.norm(infill_ends_mm - blank.flatten(line_mm[:1]), axis=2)
                travel_mm = float(distances_mm.min(axis=1).mean())
                low_mm, high_mm = (line_mm @ up).tolist()
                yield _Place(side, line_mm, low_mm, high_mm, travel_mm)


def _find_infill_ends(blank: Blank) -> Floats:
    """Find the points (2, 2, 2) on the bed where the infill of two successive layers begins and ends."""
    points_mm = blank.flatten(blank.solid.arrays()[0])
    coordinates_mm = points_mm @ INFILL_DIRECTIONS.T
    ends = np.stack([coordinates_mm.argmin(axis=0), coordinates_mm.argmax(axis=0)], axis=1)
    return np.asarray(points_mm[ends])
