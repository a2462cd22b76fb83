"""Order of the lines of a layer with as little travel as possible: of the walls of holes, and of the infill.

CuraEngine goes to the nearest line next, so that the head often travels to the far end of a part and back.
All walls of an outline or a hole stay together, and each wall begins at its seam. Lines of infill may be
printed backwards.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import dist

import numpy as np

from slicing.checks import Toolpath
from slicing.checks.section import Floats
from slicing.glued_parts.inner_walls import removes_inner_walls
from slicing.glued_parts.rewriting import Segment, change_moves, measure_extrusion_per_mm, measure_lengths_mm
from slicing.glued_parts.sides import (
    CLOSURE_TOLERANCE_MM,
    Bools,
    Indices,
    find_level_lines,
    measure_spare_times_s,
)
from slicing.glued_parts.stop_order import Stops, find_order
from slicing.glued_parts.travel import (
    MIN_SAVED_MM,
    SAVED_TIME_FACTOR,
    OuterWalls,
    Trail,
    list_runs,
    mark_level_travel,
    mark_moves_after_commands,
    mark_wipes,
    measure_length_mm,
)
from slicing.settings import EngineSettings

MAX_LINES = 24  # maximum number of lines whose order is changed; the search takes time
MIN_TRAVEL_MM = 20.0  # minimum travel of lines whose order is changed


@dataclass(frozen=True, slots=True)
class _Block:
    """Successive moves (k,) of walls, or of infill, and of the travel between them in a layer.

    Attributes
    ----------
    moves
        Numbers of the moves.
    lines
        Numbers of the moves of each line: of the walls of an outline or a hole, or of a line of infill.
    stops
        The same lines as stops.
    trail
        (k + 1, 2) points that the head passes.
    travel_mm
        Length of the travel between the lines.
    """

    moves: Indices
    lines: list[Indices]
    stops: Stops
    trail: Trail
    travel_mm: float


def reorder_outlines(gcode: bytes, path: Toolpath, settings: EngineSettings) -> bytes:
    """Reorder the walls of outlines and holes such that the head travels least.

    Lines stay as they are unless `removes_inner_walls`: otherwise, a longer travel might need a retraction.

    Parameters
    ----------
    gcode
        CuraEngine's output, in which all walls of an outline or a hole follow each other.
    path
        Moves and comments of the same file.
    settings
        Settings with which it was sliced.

    Returns
    -------
    bytes
        G-code with the same lines in another order; the same object if no order saves travel.

    Raises
    ------
    SliceRejected
        `FLAVOUR` if the changed file cannot be read; see `read_toolpath`.
    """
    if not removes_inner_walls(settings):
        return gcode
    lines = _Lines.from_path(path, settings)
    return _reorder(gcode, path, settings, lines, _list_blocks(path, lines, is_infill=False))


def reorder_infill(gcode: bytes, path: Toolpath, settings: EngineSettings) -> bytes:
    """Reorder and reverse lines of infill such that the head travels least; see `reorder_outlines`."""
    if not removes_inner_walls(settings):
        return gcode
    lines = _Lines.from_path(path, settings)
    return _reorder(gcode, path, settings, lines, _list_blocks(path, lines, is_infill=True))


def _reorder(
    gcode: bytes, path: Toolpath, settings: EngineSettings, lines: _Lines, blocks: Iterable[_Block]
) -> bytes:
    """Reorder the lines of blocks where that saves travel and no layer becomes too short."""
    segments: dict[int, list[Segment]] = {}
    outer_walls = OuterWalls(path)
    spare_s = measure_spare_times_s(path, settings)
    for block in blocks:
        layer = int(path.layer[block.lines[0][0]])
        order = find_order(block.stops)
        if order == [0, *range(1, block.stops.count + 1), 2 * block.stops.count + 1]:
            continue
        arrivals_mm, departures_mm = block.stops.list_arrivals_mm(), block.stops.list_departures_mm()
        area = outer_walls.build_travel_area(layer)
        routes = [block.trail.find_route(departures_mm[a], arrivals_mm[b], area) for a, b in pairwise(order)]
        saved_mm = block.travel_mm - sum(map(measure_length_mm, routes))
        saved_s = SAVED_TIME_FACTOR * saved_mm / settings.speed_travel_mm_s
        if saved_mm > MIN_SAVED_MM and saved_s <= spare_s.get(layer, 0.0):
            spare_s[layer] -= saved_s
            travel_mm_min = 60.0 * settings.speed_travel_mm_s
            segments |= _list_segments(path, lines, block, order[1:-1], routes, travel_mm_min)
    return change_moves(gcode, path, segments, settings)


@dataclass(frozen=True, slots=True)
class _Lines:
    """Moves (n,) of walls, outer walls, infill, travel and wipes; lengths and extrusion of all moves (n,)."""

    is_wall: Bools
    is_outer: Bools
    is_infill: Bools
    is_travel: Bools
    is_wipe: Bools
    lengths_mm: Floats
    extruded_per_mm: Floats

    @classmethod
    def from_path(cls, path: Toolpath, settings: EngineSettings) -> _Lines:
        """Find the walls and the infill of a toolpath."""
        is_line = find_level_lines(path)
        is_outer = is_line & path.is_feature("WALL-OUTER")
        return cls(
            is_outer | (is_line & path.is_feature("WALL-INNER")),
            is_outer,
            is_line & path.is_feature("FILL"),
            mark_level_travel(path),
            mark_wipes(path, settings),
            measure_lengths_mm(path),
            measure_extrusion_per_mm(path),
        )


def _list_blocks(path: Toolpath, lines: _Lines, *, is_infill: bool) -> Iterator[_Block]:
    """Yield the blocks of walls, or of infill, with several lines."""
    is_printed = lines.is_infill if is_infill else lines.is_wall
    is_linked = is_printed | (lines.is_travel & ~lines.is_wipe if is_infill else lines.is_travel)
    for moves in list_runs(is_linked[1:] & is_linked[:-1] & ~mark_moves_after_commands(path)[1:-1]):
        printed_moves = moves[is_printed[moves]]
        layers = np.unique(path.layer[printed_moves])
        if len(layers) != 1 or layers[0] <= 0:
            continue
        if is_infill:
            groups = np.split(printed_moves, np.flatnonzero(np.diff(printed_moves) != 1) + 1)
        else:
            groups = _list_outlines(path, lines, moves)
        if not 1 < len(groups) <= MAX_LINES:
            continue
        between = np.setdiff1d(moves, np.concatenate(groups), assume_unique=True)
        travel_mm = float(lines.lengths_mm[between].sum())
        if travel_mm >= MIN_TRAVEL_MM:
            points_mm = np.concatenate([path.start[moves[:1], :2], path.end[moves, :2]])
            begins_mm = path.start[[group[0] for group in groups], :2]
            ends_mm = path.end[[group[-1] for group in groups], :2]
            stops = Stops(begins_mm, ends_mm, points_mm[0], points_mm[-1], is_infill)
            yield _Block(moves, groups, stops, Trail(points_mm), travel_mm)


def _list_outlines(path: Toolpath, lines: _Lines, moves: Indices) -> list[Indices]:
    """List the walls of each outline or hole, and its wipe; none unless each ends with a closed loop."""
    outlines: list[Indices] = []
    wall_moves, outer_moves = moves[lines.is_wall[moves]], moves[lines.is_outer[moves]]
    for loop in np.split(outer_moves, np.flatnonzero(np.diff(outer_moves) != 1) + 1):
        if len(loop) == 0 or dist(path.start[loop[0], :2], path.end[loop[-1], :2]) > CLOSURE_TOLERANCE_MM:
            return []
        end = loop[-1] + 1
        while end <= moves[-1] and lines.is_wipe[end]:
            end += 1
        outlines.append(np.arange(wall_moves[0], end))
        wall_moves = wall_moves[wall_moves >= end]
    return outlines if len(wall_moves) == 0 else []


def _list_segments(
    path: Toolpath,
    lines: _Lines,
    block: _Block,
    order: Sequence[int],
    routes: Sequence[Floats],
    travel_mm_min: float,
) -> dict[int, list[Segment]]:
    """List the segments that replace the moves of a block; they are at its first move and its first line.

    Parameters
    ----------
    path, lines
        Moves of CuraEngine's output, and its lines.
    block
        The block.
    order
        Numbers of its lines in their new order, as of `find_order`.
    routes
        Travels (n, 2) before each line, and after the last one.
    travel_mm_min
        Feedrate of travel.
    """
    travels = [
        [Segment(x, y, travel_mm_min) for x, y in route[1:].tolist()] if measure_length_mm(route) else []
        for route in routes
    ]
    first, first_line = int(block.moves[0]), int(block.lines[0][0])
    segments: dict[int, list[Segment]] = {int(move): [] for move in block.moves}
    segments[first] = travels[0]
    new_segments: list[Segment] = []
    feature = path.feature[first_line]
    for stop, travel in zip(order, travels[1:], strict=True):
        is_reversed = stop > block.stops.count
        line = block.lines[(stop - 1) % block.stops.count]
        for move in (line[::-1] if is_reversed else line).tolist():
            is_changed = lines.extruded_per_mm[move] > 0.0 and path.feature[move] != feature
            feature = path.feature[move] if is_changed else feature
            x_mm, y_mm = (path.start if is_reversed else path.end)[move, :2].tolist()
            name = path.features[feature] if is_changed else ""
            new_segments.append(
                Segment(x_mm, y_mm, float(path.feed_mm_min[move]), float(lines.extruded_per_mm[move]), name)
            )
        new_segments += travel
    segments[first_line] = segments[first_line] + new_segments
    return segments
