"""Removal of inner walls along the hidden sides of a part: the infill there reaches the outer wall.

CuraEngine prints the same number of walls all around a layer, so the lines are removed from its G-code, and
the infill beside them is extended by the distance between two walls.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slicing.checks import Toolpath
from slicing.checks.section import Floats
from slicing.glued_parts.infill import Backing, Stretch, extend_infill
from slicing.glued_parts.loops import find_sides, list_loop_runs, list_loops
from slicing.glued_parts.rewriting import Segment, change_moves, measure_extrusion_per_mm
from slicing.glued_parts.sides import (
    TRANSITION_MM,
    Bools,
    HiddenSide,
    find_bed_points,
    find_level_lines,
    list_wall_lines,
    measure_spare_times_s,
)
from slicing.glued_parts.travel import shorten_travel
from slicing.settings import EngineSettings

MIN_REMOVED_MM = 10.0
"""Minimum length that is removed from a wall."""
_SAVED_TIME_FACTOR = 1.1
"""Ratio of the time that the removal of a line saves to its length divided by its speed, as the head also
accelerates less often. With this factor, no layer becomes shorter than the minimum layer time."""


@dataclass(frozen=True, slots=True)
class _Removal:
    """Removed parts of the moves of inner walls.

    Attributes
    ----------
    first_share, last_share
        (n,) shares of each move, from its start, between which it is removed; equal if nothing is.
    is_skipped
        (n,) bool, true for moves that are left out without a travel in their place.
    stretches
        Parts of hidden sides along which the wall is removed.
    """

    first_share: Floats
    last_share: Floats
    is_skipped: Bools
    stretches: list[Stretch]


def removes_inner_walls(settings: EngineSettings) -> bool:
    """Check whether inner walls along hidden sides are removed with these settings.

    The head travels along removed lines without a retraction, so CuraEngine has to do without one as well: it
    combs over any distance, or never retracts.
    """
    values = {**settings.global_, **settings.extruder}
    is_combing_limited = float(values["retraction_combing_max_distance"]) > 0.0
    retracts = values["retraction_enable"] == "True"
    retracts &= values["retraction_combing"] == "off" or is_combing_limited
    return settings.has_single_hidden_walls and len(list_wall_lines(settings)) == 2 and not retracts


def remove_inner_walls(
    gcode: bytes, path: Toolpath, sides: Sequence[HiddenSide], settings: EngineSettings
) -> bytes:
    """Remove the inner wall along hidden sides, if `removes_inner_walls`.

    A layer keeps its inner wall where infill does not support the outer wall (`Backing.supports`), and within
    `TRANSITION_MM` of skin or of a wall that stays.

    Parameters
    ----------
    gcode
        CuraEngine's output.
    path
        Moves and comments of the same file.
    sides
        Hidden sides of the part, in its place on the bed.
    settings
        Settings with which it was sliced.

    Returns
    -------
    bytes
        G-code in which the head skips the removed lines or travels along them.
    """
    if not removes_inner_walls(settings):
        return gcode
    wall_lines = list_wall_lines(settings)
    points_mm = find_bed_points(path, settings)
    spacing_mm = wall_lines[1].depth_mm - wall_lines[0].depth_mm
    infill_depth_mm = wall_lines[1].depth_mm + settings.line_width_mm / 2.0  # minimum depth of its lines
    backing = Backing.from_path(path, points_mm, sides, wall_lines[0].depth_mm, infill_depth_mm)
    removal = _find_removal(path, points_mm, sides, settings, wall_lines[1].depth_mm, backing)
    if not removal.stretches:
        return gcode
    travel_mm_min = 60.0 * settings.speed_travel_mm_s
    segments = dict(_list_replacement_segments(path, removal, travel_mm_min))
    segments |= extend_infill(path, points_mm[1], sides, removal.stretches, infill_depth_mm, spacing_mm)
    shorten_travel(path, removal.first_share, removal.last_share, removal.is_skipped, segments)
    return change_moves(gcode, path, segments, settings)


def _find_removal(
    path: Toolpath,
    points_mm: tuple[Floats, Floats],
    sides: Sequence[HiddenSide],
    settings: EngineSettings,
    wall_depth_mm: float,
    backing: Backing,
) -> _Removal:
    """Find the moves of inner walls at the depth `wall_depth_mm` that are removed."""
    count = len(path.layer)
    removal = _Removal(np.zeros(count), np.zeros(count), np.zeros(count, np.bool_), [])
    spare_s = measure_spare_times_s(path, settings)
    is_line = find_level_lines(path) & (path.layer > 0)
    wall_moves = np.flatnonzero(is_line & path.is_feature("WALL-INNER"))
    if len(wall_moves) == 0:
        return removal
    loops = list_loops(path, wall_moves, points_mm)
    side_numbers = find_sides(loops, points_mm, sides, wall_depth_mm)
    for loop in loops:
        for moves in list_loop_runs(loop, side_numbers[loop.moves] >= 0):
            layer = int(path.layer[moves[0]])
            starts_mm, deltas_mm = points_mm[0][moves], points_mm[1][moves] - points_mm[0][moves]
            lengths_mm = np.hypot(*deltas_mm.T)
            is_ring = loop.is_closed and len(moves) == len(loop.moves)
            numbers = side_numbers[moves]
            skin_mm = _find_skin_mm(layer, numbers, (starts_mm, starts_mm + deltas_mm), sides, backing)
            is_whole = is_ring and len(skin_mm) == 0
            first, last = _clip_run(lengths_mm, skin_mm, 0.0 if is_whole else TRANSITION_MM)
            removed_mm = (last - first) * lengths_mm
            saved_s = _SAVED_TIME_FACTOR * float((removed_mm * 60.0 / path.feed_mm_min[moves]).sum())
            if float(removed_mm.sum()) < MIN_REMOVED_MM or saved_s > spare_s.get(layer, 0.0):
                continue
            end_points_mm = [starts_mm + share[:, None] * deltas_mm for share in (first, last)]
            stretches = _list_stretches(layer, numbers, end_points_mm, last > first, sides)
            if stretches and backing.supports(stretches):
                removal.first_share[moves], removal.last_share[moves] = first, last
                removal.is_skipped[moves] = is_whole
                removal.stretches.extend(stretches)
                spare_s[layer] -= saved_s
    return removal


def _find_skin_mm(
    layer: int,
    side_numbers: npt.NDArray[np.int_],
    end_points_mm: tuple[Floats, Floats],
    sides: Sequence[HiddenSide],
    backing: Backing,
) -> Floats:
    """Find the skin beside a run: distances (s,) along the run from its start, in ascending order.

    Parameters
    ----------
    layer
        Number of the layer.
    side_numbers
        (k,) number of the side of each move.
    end_points_mm
        Starts (k, 2) and ends (k, 2) of the moves.
    sides, backing
        Hidden sides of the part, and the skin beside each.
    """
    begin_mm = np.cumsum(lengths_mm := np.hypot(*(end_points_mm[1] - end_points_mm[0]).T)) - lengths_mm
    skin_mm = [np.zeros(0)]
    for number in np.unique(side_numbers):
        on_side = np.flatnonzero(side_numbers == number)
        first_mm, last_mm = (sides[number].measure_positions_mm(points[on_side]) for points in end_points_mm)
        lows_mm, highs_mm = np.minimum(first_mm, last_mm), np.maximum(first_mm, last_mm)
        stretch = Stretch(layer, int(number), float(lows_mm.min()), float(highs_mm.max()))
        positions_mm = backing.skin[number].find_positions_mm(stretch, TRANSITION_MM)
        positions_mm = positions_mm.clip(stretch.low_mm, stretch.high_mm)
        point, move = np.nonzero((positions_mm[:, None] >= lows_mm) & (positions_mm[:, None] <= highs_mm))
        share = (positions_mm[point] - first_mm[move]) / np.where(
            highs_mm > lows_mm, last_mm - first_mm, 1.0
        )[move]
        skin_mm.append(begin_mm[on_side[move]] + share * lengths_mm[on_side[move]])
    return np.sort(np.concatenate(skin_mm))


def _clip_run(lengths_mm: Floats, skin_mm: Floats, margin_mm: float) -> tuple[Floats, Floats]:
    """Clip a run to its longest part without skin, less a margin at each end.

    Parameters
    ----------
    lengths_mm
        (k,) lengths of the moves.
    skin_mm
        (s,) distances from the start of the run at which skin is beside it, in ascending order.
    margin_mm
        Margin at each end.

    Returns
    -------
    tuple
        Shares (k,) of the moves, from their starts, between which the clipped run lies.
    """
    end_mm = np.cumsum(lengths_mm)
    begin_mm = end_mm - lengths_mm
    limits_mm = np.concatenate([[0.0], skin_mm, end_mm[-1:]])
    longest = int(np.argmax(np.diff(limits_mm)))
    low_mm, high_mm = limits_mm[longest] + margin_mm, limits_mm[longest + 1] - margin_mm
    first, last = (np.clip((mm - begin_mm) / lengths_mm, 0.0, 1.0) for mm in (low_mm, high_mm))
    return first, np.maximum(first, last)


def _list_stretches(
    layer: int,
    side_numbers: npt.NDArray[np.int_],
    end_points_mm: Sequence[Floats],
    is_removed: Bools,
    sides: Sequence[HiddenSide],
) -> list[Stretch]:
    """List the stretches of a run, one for each side in succession, from the ends of the removed lines."""
    stretches = []
    for moves in np.split(np.arange(len(side_numbers)), np.flatnonzero(np.diff(side_numbers)) + 1):
        moves = moves[is_removed[moves]]
        if len(moves) > 0:
            number = int(side_numbers[moves[0]])
            points_mm = np.concatenate([points[moves] for points in end_points_mm])
            positions_mm = sides[number].measure_positions_mm(points_mm)
            stretches.append(Stretch(layer, number, float(positions_mm.min()), float(positions_mm.max())))
    return stretches


def _list_replacement_segments(
    path: Toolpath, removal: _Removal, travel_mm_min: float
) -> Iterator[tuple[int, list[Segment]]]:
    """Yield the segments that replace each move of a removed wall: the removed part becomes travel."""
    extruded_per_mm = measure_extrusion_per_mm(path)
    for move in np.flatnonzero(removal.last_share > removal.first_share).tolist():
        start_mm, feed_mm_min = path.start[move, :2], float(path.feed_mm_min[move])
        delta_mm = path.end[move, :2] - start_mm
        first, last = float(removal.first_share[move]), float(removal.last_share[move])
        extrusion = float(extruded_per_mm[move])
        pieces = [(first, feed_mm_min, extrusion), (last, travel_mm_min, 0.0), (1.0, feed_mm_min, extrusion)]
        segments = []
        begin = 0.0
        for end, speed_mm_min, extruded_mm_per_mm in [] if removal.is_skipped[move] else pieces:
            if end > begin:
                x_mm, y_mm = start_mm + end * delta_mm
                segments.append(Segment(float(x_mm), float(y_mm), speed_mm_min, extruded_mm_per_mm))
            begin = end
        yield move, segments
