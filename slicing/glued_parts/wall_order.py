"""Order of the remaining pieces of inner walls, with as little travel as possible.

CuraEngine begins an inner wall where the outer wall begins. If a part of it is removed, the head would travel
to that place, and along the removed line, in each layer. The pieces are printed in another order, or
backwards, instead. The outer walls and the infill stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import permutations, product
from math import dist

import numpy as np
import shapely

from slicing.checks import Toolpath
from slicing.checks.section import Floats
from slicing.glued_parts.inner_walls import removes_inner_walls
from slicing.glued_parts.rewriting import Segment, change_moves, measure_extrusion_per_mm, measure_lengths_mm
from slicing.glued_parts.sides import CLOSURE_TOLERANCE_MM, Indices, find_level_lines, measure_spare_times_s
from slicing.glued_parts.travel import (
    MIN_SAVED_MM,
    SAVED_TIME_FACTOR,
    OuterWalls,
    Point,
    Trail,
    list_runs,
    mark_level_travel,
    mark_moves_after_commands,
    measure_length_mm,
)
from slicing.settings import EngineSettings

MAX_PIECES = 4  # maximum number of pieces whose order is changed; there are n! 2^n orders
MAX_TRIED_ORDERS = 6  # maximum number of orders whose travel is planned, the best by straight lines first

Order = tuple[tuple[int, bool], ...]  # pieces by number, and whether each is printed backwards


@dataclass(frozen=True, slots=True)
class _Piece:
    """Successive lines of an inner wall: its points (k + 1, 2), and for each line feedrate and extrusion."""

    points_mm: Floats
    feed_mm_min: Floats
    extruded_per_mm: Floats

    @property
    def is_closed(self) -> bool:
        """True if the piece ends where it begins."""
        return dist(self.points_mm[0], self.points_mm[-1]) < CLOSURE_TOLERANCE_MM

    def join(self, following: _Piece) -> _Piece:
        """Join the piece with another that begins where it ends."""
        return _Piece(
            np.concatenate([self.points_mm, following.points_mm[1:]]),
            np.concatenate([self.feed_mm_min, following.feed_mm_min]),
            np.concatenate([self.extruded_per_mm, following.extruded_per_mm]),
        )

    def reverse(self) -> _Piece:
        """Reverse the direction in which the piece is printed."""
        return _Piece(self.points_mm[::-1], self.feed_mm_min[::-1], self.extruded_per_mm[::-1])


@dataclass(frozen=True, slots=True)
class _Chain:
    """Successive moves (k,) of inner walls and travel that end where an outer wall begins.

    Attributes
    ----------
    moves
        Numbers of the moves.
    trail
        (k + 1, 2) points that the head passes.
    pieces
        Pieces of the inner walls.
    travel_mm
        Length of the travel.
    """

    moves: Indices
    trail: Trail
    pieces: list[_Piece]
    travel_mm: float


@dataclass(slots=True)
class _Plan:
    """New moves of a chain: each travel (k, 2) and the piece after it; the last travel has none."""

    routes: list[Floats] = field(default_factory=list)
    pieces: list[_Piece] = field(default_factory=list)

    @property
    def travel_mm(self) -> float:
        """Length of the travel."""
        return sum(map(measure_length_mm, self.routes))


def reorder_inner_walls(gcode: bytes, path: Toolpath, settings: EngineSettings) -> bytes:
    """Reorder and reverse the pieces of inner walls such that the head travels least.

    Walls stay as they are unless `removes_inner_walls`: otherwise, a longer travel might need a retraction.

    Parameters
    ----------
    gcode
        CuraEngine's output, from which `remove_inner_walls` has removed inner walls.
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
    spare_s = measure_spare_times_s(path, settings)
    for chain in _list_chains(path):
        layer = int(path.layer[chain.moves[-1]])
        plan = _find_best_plan(chain, outer_walls.build_travel_area(layer))
        saved_mm = 0.0 if plan is None else chain.travel_mm - plan.travel_mm
        saved_s = SAVED_TIME_FACTOR * saved_mm / settings.speed_travel_mm_s
        if plan is not None and saved_mm > MIN_SAVED_MM and saved_s <= spare_s.get(layer, 0.0):
            spare_s[layer] -= saved_s
            segments |= _list_segments(path, chain, plan, 60.0 * settings.speed_travel_mm_s)
    return change_moves(gcode, path, segments, settings)


def _list_chains(path: Toolpath) -> Iterator[_Chain]:
    """Yield the chains that include a piece of an interrupted wall."""
    is_line = find_level_lines(path)
    is_wall = is_line & path.is_feature("WALL-INNER")
    is_travel = mark_level_travel(path)
    begins_outer = np.append(is_line & path.is_feature("WALL-OUTER"), False)
    extruded_per_mm = measure_extrusion_per_mm(path)
    lengths_mm = measure_lengths_mm(path)
    begins_after_command = mark_moves_after_commands(path)
    begins_outer &= ~begins_after_command
    is_linked = is_wall | is_travel
    for moves in list_runs(is_linked[1:] & is_linked[:-1] & ~begins_after_command[1:-1]):
        wall_moves, next_move = moves[is_wall[moves]], moves[-1] + 1
        if len(wall_moves) == 0 or not begins_outer[next_move] or path.layer[wall_moves[0]] <= 0:
            continue
        if len(np.unique(path.layer[[*wall_moves, next_move]])) > 1:
            continue
        pieces = [
            _Piece(
                np.concatenate([path.start[lines[:1], :2], path.end[lines, :2]]),
                path.feed_mm_min[lines],
                extruded_per_mm[lines],
            )
            for lines in np.split(wall_moves, np.flatnonzero(np.diff(wall_moves) != 1) + 1)
        ]
        pieces = _join_pieces(pieces)
        if len(pieces) > MAX_PIECES or all(piece.is_closed for piece in pieces):
            continue
        points_mm = np.concatenate([path.start[moves[:1], :2], path.end[moves, :2]])
        travel_mm = float(lengths_mm[moves[is_travel[moves]]].sum())
        yield _Chain(moves, Trail(points_mm), pieces, travel_mm)


def _join_pieces(pieces: Sequence[_Piece]) -> list[_Piece]:
    """Join the end of each wall with its beginning, if neither is removed."""
    joined: list[_Piece] = []
    for piece in pieces:
        end_mm = piece.points_mm[-1]
        is_following = [dist(end_mm, other.points_mm[0]) < CLOSURE_TOLERANCE_MM for other in joined]
        if True not in is_following:
            joined.append(piece)
        else:
            begin = is_following.index(True)
            joined[begin] = piece.join(joined[begin])
    return joined


def _find_best_plan(chain: _Chain, area: shapely.Geometry) -> _Plan | None:
    """Find the plan with the least travel within an area; None if straight lines do not save any."""
    begin_mm, end_mm = (tuple(chain.trail.points_mm[number].tolist()) for number in (0, -1))
    orders = sorted(
        (_measure_straight_travel_mm(chain.pieces, order, begin_mm, end_mm), order)
        for order in _list_orders(chain.pieces)
    )
    best = None
    max_mm = chain.travel_mm
    for straight_mm, order in orders[:MAX_TRIED_ORDERS]:
        if straight_mm >= max_mm:
            break
        plan = _plan_order(chain, order, area)
        if plan.travel_mm < max_mm:
            best, max_mm = plan, plan.travel_mm
    return best


def _list_orders(pieces: Sequence[_Piece]) -> Iterator[Order]:
    """Yield all orders and directions of pieces; a closed piece has one direction."""
    directions = [(False,) if piece.is_closed else (False, True) for piece in pieces]
    for numbers in permutations(range(len(pieces))):
        for is_reversed in product(*(directions[number] for number in numbers)):
            yield tuple(zip(numbers, is_reversed, strict=True))


def _measure_straight_travel_mm(
    pieces: Sequence[_Piece], order: Order, begin_mm: Point, end_mm: Point
) -> float:
    """Measure the travel from a point, through pieces in an order, to another point, in straight lines."""
    total_mm = 0.0
    for number, is_reversed in order:
        points_mm = pieces[number].points_mm
        total_mm += dist(begin_mm, points_mm[-1 if is_reversed else 0])
        begin_mm = points_mm[0 if is_reversed else -1]
    return total_mm + dist(begin_mm, end_mm)


def _plan_order(chain: _Chain, order: Order, area: shapely.Geometry) -> _Plan:
    """Plan the travel between pieces in an order."""
    plan = _Plan()
    position_mm = chain.trail.points_mm[0]
    for number, is_reversed in order:
        piece = chain.pieces[number].reverse() if is_reversed else chain.pieces[number]
        plan.routes.append(chain.trail.find_route(tuple(position_mm), tuple(piece.points_mm[0]), area))
        plan.pieces.append(piece)
        position_mm = piece.points_mm[-1]
    plan.routes.append(chain.trail.find_route(tuple(position_mm), tuple(chain.trail.points_mm[-1]), area))
    return plan


def _list_segments(
    path: Toolpath, chain: _Chain, plan: _Plan, travel_mm_min: float
) -> dict[int, list[Segment]]:
    """List the segments that replace the moves of a chain; they are at its first move and its first wall."""
    travels = [[Segment(float(x), float(y), travel_mm_min) for x, y in route[1:]] for route in plan.routes]
    is_wall = path.extruded_mm[chain.moves] > 0.0
    first, first_wall = int(chain.moves[0]), int(chain.moves[np.argmax(is_wall)])
    segments: dict[int, list[Segment]] = {int(move): [] for move in chain.moves}
    segments[first] = travels[0]
    for piece, travel in zip(plan.pieces, travels[1:], strict=True):
        lines = zip(piece.points_mm[1:].tolist(), piece.feed_mm_min, piece.extruded_per_mm, strict=True)
        segments[first_wall] = [
            *segments[first_wall],
            *(Segment(x, y, float(feed), float(per_mm)) for (x, y), feed, per_mm in lines),
            *travel,
        ]
    return segments
