"""Places of marks: on both faces of each joint, the number of the other part and an upward arrow.

On one face of each part, the part's own number precedes the other number. Only one face has it, because each
digit takes print time. If possible, this face is upright while the part is printed.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.assembly import Assembly
from decompose.connectors.faces import Side, Workpieces, find_sides
from decompose.connectors.gutters import GUTTER_DEPTH_MM
from decompose.connectors.records import RIM_MM, Mark
from decompose.connectors.strokes import GRID_HEIGHT, draw_strokes, measure_text_width
from decompose.connectors.tools import (
    HALF_RIDGE_MM,
    LIP_MM,
    MAX_GROOVE_SIN,
    compute_overhang_sin,
    make_groove,
    needs_bridge,
)
from decompose.pieces import Joint, list_polygons

LETTER_HEIGHT_MM = 4.0  # low, because on upright faces each layer through a letter takes time
LETTER_DEPTH_MM = 0.35  # depth of the grooves of letters; at 0.3 mm, some do not appear in the G-code
ARROW = "^"
ARROW_CELL = 7.0  # width reserved for the arrow, in units of the letters' grid
MAX_DOTS = 3  # maximum number of dots of a mark
DOT_PITCH = 4.0  # distance between two dots, in units of the letters' grid
DEPTH_STEP_MM = 0.002  # strokes differ in depth by this, because boolean operations fail where faces coincide
PLACE_PITCH_MM = 2.0  # distance between the places that are tried
# Minimum cosine between the vertical and the normal of a face on which the arrow points to the model's back.
LEVEL_COS = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class _TextLayout:
    """A text, the height of its letters and the depth of its grooves.

    Its strokes (k, 2, 2) are around the origin; `half_extents_mm` (2,) are half the sides of their bounding
    box.
    """

    text: str
    height_mm: float
    depth_mm: float
    strokes_mm: Floats
    half_extents_mm: Floats


def place_marks(
    workpieces: Workpieces, joints: Sequence[Joint], assembly: Assembly
) -> tuple[list[Mark], list[tuple[int, str]]]:
    """Place the marks of all joints, and add their grooves to the tools of the workpieces.

    Parameters
    ----------
    workpieces
        Parts, with the tools placed so far; the new tools are added.
    joints, assembly
        Joints of these parts, and the order in which they are glued.

    Returns
    -------
    list of Mark
        Marks in the order of the joints.
    list of (int, str)
        Joints with an unmarked face, and the reason.
    """
    steps = {joint: number for number, step in enumerate(assembly.steps) for joint in step.joints}
    marks: list[Mark] = []
    numbered_parts: set[int] = set()
    unmarked_joints = []
    for number, joint in enumerate(joints):
        pairs = sorted(find_sides(workpieces.blanks, number, joint), key=lambda pair: -pair[0].face.area_mm2)
        new_marks = _mark_joint(workpieces, pairs, numbered_parts, 1 + steps.get(number, 0) % MAX_DOTS)
        marks += new_marks
        numbered_parts |= {mark.part for mark in new_marks if mark.text[0] not in "-."}
        if len(new_marks) < 2:
            needs_support = any(_needs_support(workpieces, side) for pair in pairs[:1] for side in pair)
            unmarked_joints.append(
                (number, "a face overhangs in its part's pose" if needs_support else "too small")
            )
    return marks + _number_parts(workpieces, joints, numbered_parts), unmarked_joints


def _mark_joint(
    workpieces: Workpieces, pairs: Sequence[tuple[Side, Side]], numbered_parts: Set[int], dot_count: int
) -> list[Mark]:
    """Mark both sides of the largest face that has space on both, else one side; without space, draw dots."""
    best_marks: list[Mark] = []
    for pair in pairs:
        marks = [
            _place_text(workpieces, side, _list_texts(workpieces, side, other, side.part in numbered_parts))
            for side, other in (pair, pair[::-1])
        ]
        placed_marks = [mark for mark in marks if mark is not None]
        if len(placed_marks) > len(best_marks):
            best_marks = placed_marks
        if len(best_marks) == 2:
            break
    if not best_marks and pairs:
        dot_marks = [_place_text(workpieces, side, [_draw_dots(dot_count)]) for side in pairs[0]]
        best_marks = [mark for mark in dot_marks if mark is not None]
    for mark in best_marks:
        workpieces.add_tools(mark.grooves)
    return best_marks


def _number_parts(workpieces: Workpieces, joints: Sequence[Joint], numbered_parts: Set[int]) -> list[Mark]:
    """Mark each part with its own number if no other mark on it shows that number."""
    new_marks = []
    for part, blank in enumerate(workpieces.blanks):
        if part in numbered_parts:
            continue
        sides = [
            side
            for number, joint in enumerate(joints)
            if part in (joint.a, joint.b)
            for pair in find_sides(workpieces.blanks, number, joint)
            for side in pair
            if side.part == part
        ]
        text = _lay_out_text(blank.name, "")
        for side in sorted(sides, key=lambda side: (workpieces.is_level(side), -side.face.area_mm2)):
            mark = _place_text(workpieces, side, [text])
            if mark is not None:
                workpieces.add_tools(mark.grooves)
                new_marks.append(mark)
                break
    return new_marks


def _list_texts(workpieces: Workpieces, side: Side, other: Side, is_numbered: bool) -> list[_TextLayout]:
    """List the texts for a side, the preferred one first; a numbered part already shows its own number."""
    own = "" if workpieces.is_level(side) or is_numbered else workpieces.blanks[side.part].name
    numbers = f"{own}-{workpieces.blanks[other.part].name}"
    return [_lay_out_text(numbers, ARROW), _lay_out_text(numbers, "")]


def _lay_out_text(numbers: str, arrow: str) -> _TextLayout:
    """Lay out part numbers, followed by an arrow if one is given."""
    strokes, width = draw_strokes(numbers), measure_text_width(numbers)
    if arrow:
        left, right = np.array([[ARROW_CELL / 2.0, 0.0], [width / 2.0, 0.0]])
        strokes = np.concatenate([strokes - left, draw_strokes(arrow) + right])
        width += ARROW_CELL
    scale = LETTER_HEIGHT_MM / GRID_HEIGHT
    half_extents_mm = np.array([width, GRID_HEIGHT]) * scale / 2.0
    return _TextLayout(numbers + arrow, LETTER_HEIGHT_MM, LETTER_DEPTH_MM, strokes * scale, half_extents_mm)


def _draw_dots(count: int) -> _TextLayout:
    """Draw a row of dots."""
    pitch_mm = DOT_PITCH * LETTER_HEIGHT_MM / GRID_HEIGHT
    centres_mm = np.zeros((count, 2, 2))
    centres_mm[:, :, 0] = ((np.arange(count) - (count - 1) / 2.0) * pitch_mm)[:, None]
    centres_mm[:, :, 0] += [-HALF_RIDGE_MM, HALF_RIDGE_MM]
    half_extents_mm = np.array([(count - 1) * pitch_mm / 2.0 + HALF_RIDGE_MM, 0.0])
    return _TextLayout("." * count, 2.0 * LETTER_DEPTH_MM, LETTER_DEPTH_MM, centres_mm, half_extents_mm)


def _needs_support(workpieces: Workpieces, side: Side) -> bool:
    """Check whether every groove on a face would need support, whatever its direction."""
    cone = make_groove(side.part, np.zeros((2, 3)), side.inward_normal)
    return (
        compute_overhang_sin(cone.points_mm, side.inward_normal, workpieces.blanks[side.part].up_direction)
        > MAX_GROOVE_SIN
    )


def _place_text(workpieces: Workpieces, side: Side, texts: Sequence[_TextLayout]) -> Mark | None:
    """Place the first text that fits on a side of a joint, horizontally or rotated by 90 degrees."""
    if _needs_support(workpieces, side):
        return None
    # Use the area for gutters, which is cached: finding an area takes longer than placing a text.
    depth_mm = max(GUTTER_DEPTH_MM, *(text.depth_mm for text in texts))
    free_area = workpieces.find_tool_area(side, depth_mm)
    up_direction = _find_up_direction(side)
    for text in texts:
        for quarter_turns in range(2):
            frame = _build_text_frame(side, up_direction, quarter_turns)
            rotated_area = shapely.transform(
                free_area, lambda area_mm, frame=frame: side.compute_points_mm(area_mm) @ frame[:2].T
            )
            middle_mm = _find_middle(rotated_area, text.half_extents_mm + text.depth_mm + LIP_MM + RIM_MM)
            if middle_mm is None:
                continue
            strokes_mm = _keep_arrow_up(text, quarter_turns) + middle_mm
            return _engrave_text(
                workpieces, side, text, strokes_mm @ frame[:2] + side.face.offset_mm * side.face.normal
            )
    return None


def _keep_arrow_up(text: _TextLayout, quarter_turns: int) -> Floats:
    """Rotate the arrow of a rotated text back so that it points up, and return all strokes (k, 2, 2)."""
    if not quarter_turns or not text.text.endswith(ARROW):
        return text.strokes_mm
    count = len(draw_strokes(ARROW))
    arrow = text.strokes_mm[-count:]
    centre = np.array([text.half_extents_mm[0] - ARROW_CELL / 2.0 * text.height_mm / GRID_HEIGHT, 0.0])
    rotated_arrow = (arrow - centre) @ np.array([[0.0, -1.0], [1.0, 0.0]]) + centre
    return np.concatenate([text.strokes_mm[:-count], rotated_arrow])


def _engrave_text(workpieces: Workpieces, side: Side, text: _TextLayout, lines_mm: Floats) -> Mark | None:
    """Make the mark of a text with strokes (k, 2, 3) on a side; None if a groove needs support."""
    grooves = tuple(
        make_groove(side.part, line, side.inward_normal, text.depth_mm - DEPTH_STEP_MM * (n % 16))
        for n, line in enumerate(lines_mm)
    )
    up = workpieces.blanks[side.part].up_direction
    for groove in grooves:
        overhang_sin = compute_overhang_sin(groove.points_mm, side.inward_normal, up)
        if overhang_sin > MAX_GROOVE_SIN or needs_bridge(groove, up):
            return None
    return Mark(side.part, side.joint, text.text, text.height_mm, lines_mm, grooves)


def _find_up_direction(side: Side) -> Floats:
    """Find the direction (3,) of an arrow: to the model's top; on a horizontal face, to the model's back."""
    target = np.eye(3)[1 if abs(side.face.normal[2]) > LEVEL_COS else 2]
    projection = target - (target @ side.face.normal) * side.face.normal
    return np.asarray(projection / np.linalg.norm(projection))


def _build_text_frame(side: Side, up_direction: Floats, quarter_turns: int) -> Floats:
    """Build the frame (3, 3) of a text that is read from outside: along the text, up, and out of the face."""
    out = -side.inward_normal
    right = np.cross(up_direction, out)
    return np.stack([up_direction, -right, out]) if quarter_turns else np.stack([right, up_direction, out])


def _find_middle(area: shapely.Geometry, half_extents_mm: Floats) -> Floats | None:
    """Find the middle (2,) for a rectangle inside an area, as near as possible to the area's widest place."""
    polygons = [polygon for polygon in list_polygons(area) if polygon.area > 0.0]
    if not polygons:
        return None
    widest_place_mm = shapely.maximum_inscribed_circle(
        max(polygons, key=lambda polygon: polygon.area)
    ).coords[0]
    low_x, low_y, high_x, high_y = area.bounds
    low_mm, high_mm = np.array([low_x, low_y]) + half_extents_mm, np.array([high_x, high_y]) - half_extents_mm
    if (low_mm > high_mm).any():
        return None
    spans = [
        np.append(np.arange(a, b, PLACE_PITCH_MM), [b, (a + b) / 2.0])
        for a, b in zip(low_mm, high_mm, strict=True)
    ]
    centres_mm = np.array(np.meshgrid(*spans)).reshape(2, -1).T
    centres_mm = centres_mm[np.argsort(np.linalg.norm(centres_mm - widest_place_mm, axis=1), kind="stable")]
    shapely.prepare(area)
    boxes = shapely.box(*(centres_mm - half_extents_mm).T, *(centres_mm + half_extents_mm).T)
    inside_numbers = np.flatnonzero(shapely.contains(area, boxes))
    return None if not len(inside_numbers) else np.asarray(centres_mm[inside_numbers[0]])
