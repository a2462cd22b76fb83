"""Gutters: upright grooves on hidden faces, which hide the seams of the outer walls and leave space for glue.

The slicer starts each loop of the outer wall at its sharpest inner corner. If there is no inner corner, the
loop starts at an edge between two cut faces, or at a fold of the visible surface, and leaves a bump there. A
gutter is sharper than the grooves of keys and marks, so that no bump is left in the groove of a key.

After the outer wall, the print head travels to the beginning or the end of the infill, which is at a corner
of the part. So gutters are placed near corners.
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
PLACE_PITCH_MM = 4.0  # distance between the places that are tried
MIN_RANGE_MM = 15.0  # minimum range of heights that a gutter adds to those of the earlier gutters
MAX_GUTTERS = 3  # maximum number of gutters of a part
MIN_GAIN_SHARE = 0.7  # minimum additional range of a gutter, as a share of the largest possible one
# Directions perpendicular to the infill lines of two successive layers; the first and the last infill line
# are at the ends of the part along these directions.
INFILL_DIRECTIONS = np.array([[1.0, 1.0], [1.0, -1.0]])
ROUNDING_MARGIN_MM = 0.05  # margin for shapely's buffers, which may cut off inner corners
GUTTER_DEPTH_MM = 0.4
WIDTH_RATIO = 0.9  # half the width of a gutter divided by its depth; the angle of the V is 84 degrees


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Line (2, 3) on a side from its lower to its upper end, and the heights of both ends in the part's pose.

    `travel_mm` is the distance from the line to the nearer end of the infill, as the mean over two layers.
    """

    side: Side
    line_mm: Floats
    low_mm: float
    high_mm: float
    travel_mm: float


def place_gutters(workpieces: Workpieces, joints: Sequence[Joint]) -> list[Gutter]:
    """Place gutters on the upright faces of each part, so that most layers of the part have a gutter.

    The grooves of the gutters are added to the tools of the workpieces.

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
    """Make the interval of heights of a place, as a line along the x axis."""
    return shapely.LineString([(place.low_mm, 0.0), (place.high_mm, 0.0)])


def _trim_place(place: _Place, covered_span: shapely.Geometry) -> _Place:
    """Trim a place to the longest interval of its heights that no other gutter covers."""
    new_span = _make_span(place).difference(covered_span)
    longest = max(getattr(new_span, "geoms", [new_span]), key=lambda span: span.length)
    low_mm, _, high_mm, _ = longest.bounds
    shares = (np.array([low_mm, high_mm]) - place.low_mm) / (place.high_mm - place.low_mm)
    line_mm = place.line_mm[0] + shares[:, None] * (place.line_mm[1] - place.line_mm[0])
    return replace(place, line_mm=line_mm, low_mm=low_mm, high_mm=high_mm)


def _find_places(workpieces: Workpieces, side: Side) -> Iterator[_Place]:
    """Yield the places on a side where a gutter is far enough from the border of the face and other tools."""
    margin_mm = GUTTER_DEPTH_MM + LIP_MM + RIM_MM + ROUNDING_MARGIN_MM
    free_area = workpieces.find_tool_area(side, GUTTER_DEPTH_MM).buffer(-margin_mm)
    if free_area.is_empty:
        return
    blank = workpieces.blanks[side.part]
    up = blank.up_direction
    infill_ends_mm = _find_infill_ends(blank)
    upwards = side.face.axes @ up
    frame = np.stack([[upwards[1], -upwards[0]], upwards]) / np.linalg.norm(upwards)
    rotated_area = shapely.transform(free_area, lambda coordinates_mm: coordinates_mm @ frame.T)
    low_x, low_y, high_x, high_y = rotated_area.bounds
    for x in np.arange(
        (low_x + high_x) / 2.0 % PLACE_PITCH_MM + low_x // PLACE_PITCH_MM * PLACE_PITCH_MM,
        high_x,
        PLACE_PITCH_MM,
    ):
        inside_line = rotated_area.intersection(shapely.LineString([(x, low_y - 1.0), (x, high_y + 1.0)]))
        for segment in getattr(inside_line, "geoms", [inside_line]):
            if segment.length >= MIN_RANGE_MM:
                ends = np.array(segment.coords)[[0, -1]]
                line_mm = side.compute_points_mm(ends[ends[:, 1].argsort()] @ frame)
                distances_mm = np.linalg.norm(infill_ends_mm - blank.project_onto_bed(line_mm[:1]), axis=2)
                travel_mm = float(distances_mm.min(axis=1).mean())
                low_mm, high_mm = (line_mm @ up).tolist()
                yield _Place(side, line_mm, low_mm, high_mm, travel_mm)


def _find_infill_ends(blank: Blank) -> Floats:
    """Find the points on the bed where the infill of two successive layers begins and ends.

    Returns
    -------
    ndarray
        (layers, beginning and end, x and y) coordinates in mm.
    """
    points_mm = blank.project_onto_bed(blank.solid.arrays()[0])
    coordinates_mm = points_mm @ INFILL_DIRECTIONS.T
    ends = np.stack([coordinates_mm.argmin(axis=0), coordinates_mm.argmax(axis=0)], axis=1)
    return np.asarray(points_mm[ends])
