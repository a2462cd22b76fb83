"""Faster walls along the hidden sides of a part, and around its hidden recesses.

The lines and their filament stay, at a higher feedrate. CuraEngine has one speed for outer walls and one for
inner walls.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slicing.checks import MotionLimits, Toolpath, change_times
from slicing.checks.section import Floats
from slicing.glued_parts.loops import list_loops
from slicing.glued_parts.recess_skins import HiddenRecess
from slicing.glued_parts.rewriting import MOVE_LINE
from slicing.glued_parts.sides import (
    TRANSITION_MM,
    Bools,
    HiddenSide,
    Indices,
    find_bed_points,
    find_hidden_seams,
    find_level_lines,
    list_side_runs,
    list_wall_lines,
    measure_spare_times_s,
)
from slicing.settings import EngineSettings

MIN_SPEED_SHARE = 0.02
"""Minimum share of the time that all walls of a layer would save at the highest speed. For less, no lines are
divided."""
_RING_TOLERANCE_MM = 0.1
"""Maximum distance by which a ring around a recess exceeds its distance from the recess's box."""


def speed_up_hidden_walls(
    gcode: bytes,
    path: Toolpath,
    sides: Sequence[HiddenSide],
    recesses: Sequence[HiddenRecess],
    settings: EngineSettings,
) -> bytes:
    """Raise the speed of hidden walls to `EngineSettings.compute_hidden_wall_speed_mm_s`.

    Walls in layers that the slicer slows down, and in the slow first layers, keep their speed. In a layer
    that would become shorter than the minimum layer time, the speed is raised by less.

    Parameters
    ----------
    gcode
        CuraEngine's output.
    path
        Moves and comments of the same file.
    sides, recesses
        Hidden sides of the part, and hidden recesses in its level faces, in its place on the bed.
    settings
        Settings with which it was sliced.

    Returns
    -------
    bytes
        The same lines with higher feedrates; the end of each fast line becomes a separate line.
    """
    fast_moves = find_fast_walls(path, sides, recesses, settings)
    if not fast_moves.share.any():
        return gcode
    faster_gcode = _change_feedrates(gcode, path, fast_moves)
    return change_times(faster_gcode, path, MotionLimits.from_settings(settings.global_))


@dataclass(frozen=True, slots=True)
class FastMoves:
    """Share (n,) of each move, from its start, that is printed faster, and its feedrate (n,) there."""

    share: Floats
    feed_mm_min: Floats


def find_fast_walls(
    path: Toolpath,
    sides: Sequence[HiddenSide],
    recesses: Sequence[HiddenRecess],
    settings: EngineSettings,
) -> FastMoves:
    """Find the moves along hidden sides, in their notches and around hidden recesses that are faster.

    Parameters
    ----------
    path, sides, recesses, settings
        As in `speed_up_hidden_walls`.
    """
    points_mm = find_bed_points(path, settings)
    is_line = find_level_lines(path)
    fast_moves = FastMoves(np.zeros(len(is_line)), path.feed_mm_min.copy())
    for wall in list_wall_lines(settings):
        fast_mm_s = settings.compute_hidden_wall_speed_mm_s(wall.speed_mm_s, wall.width_mm)
        if fast_mm_s <= wall.speed_mm_s:
            continue
        has_full_speed = path.feed_mm_min > 60.0 * wall.speed_mm_s - 1.0
        is_slower = path.feed_mm_min < 60.0 * fast_mm_s
        wall_moves = np.flatnonzero(is_line & path.is_feature(wall.feature) & has_full_speed & is_slower)
        end_points_mm = points_mm[0][wall_moves], points_mm[1][wall_moves]
        for side in sides:
            share = _find_fast_share(wall_moves, end_points_mm, side, wall.depth_mm)
            fast_moves.share[wall_moves] = np.maximum(fast_moves.share[wall_moves], share)
        is_around = _mark_recess_rings(
            path, wall_moves, points_mm, recesses, (wall.depth_mm, settings.layer_height_mm)
        )
        fast_moves.share[wall_moves[is_around]] = 1.0
        fast_moves.feed_mm_min[wall_moves] = 60.0 * fast_mm_s
    return _limit_speed(path, fast_moves, measure_spare_times_s(path, settings))


def _limit_speed(path: Toolpath, fast_moves: FastMoves, spare_s: Mapping[int, float]) -> FastMoves:
    """Reduce the speeds of each layer so that it does not become shorter than the minimum layer time.

    The head accelerates more than at the lower speed, so a layer saves less than is assumed here.

    Parameters
    ----------
    path
        Moves of the file.
    fast_moves
        Moves at the highest speeds.
    spare_s
        Seconds by which each layer exceeds the minimum layer time.
    """
    moves = np.flatnonzero(fast_moves.share > 0.0)
    if len(moves) == 0:
        return fast_moves
    slow_min_per_mm = 1.0 / path.feed_mm_min[moves]
    saved_min_per_mm = slow_min_per_mm - 1.0 / fast_moves.feed_mm_min[moves]
    lengths_mm = fast_moves.share[moves] * np.hypot(*(path.end - path.start)[moves, :2].T)
    layers, numbers = np.unique(path.layer[moves], return_inverse=True)
    saved_s = 60.0 * np.bincount(numbers, lengths_mm * saved_min_per_mm)
    layer_spare_s = np.array([spare_s.get(layer, 0.0) for layer in layers.tolist()])
    ratio = np.clip(layer_spare_s / saved_s, 0.0, 1.0)[numbers]
    share, feed_mm_min = fast_moves.share.copy(), fast_moves.feed_mm_min.copy()
    share[moves] = np.where(ratio > MIN_SPEED_SHARE, share[moves], 0.0)
    feed_mm_min[moves] = 1.0 / (slow_min_per_mm - ratio * saved_min_per_mm)
    return FastMoves(share, feed_mm_min)


def _find_fast_share(
    wall_moves: Indices, end_points_mm: tuple[Floats, Floats], side: HiddenSide, wall_depth_mm: float
) -> Floats:
    """Compute the share (k,) of each move, from its start, that is printed faster along a side.

    Lines are fast up to a seam in a notch, after which no visible wall begins. The parameters are those of
    `list_side_runs`.
    """
    share = np.zeros(len(wall_moves))
    lengths_mm = np.hypot(*(end_points_mm[1] - end_points_mm[0]).T)
    runs = list(list_side_runs(wall_moves, end_points_mm, side, wall_depth_mm))
    seams = find_hidden_seams(wall_moves, end_points_mm, side, wall_depth_mm, runs)
    for number, run in enumerate(runs):
        transition_mm = 0.0 if number in seams.runs_before else TRANSITION_MM
        to_end_mm = np.cumsum(lengths_mm[run][::-1])[::-1]  # from the start of each move
        if to_end_mm[0] >= 2.0 * transition_mm:  # shorter runs keep their speed
            share[run] = np.clip((to_end_mm - transition_mm) / lengths_mm[run], 0.0, 1.0)
    share[seams.notch_moves] = 1.0
    return share


def _mark_recess_rings(
    path: Toolpath,
    wall_moves: Indices,
    points_mm: tuple[Floats, Floats],
    recesses: Sequence[HiddenRecess],
    wall_size_mm: tuple[float, float],
) -> Bools:
    """Mark the moves (k,) of closed rings around hidden recesses.

    A ring is fast up to its end: as after infill, the head travels before a visible wall begins.

    Parameters
    ----------
    path
        Moves of the file.
    wall_moves
        (k,) numbers of the moves of a wall.
    points_mm
        (n, 2) bed-centred starts and ends of all moves.
    recesses
        Hidden recesses of the part.
    wall_size_mm
        Distance of the wall from a recess, and height of its layers.
    """
    wall_depth_mm, layer_mm = wall_size_mm
    is_around = np.zeros(len(wall_moves), np.bool_)
    starts_mm, ends_mm = (points[wall_moves] for points in points_mm)
    z_mm = path.end[wall_moves, 2]
    for recess in recesses:
        low_x, low_y, high_x, high_y = recess.build_area(wall_depth_mm + _RING_TOLERANCE_MM).bounds
        low_z, high_z = sorted((recess.face_z_mm, recess.bottom_z_mm))
        is_inside = (z_mm > low_z) & (z_mm < high_z + layer_mm)
        for points in (starts_mm, ends_mm):
            is_inside &= ((points >= (low_x, low_y)) & (points <= (high_x, high_y))).all(axis=1)
        inside_moves = wall_moves[is_inside]
        for loop in list_loops(path, inside_moves, points_mm) if len(inside_moves) else ():
            if loop.is_closed:
                is_around |= np.isin(wall_moves, loop.moves)
    return is_around


def _change_feedrates(gcode: bytes, path: Toolpath, fast_moves: FastMoves) -> bytes:
    """Write the feedrates of fast moves into their lines; a move that is fast in part becomes two lines."""
    lines = [match.span() for match in MOVE_LINE.finditer(gcode)]
    assert len(lines) == len(fast_moves.share), "CuraEngine writes each move as G0 or G1"
    follows_fast_move = np.append(False, fast_moves.share[:-1] == 1.0)  # the previous feedrate persists
    pieces, offset = [], 0
    for move in np.flatnonzero((fast_moves.share > 0.0) | follows_fast_move):
        line_start, next_line_start = lines[move]
        start, end, share = path.start[move], path.end[move], float(fast_moves.share[move])
        pieces.append(gcode[offset:line_start])
        if share > 0.0:
            pieces.append(_format_line(start + share * (end - start), float(fast_moves.feed_mm_min[move])))
        if share < 1.0:
            pieces.append(_format_line(end, float(path.feed_mm_min[move])))
        offset = next_line_start
    return b"".join((*pieces, gcode[offset:]))


def _format_line(end: Floats, feed_mm_min: float) -> bytes:
    """Format a move to a point (4,) as a line of G-code."""
    x, y, _, e = end
    return b"G1 F%.6g X%.3f Y%.3f E%.5f\n" % (feed_mm_min, x, y, e)
