"""Shorter travel beside removed walls: straight within the outer walls, not along the removed lines."""

from __future__ import annotations

from collections.abc import Iterator, MutableMapping

import numpy as np
import shapely
from shapely.ops import substring

from slicing.checks import Toolpath
from slicing.checks.section import Floats
from slicing.glued_parts.rewriting import Segment, measure_lengths_mm
from slicing.glued_parts.sides import Bools, Indices, find_level_lines
from slicing.settings import EngineSettings

Point = tuple[float, float]

MIN_SAVED_MM = 2.0  # minimum travel that another order saves in a layer
SAVED_TIME_FACTOR = 1.5
"""Factor by which omitted travel saves more time than its length over its speed, because the head also
accelerates less often. It keeps layers from becoming shorter than the minimum layer time."""
_EDGE_TOLERANCE_MM = 1e-6
_WIPE_TOLERANCE_MM = 0.05  # maximum excess length of a wipe
_TOLERANCE_MM = 0.05  # distance from the centre line of the outer wall within which the head may travel


def shorten_travel(
    path: Toolpath,
    first_share: Floats,
    last_share: Floats,
    is_skipped: Bools,
    segments: MutableMapping[int, list[Segment]],
) -> None:
    """Leave out points of successive travel moves if the travel then still stays within the outer walls.

    Parameters
    ----------
    path
        Moves of CuraEngine's output.
    first_share, last_share
        (n,) shares of each move, from its start, between which it is removed.
    is_skipped
        (n,) bool, true if a move belongs to a closed loop that is left out.
    segments
        Segments that replace moves; those of removed moves and of travel moves are changed.
    """
    outer_walls = OuterWalls(path)
    for moves in _list_gaps(path, first_share, last_share):
        moves = moves[~is_skipped[moves]]
        if len(moves) == 0:
            continue
        area = outer_walls.build_travel_area(int(path.layer[moves[-1]]))
        shares = np.where(last_share[moves] > first_share[moves], last_share[moves], 1.0)
        points_mm = path.start[moves, :2] + shares[:, None] * (path.end - path.start)[moves, :2]
        start_mm = path.start[moves[0], :2] + first_share[moves[0]] * (path.end - path.start)[moves[0], :2]
        for number in _list_omitted_points(np.vstack((start_mm, points_mm)), area):
            move = int(moves[number - 1])
            segments[move] = [segment for segment in segments.get(move, []) if segment.extruded_per_mm > 0.0]


def _list_omitted_points(points_mm: Floats, area: shapely.Geometry) -> Iterator[int]:
    """Yield the numbers of the points (n, 2) that a shorter path within an area omits."""
    current, final = 0, len(points_mm) - 1
    while current < final:
        reached = current + 1
        for target in range(final, current + 1, -1):
            if area.covers(shapely.LineString(points_mm[[current, target]])):
                reached = target
                break
        yield from range(current + 1, reached)
        current = reached


def _list_gaps(path: Toolpath, first_share: Floats, last_share: Floats) -> Iterator[Indices]:
    """Yield runs of successive moves without extrusion that include removed lines."""
    is_removed = last_share > first_share
    is_level = (path.end[:, 2] == path.start[:, 2]) & path.is_head_move
    is_gap = is_removed | (is_level & (path.extruded_mm == 0.0) & (path.layer >= 0))
    begin, end = np.where(is_removed, first_share, 0.0), np.where(is_removed, last_share, 1.0)
    is_joined = is_gap[1:] & is_gap[:-1] & (end[:-1] == 1.0) & (begin[1:] == 0.0)
    is_joined &= ~mark_moves_after_commands(path)[1:-1]
    is_joined &= path.end[1:, 2] == path.end[:-1, 2]
    removed_count = np.append(0, np.cumsum(is_removed))
    for moves in list_runs(is_joined):
        if removed_count[moves[-1] + 1] > removed_count[moves[0]]:
            yield moves


def mark_moves_after_commands(path: Toolpath) -> Bools:
    """Mark the moves (n,) that follow another command, and the end of the file (1,)."""
    is_after = np.zeros(len(path.start) + 1, np.bool_)
    is_after[[command.next_move for command in path.commands]] = True
    return is_after


def mark_level_travel(path: Toolpath) -> Bools:
    """Mark the moves (n,) without extrusion that stay on their level."""
    return np.asarray((path.end[:, 2] == path.start[:, 2]) & (path.extruded_mm == 0.0))


def mark_wipes(path: Toolpath, settings: EngineSettings) -> Bools:
    """Mark the moves (n,) of wipes: travel along an outer wall after its end."""
    max_mm = float(settings.extruder["wall_0_wipe_dist"]) + _WIPE_TOLERANCE_MM
    is_outer = find_level_lines(path) & path.is_feature("WALL-OUTER")
    is_travel = mark_level_travel(path)
    lengths_mm = measure_lengths_mm(path)
    is_wipe = np.zeros(len(is_outer), np.bool_)
    for move in (np.flatnonzero(is_outer[:-1] & ~is_outer[1:]) + 1).tolist():
        wipe_mm = lengths_mm[move]
        while is_travel[move] and wipe_mm < max_mm:
            is_wipe[move] = True
            move += 1
            if move == len(is_wipe):
                break
            wipe_mm += lengths_mm[move]
    return is_wipe


def list_runs(is_joined: Bools) -> Iterator[Indices]:
    """Yield runs of at least two successive moves.

    Parameters
    ----------
    is_joined
        (n - 1,) bool, true if a move is in one run with the next one.
    """
    bounds = np.flatnonzero(np.diff(is_joined.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    for low, high in bounds.tolist():
        yield np.arange(low, high + 1)


def measure_length_mm(points_mm: Floats) -> float:
    """Measure the length of a line through points (n, 2)."""
    return float(np.hypot(*np.diff(points_mm, axis=0).T).sum())


class Trail:
    """Points (n, 2) that the head passes in a layer, along which it also travels between two of them."""

    def __init__(self, points_mm: Floats) -> None:
        self.points_mm = points_mm
        self._closures = _find_closures(points_mm)

    def find_route(self, begin_mm: Floats | Point, end_mm: Floats | Point, area: shapely.Geometry) -> Floats:
        """Find the points (k, 2) of a travel between two points of the trail that stays within an area.

        It follows the edge of the area, or the trail in either direction, and leaves out points where it can.
        """
        straight = shapely.LineString([begin_mm, end_mm])
        if area.covers(straight):
            return np.array([begin_mm, end_mm])
        routes = list(_follow_edges(straight, area))
        begin, end = (int(np.argmin(np.hypot(*(self.points_mm - point).T))) for point in (begin_mm, end_mm))
        routes.append(self._list_points(begin, end))
        for first, second in self._closures:
            for near, far in ((first, second), (second, first)):
                routes.append(np.concatenate([self._list_points(begin, near), self._list_points(far, end)]))
        return _shorten_route(min(routes, key=measure_length_mm), area)

    def _list_points(self, begin: int, end: int) -> Floats:
        """List the points (k, 2) from one number to another, in either direction."""
        return self.points_mm[begin : end + 1] if begin <= end else self.points_mm[end : begin + 1][::-1]


def _follow_edges(straight: shapely.LineString, area: shapely.Geometry) -> Iterator[Floats]:
    """Yield the points (n, 2) of a travel that follows the edges of an area where a straight line leaves it.

    There is none if the line begins or ends outside, or passes from one edge to another.
    """
    polygons = [polygon for polygon in getattr(area, "geoms", [area]) if polygon.geom_type == "Polygon"]
    edges = [edge for polygon in polygons for edge in (polygon.exterior, *polygon.interiors)]
    # Nothing remains if the line is outside by no more than rounding.
    outside = shapely.get_parts(straight.difference(area))
    sections = [np.array(section.coords)[[0, -1]] for section in outside if not section.is_empty]
    start_mm, end_mm = np.array(straight.coords)
    points_mm = [start_mm[None]]
    for section in sorted(sections, key=lambda ends: float(np.hypot(*(ends[0] - start_mm)))):
        ends = [shapely.Point(point) for point in section]
        edge = min(edges, key=lambda edge: max(edge.distance(point) for point in ends))
        if max(edge.distance(point) for point in ends) > _EDGE_TOLERANCE_MM:
            return
        points_mm.append(_follow_ring(edge, *(edge.project(point) for point in ends)))
    yield np.concatenate([*points_mm, end_mm[None]])


def _follow_ring(ring: shapely.LinearRing, begin_mm: float, end_mm: float) -> Floats:
    """Find the points (n, 2) of the shorter way along a ring between two positions."""
    first_mm, last_mm = sorted((begin_mm, end_mm))
    line = shapely.LineString(ring.coords)
    way = np.array(substring(line, first_mm, last_mm).coords)
    if last_mm - first_mm > line.length / 2.0:
        ends = (substring(line, last_mm, line.length), substring(line, 0.0, first_mm))
        way = np.concatenate([np.array(end.coords) for end in ends])[::-1]
    return way if begin_mm <= end_mm else way[::-1]


def _find_closures(points_mm: Floats) -> list[tuple[int, int]]:
    """Find pairs of points (n, 2) at the same place, by their numbers; a point is in one pair."""
    closures: dict[Point, tuple[int, int]] = {}
    for number, (x_mm, y_mm) in enumerate(points_mm.round(2).tolist()):
        first, _ = closures.get((x_mm, y_mm), (number, number))
        closures[x_mm, y_mm] = (first, number)
    return [(first, last) for first, last in closures.values() if last > first + 1]


def _shorten_route(points_mm: Floats, area: shapely.Geometry) -> Floats:
    """Leave out points (n, 2) of a travel within an area that a shorter travel does not need."""
    omitted = list(_list_omitted_points(points_mm, area))
    return np.delete(points_mm, omitted, axis=0)


class OuterWalls:
    """Outer walls of a toolpath, with the areas within which the head travels in a layer."""

    def __init__(self, path: Toolpath) -> None:
        self._path = path
        self._moves = np.flatnonzero(find_level_lines(path) & path.is_feature("WALL-OUTER"))
        self._areas: dict[int, shapely.Geometry] = {}

    def build_travel_area(self, layer: int) -> shapely.Geometry:
        """Build the area within the centre lines of a layer's outer walls, once for each layer."""
        if layer not in self._areas:
            in_layer = slice(*np.searchsorted(self._path.layer[self._moves], (layer, layer + 1)))
            self._areas[layer] = self._build_area(self._moves[in_layer])
        return self._areas[layer]

    def _build_area(self, moves: Indices) -> shapely.Geometry:
        """Build the area within the centre lines of outer walls with moves (k,)."""
        area: shapely.Geometry = shapely.Polygon()
        for ring in np.split(moves, np.flatnonzero(np.diff(moves) != 1) + 1):
            if len(ring) > 2:
                ring_area = shapely.make_valid(shapely.Polygon(self._path.end[ring, :2]))
                area = area.symmetric_difference(ring_area)
        area = area.buffer(_TOLERANCE_MM)
        shapely.prepare(area)
        return area
