"""Faster walls along the hidden sides of a part: upright cut faces, which nobody sees once parts are glued.

CuraEngine has one speed for outer walls and one for inner walls, so its G-code is changed: the same lines
with the same filament at a higher feedrate. The times in its comments are computed again.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from slicing.checks import MotionLimits, Toolpath, estimate_move_seconds, read_toolpath, read_wall_layout
from slicing.checks.section import Floats
from slicing.settings import EngineSettings

Bools = npt.NDArray[np.bool_]

RUN_OUT_MM = 5.0
"""[assumed] Length of the end of a fast line that keeps its own speed, so that the pressure in the nozzle has
fallen where a visible wall begins."""
MIN_LINE_MM = 2.0 * RUN_OUT_MM  # shorter lines keep their speed
MAX_NOTCH_MM = 0.5
"""Maximum depth of a notch that counts as a part of the side: a mark or a gutter, not a hole for a pin."""
MAX_NOTCH_LENGTH_MM = 6.0
"""Maximum path through such a notch; letters are 5 mm high. A longer one may be along a visible wall."""
_ON_LINE_MM = 0.05
_LAYER_TIME_RATIO = 1.5
"""Ratio to the minimum layer time below which a layer keeps its speeds. A ratio of speeds up to this one
leaves the layer above the minimum."""
_MOVE_LINE = re.compile(rb"(?m)^G[01] [^\n]*\n")


@dataclass(frozen=True, slots=True)
class HiddenSide:
    """Upright side of a part that is hidden: outward unit normal and offset along it, in bed-centred mm."""

    normal: tuple[float, float]
    offset_mm: float

    def move(self, shift_mm: tuple[float, float]) -> HiddenSide:
        """Return the side moved by X and Y in mm."""
        return replace(self, offset_mm=self.offset_mm + float(np.dot(self.normal, shift_mm)))


def speed_up_hidden_walls(
    gcode: bytes, path: Toolpath, sides: Sequence[HiddenSide], settings: EngineSettings
) -> bytes:
    """Print the walls along hidden sides at up to `EngineSettings.limit_hidden_wall_mm_s`.

    Walls in layers that the slicer slows down, and in the slow first layers, keep their speed.

    Parameters
    ----------
    gcode
        CuraEngine's output.
    path
        Moves and comments of the same file.
    sides
        Hidden sides of the part where it lies on the bed.
    settings
        Settings with which it was sliced.

    Returns
    -------
    bytes
        The same lines with higher feedrates; the end of each fast line becomes a separate line.
    """
    fast = find_fast_walls(path, sides, settings)
    if not fast.share.any():
        return gcode
    faster_gcode = _change_feedrates(gcode, path, fast)
    return _change_times(faster_gcode, path, MotionLimits.from_settings(settings.global_))


@dataclass(frozen=True, slots=True)
class FastMoves:
    """Share (n,) of each move, from its start, that is printed faster, and its feedrate (n,) there."""

    share: Floats
    feed_mm_min: Floats


def find_fast_walls(path: Toolpath, sides: Sequence[HiddenSide], settings: EngineSettings) -> FastMoves:
    """Find the moves along hidden sides, and in their notches, that are printed faster."""
    bed_mm = (float(settings.global_["machine_width"]), float(settings.global_["machine_depth"]))
    ends_mm = [points[:, :2] - np.array(bed_mm) / 2.0 for points in (path.start, path.end)]
    delta_mm = path.end - path.start
    lengths_mm = np.hypot(delta_mm[:, 0], delta_mm[:, 1])
    is_line = (path.extruded_mm > 0.0) & (delta_mm[:, 2] == 0.0) & (lengths_mm > 0.0)
    is_line &= _find_long_layers(path, float(settings.extruder["cool_min_layer_time"]))
    fast = FastMoves(np.zeros(len(is_line)), np.zeros(len(is_line)))
    for feature, depths_mm, speed_mm_s in _list_walls(settings):
        fast_mm_s = settings.limit_hidden_wall_mm_s(speed_mm_s)
        if fast_mm_s <= speed_mm_s:
            continue
        has_full_speed = path.feed_mm_min > 60.0 * speed_mm_s - 1.0
        walls = np.flatnonzero(is_line & path.is_feature(feature) & has_full_speed)
        for side in sides:
            side_depths_mm = np.stack(
                [side.offset_mm - points[walls] @ np.array(side.normal) for points in ends_mm]
            )
            for wall_mm in depths_mm:
                share = _find_fast_share(walls, lengths_mm[walls], side_depths_mm - wall_mm)
                fast.share[walls] = np.maximum(fast.share[walls], share)
        fast.feed_mm_min[walls] = 60.0 * fast_mm_s
    return fast


def _find_fast_share(walls: npt.NDArray[np.intp], lengths_mm: Floats, depths_mm: Floats) -> Floats:
    """Compute the share (k,) of each wall, from its start, that is printed faster along a side.

    Successive moves on the side, and in notches between them, are one line; see `RUN_OUT_MM`.

    Parameters
    ----------
    walls
        (k,) indices of the moves.
    lengths_mm
        (k,) lengths of the moves.
    depths_mm
        (2, k) depths of their ends behind the line that the wall has along a plain side.
    """
    share = np.zeros(len(walls))
    deepest_mm, shallowest_mm = depths_mm.max(axis=0), depths_mm.min(axis=0)
    is_near = (shallowest_mm > -_ON_LINE_MM) & (deepest_mm < MAX_NOTCH_MM)
    on_side = np.flatnonzero((shallowest_mm > -_ON_LINE_MM) & (deepest_mm < _ON_LINE_MM))
    if len(on_side) == 0:
        return share
    first, second = on_side[:-1], on_side[1:]
    ends_mm, interruptions = np.cumsum(lengths_mm), np.cumsum(~is_near)
    notches_mm = ends_mm[second] - lengths_mm[second] - ends_mm[first]
    is_joined = (np.diff(walls[on_side]) == np.diff(on_side)) & (notches_mm < MAX_NOTCH_LENGTH_MM)
    is_joined &= interruptions[first] == interruptions[second]
    for run in np.split(on_side, np.flatnonzero(~is_joined) + 1):
        line = np.arange(run[0], run[-1] + 1)
        to_end_mm = np.cumsum(lengths_mm[line][::-1])[::-1]  # from the start of each move
        if to_end_mm[0] >= MIN_LINE_MM:
            share[line] = np.clip((to_end_mm - RUN_OUT_MM) / lengths_mm[line], 0.0, 1.0)
    return share


def _list_walls(settings: EngineSettings) -> list[tuple[str, list[float], float]]:
    """List names of walls, the depth of each inside the part in mm, and their speed in mm/s.

    Walls that do not follow the model's outline are not listed.
    """
    layout = read_wall_layout(settings)
    if layout is None:
        return []
    outer_mm = layout.width_mm / 2.0 + layout.inset_mm - layout.offset_mm
    first_mm = layout.width_mm - layout.offset_mm
    inner_mm = [first_mm + (i + 0.5) * settings.line_width_mm for i in range(layout.inner_walls)]
    return [
        ("WALL-OUTER", [outer_mm], settings.speed_wall_0_mm_s),
        ("WALL-INNER", inner_mm, settings.speed_wall_x_mm_s),
    ]


def _find_long_layers(path: Toolpath, min_layer_s: float) -> Bools:
    """Mark the moves (n,) of layers that stay above the minimum layer time if their walls are faster."""
    is_long = np.zeros(len(path.layer), np.bool_)
    first, elapsed_s = 0, 0.0
    for move, end_s in path.list_layer_ends():
        is_long[first:move] = end_s - elapsed_s >= _LAYER_TIME_RATIO * min_layer_s
        first, elapsed_s = move, end_s
    return is_long


def _change_feedrates(gcode: bytes, path: Toolpath, fast: FastMoves) -> bytes:
    """Write the feedrates of fast moves into their lines; a move that is fast in part becomes two lines."""
    lines = [match.span() for match in _MOVE_LINE.finditer(gcode)]
    assert len(lines) == len(fast.share), "CuraEngine writes each move as G0 or G1"
    follows_fast = np.append(False, fast.share[:-1] == 1.0)  # G-code keeps the feedrate of the line before
    pieces, offset = [], 0
    for move in np.flatnonzero((fast.share > 0.0) | follows_fast):
        begin, next_begin = lines[move]
        start, end, share = path.start[move], path.end[move], float(fast.share[move])
        pieces.append(gcode[offset:begin])
        if share > 0.0:
            pieces.append(_format_line(start + share * (end - start), float(fast.feed_mm_min[move])))
        if share < 1.0:
            pieces.append(_format_line(end, float(path.feed_mm_min[move])))
        offset = next_begin
    return b"".join((*pieces, gcode[offset:]))


def _format_line(end: Floats, feed_mm_min: float) -> bytes:
    x, y, _, e = end
    return b"G1 F%.6g X%.3f Y%.3f E%.5f\n" % (feed_mm_min, x, y, e)


def _change_times(gcode: bytes, path: Toolpath, limits: MotionLimits) -> bytes:
    """Subtract from the times in the comments of faster G-code what each layer saves.

    `path` has the moves before the change. Cura's time of a layer changes in proportion to the planned times
    of its moves.
    """
    fast_path = read_toolpath(gcode)
    planned_s, fast_s = _plan_layers_s(path, limits), _plan_layers_s(fast_path, limits)
    ratios = np.divide(fast_s, planned_s, out=np.ones_like(fast_s), where=planned_s > 0.0)
    ends_s = np.array([0.0, *(end_s for _, end_s in path.list_layer_ends())])
    marks = [comment for comment in fast_path.comments if comment.text.startswith("TIME_ELAPSED:")]
    pieces, offset = [], 0
    for mark, elapsed_s in zip(marks, np.cumsum(np.diff(ends_s) * ratios), strict=True):
        pieces += [gcode[offset : mark.offset], b";TIME_ELAPSED:%.6f" % elapsed_s]
        offset = gcode.index(b"\n", mark.offset)
    return b"".join((*pieces, gcode[offset:]))


def _plan_layers_s(path: Toolpath, limits: MotionLimits) -> Floats:
    """Plan the seconds (layers,) of the moves of each layer."""
    sums_s = np.append(0.0, np.cumsum(estimate_move_seconds(path, limits)))
    bounds = [path.first_layer_move or 0, *(move for move, _ in path.list_layer_ends())]
    return np.diff(sums_s[bounds])
