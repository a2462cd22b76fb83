"""Order of the walls around a part and around its holes in a layer, with as little travel as possible.

CuraEngine begins at the walls that are nearest, so that the head often travels to the far end of a part and
back for a groove on a level face. All walls of an outline or a hole stay together, and each wall begins at
its seam.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise, permutations
from math import dist

import numpy as np
import numpy.typing as npt
import shapely

from slicing.checks import MotionLimits, Toolpath, change_times
from slicing.checks.section import Floats
from slicing.hidden_walls.inner_walls import removes_inner_walls
from slicing.hidden_walls.rewriting import Segment, measure_extrusion_per_mm, replace_moves
from slicing.hidden_walls.sides import (
    CLOSURE_TOLERANCE_MM,
    Bools,
    Indices,
    find_level_lines,
    measure_spare_times_s,
)
from slicing.hidden_walls.travel import (
    MIN_SAVED_MM,
    SAVED_TIME_FACTOR,
    OuterWalls,
    Trail,
    list_runs,
    mark_moves_after_commands,
    measure_length_mm,
)
from slicing.settings import EngineSettings

MAX_GROUPS = 6  # maximum number of groups whose order is changed; there are n! orders
MAX_TRIED_ORDERS = 4  # maximum number of orders whose travel is planned, the best by straight lines first
_WIPE_TOLERANCE_MM = 0.05  # maximum excess length of a wipe


@dataclass(frozen=True, slots=True)
class _Block:
    """Successive moves (k,) of walls and travel in a layer.

    Attributes
    ----------
    moves
        Numbers of the moves.
    trail
        (k + 1, 2) points that the head passes.
    groups
        Numbers of the moves of each outline or hole: its inner walls, then its outer wall with its wipe.
    travel_mm
        Length of the travel between the groups.
    """

    moves: Indices
    trail: Trail
    groups: list[Indices]
    travel_mm: float


@dataclass(slots=True)
class _Router:
    """Router of the travel between the groups of a block, which plans each travel once.

    Stops are numbered: 0 is the beginning of the block, k + 1 its end, and the others are its k groups.
    """

    block: _Block
    begins_mm: Floats
    ends_mm: Floats
    area: shapely.Geometry
    _routes: dict[tuple[int, int], Floats] = field(default_factory=dict)

    @classmethod
    def from_block(cls, path: Toolpath, block: _Block, area: shapely.Geometry) -> _Router:
        """Build the router of a block within an area."""
        firsts, lasts = ([group[index] for group in block.groups] for index in (0, -1))
        begin_mm, end_mm = block.trail.points_mm[:1], block.trail.points_mm[-1:]
        return cls(
            block,
            np.concatenate([begin_mm, path.start[firsts, :2], end_mm]),
            np.concatenate([begin_mm, path.end[lasts, :2], end_mm]),
            area,
        )

    def find_order(self) -> tuple[int, ...] | None:
        """Find the order of the stops with the least travel; None if none saves `MIN_SAVED_MM`."""
        orders = _list_orders(len(self.block.groups))
        distances_mm = np.hypot(*(self.ends_mm[:, None] - self.begins_mm).transpose(2, 0, 1))
        straight_mm = distances_mm[orders[:, :-1], orders[:, 1:]].sum(axis=1)
        best, max_mm = None, self.block.travel_mm - MIN_SAVED_MM
        for number in np.argsort(straight_mm, kind="stable")[:MAX_TRIED_ORDERS].tolist():
            if straight_mm[number] >= max_mm:
                break
            order = tuple(orders[number].tolist())
            travel_mm = sum(map(measure_length_mm, self.list_routes(order)))
            if travel_mm < max_mm:
                best, max_mm = order, travel_mm
        return best

    def list_routes(self, order: tuple[int, ...]) -> list[Floats]:
        """List the travels (n, 2) between the stops of an order."""
        return [self._find_route(stops) for stops in pairwise(order)]

    def _find_route(self, stops: tuple[int, int]) -> Floats:
        """Find the travel (n, 2) between two stops."""
        if stops not in self._routes:
            begin_mm, end_mm = self.ends_mm[stops[0]], self.begins_mm[stops[1]]
            self._routes[stops] = self.block.trail.find_route(begin_mm, end_mm, self.area)
        return self._routes[stops]


def reorder_loops(gcode: bytes, path: Toolpath, settings: EngineSettings) -> bytes:
    """Reorder the walls of outlines and holes such that the head travels least.

    Walls stay as they are unless `removes_inner_walls`: otherwise, a longer travel might need a retraction.

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
    segments: dict[int, list[Segment]] = {}
    if not removes_inner_walls(settings):
        return gcode
    outer_walls = OuterWalls(path)
    spare_s = measure_spare_times_s(path, float(settings.extruder["cool_min_layer_time"]))
    walls = _Walls.from_path(path, float(settings.extruder["wall_0_wipe_dist"]))
    for block in _list_blocks(path, walls):
        layer = int(path.layer[block.groups[0][0]])
        router = _Router.from_block(path, block, outer_walls.build_travel_area(layer))
        order = router.find_order()
        if order is None:
            continue
        routes = router.list_routes(order)
        saved_mm = block.travel_mm - sum(map(measure_length_mm, routes))
        saved_s = SAVED_TIME_FACTOR * saved_mm / settings.speed_travel_mm_s
        if saved_s <= spare_s.get(layer, 0.0):
            spare_s[layer] -= saved_s
            groups = [block.groups[stop - 1] for stop in order[1:-1]]
            travel_mm_min = 60.0 * settings.speed_travel_mm_s
            segments |= _list_segments(path, walls, block, groups, routes, travel_mm_min)
    if not segments:
        return gcode
    new_gcode = replace_moves(gcode, path, segments)
    return change_times(new_gcode, path, MotionLimits.from_settings(settings.global_))


@dataclass(frozen=True, slots=True)
class _Walls:
    """Moves (n,) of walls, of outer walls and of travel, and length and extrusion per mm of all moves (n,).

    `wipe_mm` is the length of the travel along an outer wall after its end.
    """

    is_wall: Bools
    is_outer: Bools
    is_travel: Bools
    lengths_mm: Floats
    extruded_per_mm: Floats
    wipe_mm: float

    @classmethod
    def from_path(cls, path: Toolpath, wipe_mm: float) -> _Walls:
        """Find the walls of a toolpath."""
        is_line = find_level_lines(path)
        is_outer = is_line & path.is_feature("WALL-OUTER")
        is_travel = (path.end[:, 2] == path.start[:, 2]) & (path.extruded_mm == 0.0)
        lengths_mm = np.hypot(*(path.end - path.start)[:, :2].T)
        return cls(
            is_outer | (is_line & path.is_feature("WALL-INNER")),
            is_outer,
            is_travel,
            lengths_mm,
            measure_extrusion_per_mm(path),
            wipe_mm,
        )


def _list_blocks(path: Toolpath, walls: _Walls) -> Iterator[_Block]:
    """Yield the blocks with several groups."""
    is_linked = walls.is_wall | walls.is_travel
    is_joined = is_linked[1:] & is_linked[:-1] & ~mark_moves_after_commands(path)[1:-1]
    for moves in list_runs(is_joined):
        layers = np.unique(path.layer[moves[walls.is_wall[moves]]])
        if len(layers) != 1 or layers[0] <= 0:
            continue
        groups = _list_groups(path, walls, moves)
        if 1 < len(groups) <= MAX_GROUPS:
            between = np.setdiff1d(moves, np.concatenate(groups), assume_unique=True)
            points_mm = np.concatenate([path.start[moves[:1], :2], path.end[moves, :2]])
            yield _Block(moves, Trail(points_mm), groups, float(walls.lengths_mm[between].sum()))


def _list_groups(path: Toolpath, walls: _Walls, moves: Indices) -> list[Indices]:
    """List the groups of successive moves (k,); none unless each of them ends with a closed outer wall."""
    groups: list[Indices] = []
    wall_moves, outer_moves = moves[walls.is_wall[moves]], moves[walls.is_outer[moves]]
    for loop in np.split(outer_moves, np.flatnonzero(np.diff(outer_moves) != 1) + 1):
        if len(loop) == 0 or dist(path.start[loop[0], :2], path.end[loop[-1], :2]) > CLOSURE_TOLERANCE_MM:
            return []
        wiped_mm = np.cumsum(walls.lengths_mm[loop[-1] + 1 : moves[-1] + 1])
        is_wipe = walls.is_travel[loop[-1] + 1 : moves[-1] + 1] & (
            wiped_mm < walls.wipe_mm + _WIPE_TOLERANCE_MM
        )
        end = loop[-1] + 1 + int(np.argmin(np.append(is_wipe, False)))
        groups.append(np.arange(wall_moves[0], end))
        wall_moves = wall_moves[wall_moves >= end]
    return groups if len(wall_moves) == 0 else []


def _list_segments(
    path: Toolpath,
    walls: _Walls,
    block: _Block,
    groups: Sequence[Indices],
    routes: Sequence[Floats],
    travel_mm_min: float,
) -> dict[int, list[Segment]]:
    """List the segments that replace the moves of a block; they are at its first move and its first wall.

    Parameters
    ----------
    path, walls
        Moves of CuraEngine's output, and its walls.
    block
        The block.
    groups
        Its groups in their new order.
    routes
        Travels (n, 2) before each group, and after the last one.
    travel_mm_min
        Feedrate of travel.
    """
    travels = [
        [Segment(x, y, travel_mm_min) for x, y in route[1:].tolist()] if measure_length_mm(route) else []
        for route in routes
    ]
    first, first_wall = int(block.moves[0]), int(block.groups[0][0])
    segments: dict[int, list[Segment]] = {int(move): [] for move in block.moves}
    segments[first] = travels[0]
    new_segments: list[Segment] = []
    feature = path.feature[first_wall]
    for group, travel in zip(groups, travels[1:], strict=True):
        for move in group.tolist():
            is_changed = path.extruded_mm[move] > 0.0 and path.feature[move] != feature
            feature = path.feature[move] if is_changed else feature
            x_mm, y_mm = path.end[move, :2].tolist()
            name = path.features[feature] if is_changed else ""
            new_segments.append(
                Segment(x_mm, y_mm, float(path.feed_mm_min[move]), float(walls.extruded_per_mm[move]), name)
            )
        new_segments += travel
    segments[first_wall] = segments[first_wall] + new_segments
    return segments


@lru_cache(maxsize=MAX_GROUPS)
def _list_orders(count: int) -> npt.NDArray[np.intp]:
    """List all orders (count!, count + 2) of the stops of a block with some number of groups."""
    inner = np.array(list(permutations(range(1, count + 1))), np.intp)
    return np.column_stack([np.zeros(len(inner), np.intp), inner, np.full(len(inner), count + 1)])
