"""Hidden sides of a part, and the walls along them in a toolpath.

A notch is any shallow recess of a side: a mark with a number, or a gutter for the seam
(`decompose.connectors.gutters`). The groove of a key is deeper, so the side lists its grooves. The outer wall
follows all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from slicing.checks import Toolpath, read_wall_layout
from slicing.checks.section import Floats
from slicing.settings import EngineSettings

Bools = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]

TRANSITION_MM = 5.0
"""[assumed] Length at each end of a line along a hidden side that is printed like a visible wall, so that the
pressure in the nozzle is normal when a visible wall begins."""
MAX_NOTCH_DEPTH_MM = 0.5
"""Maximum depth of a notch that counts as a part of the side: a mark or a gutter, but no hole for a pin.

Grooves for keys are deeper; the side lists them."""
MAX_NOTCH_LENGTH_MM = 6.0
"""Maximum length of the path through a notch; letters are 5 mm high. A longer path may lie along a visible
wall."""
_NOTCH_EXCESS_SHARE = 0.5
"""Excess depth of a wall's line below the bottom of a notch, as a share of the wall's depth: it is
1 / sin(42 deg) - 1 in a gutter."""
_LINE_TOLERANCE_MM = 0.05
CLOSURE_TOLERANCE_MM = 0.02
"""Maximum distance between the ends of a closed loop."""


@dataclass(frozen=True, slots=True)
class SideGroove:
    """Groove for a key in a hidden side, deeper than a notch: its depth, and its limits along the side."""

    low_mm: float
    high_mm: float
    depth_mm: float


@dataclass(frozen=True, slots=True)
class HiddenSide:
    """Upright side of a part that is hidden: outward unit normal and offset along it, in bed-centred mm."""

    normal: tuple[float, float]
    offset_mm: float
    grooves: tuple[SideGroove, ...] = ()

    def move(self, shift_mm: tuple[float, float]) -> HiddenSide:
        """Move the side by X and Y in mm."""
        along_mm = float(self.measure_positions_mm(np.array(shift_mm)))
        return replace(
            self,
            offset_mm=self.offset_mm + float(np.dot(self.normal, shift_mm)),
            grooves=tuple(
                replace(groove, low_mm=groove.low_mm + along_mm, high_mm=groove.high_mm + along_mm)
                for groove in self.grooves
            ),
        )

    def measure_depths_mm(self, points_mm: Floats) -> Floats:
        """Measure the depth (n,) of points (n, 2) behind the side."""
        return np.asarray(self.offset_mm - points_mm @ np.array(self.normal))

    def measure_positions_mm(self, points_mm: Floats) -> Floats:
        """Measure the position (n,) of points (n, 2) along the side."""
        return np.asarray(points_mm @ np.array([-self.normal[1], self.normal[0]]))


@dataclass(frozen=True, slots=True)
class WallLine:
    """Line of a wall in each layer: CuraEngine's name of the wall, its depth in the part, width and speed."""

    feature: str
    depth_mm: float
    width_mm: float
    speed_mm_s: float


def list_wall_lines(settings: EngineSettings) -> list[WallLine]:
    """List the walls, the outermost first; no walls if the outer one does not follow the model's outline."""
    layout = read_wall_layout(settings)
    if layout is None:
        return []
    outer_mm = layout.width_mm / 2.0 + layout.inset_mm - layout.offset_mm
    first_mm = layout.width_mm - layout.offset_mm
    inner_mm = [first_mm + (i + 0.5) * settings.line_width_mm for i in range(layout.inner_wall_count)]
    return [
        WallLine("WALL-OUTER", outer_mm, layout.width_mm, settings.speed_wall_0_mm_s),
        *(
            WallLine("WALL-INNER", depth_mm, settings.line_width_mm, settings.speed_wall_x_mm_s)
            for depth_mm in inner_mm
        ),
    ]


def find_bed_points(path: Toolpath, settings: EngineSettings) -> tuple[Floats, Floats]:
    """Find the points (n, 2) where moves start and end, in bed-centred mm."""
    bed_mm = np.array([float(settings.global_[f"machine_{axis}"]) for axis in ("width", "depth")])
    return path.start[:, :2] - bed_mm / 2.0, path.end[:, :2] - bed_mm / 2.0


def find_level_lines(path: Toolpath) -> Bools:
    """Mark the moves (n,) that extrude at constant Z."""
    delta_mm = path.end - path.start
    is_moved = (delta_mm[:, :2] != 0.0).any(axis=1)
    return np.asarray((path.extruded_mm > 0.0) & (delta_mm[:, 2] == 0.0) & is_moved)


def measure_spare_times_s(path: Toolpath, settings: EngineSettings) -> dict[int, float]:
    """Measure by how many seconds each layer exceeds the minimum layer time, according to the comments.

    The slicer turns the fan faster in layers that are shorter than another time, unless the fan always has
    its maximum speed, as for PLA. The fan does not follow changes of the G-code, so the minimum is this time.
    """
    min_time_s = float(settings.extruder["cool_min_layer_time"])
    if float(settings.extruder["cool_fan_speed_min"]) < float(settings.extruder["cool_fan_speed_max"]):
        min_time_s = max(min_time_s, float(settings.extruder["cool_min_layer_time_fan_speed_max"]))
    spare_s, first, elapsed_s = {}, 0, 0.0
    for move, end_s in path.list_layer_ends():
        if move > first:
            spare_s[int(path.layer[move - 1])] = end_s - elapsed_s - min_time_s
        first, elapsed_s = move, end_s
    return spare_s


def list_side_runs(
    wall_moves: Indices, end_points_mm: tuple[Floats, Floats], side: HiddenSide, wall_depth_mm: float
) -> Iterator[Indices]:
    """Yield runs of successive moves along a side, as indices of `wall_moves`.

    Moves on the side, and in notches and grooves between them, are one run; see `MAX_NOTCH_DEPTH_MM`.

    Parameters
    ----------
    wall_moves
        (k,) numbers of the moves of a wall; moves with successive numbers are connected.
    end_points_mm
        Starts (k, 2) and ends (k, 2) of the moves.
    side
        Hidden side.
    wall_depth_mm
        Depth of the wall along a side without notches.
    """
    depths_mm = np.stack([side.measure_depths_mm(points) for points in end_points_mm]) - wall_depth_mm
    on_side = np.flatnonzero((np.abs(depths_mm) < _LINE_TOLERANCE_MM).all(axis=0))
    if len(on_side) == 0:
        return
    in_groove = _find_groove_moves(end_points_mm, side, wall_depth_mm)
    is_near = in_groove | find_notch_moves(end_points_mm, side, wall_depth_mm)
    first, second = on_side[:-1], on_side[1:]
    notch_lengths_mm = np.where(in_groove, 0.0, np.hypot(*(end_points_mm[1] - end_points_mm[0]).T))
    ends_along_mm, interruptions = np.cumsum(notch_lengths_mm), np.cumsum(~is_near)
    notches_mm = ends_along_mm[second] - notch_lengths_mm[second] - ends_along_mm[first]
    is_joined = (np.diff(wall_moves[on_side]) == np.diff(on_side)) & (notches_mm < MAX_NOTCH_LENGTH_MM)
    is_joined &= interruptions[first] == interruptions[second]
    for run in np.split(on_side, np.flatnonzero(~is_joined) + 1):
        yield np.arange(run[0], run[-1] + 1)


@dataclass(frozen=True, slots=True)
class HiddenSeams:
    """Seams in the notches of a side: the numbers of the runs that end there, and the moves in the notches.

    Moves are indices of all moves of the wall.
    """

    runs_before: frozenset[int]
    notch_moves: Indices


def find_hidden_seams(
    wall_moves: Indices,
    end_points_mm: tuple[Floats, Floats],
    side: HiddenSide,
    wall_depth_mm: float,
    runs: Sequence[Indices],
) -> HiddenSeams:
    """Find the seams in notches between two runs along a side: points where a closed loop begins and ends.

    Parameters
    ----------
    wall_moves, end_points_mm, side, wall_depth_mm
        As in `list_side_runs`.
    runs
        Runs of `list_side_runs`.
    """
    is_near = _find_groove_moves(end_points_mm, side, wall_depth_mm)
    is_near |= find_notch_moves(end_points_mm, side, wall_depth_mm)
    loop_starts = np.flatnonzero(np.diff(wall_moves, prepend=-2) != 1)
    loops = np.searchsorted(loop_starts, [run[0] for run in runs], side="right") - 1
    loop_ends = np.append(loop_starts, len(wall_moves))[loops + 1]
    runs_before, notch_moves = set(), []
    for first in np.flatnonzero(np.diff(loops, prepend=-1)).tolist():
        last = int(np.searchsorted(loops, loops[first], side="right")) - 1
        start, end = int(loop_starts[loops[first]]), int(loop_ends[first])
        notch = np.append(np.arange(start, runs[first][0]), np.arange(runs[last][-1] + 1, end))
        lengths_mm = np.hypot(*(end_points_mm[1][notch] - end_points_mm[0][notch]).T)
        is_closed = np.hypot(*(end_points_mm[1][end - 1] - end_points_mm[0][start])) < CLOSURE_TOLERANCE_MM
        if is_closed and last > first and is_near[notch].all() and lengths_mm.sum() < MAX_NOTCH_LENGTH_MM:
            runs_before.add(last)
            notch_moves.append(notch)
    return HiddenSeams(frozenset(runs_before), np.concatenate([np.zeros(0, np.intp), *notch_moves]))


def find_notch_moves(end_points_mm: tuple[Floats, Floats], side: HiddenSide, wall_depth_mm: float) -> Bools:
    """Mark the moves (k,) along a side and in its notches; the parameters are those of `list_side_runs`."""
    return _find_moves_between(end_points_mm, side, wall_depth_mm, MAX_NOTCH_DEPTH_MM)


def _find_groove_moves(end_points_mm: tuple[Floats, Floats], side: HiddenSide, wall_depth_mm: float) -> Bools:
    """Mark the moves (k,) around the grooves of a side; the parameters are those of `list_side_runs`."""
    positions_mm = np.stack([side.measure_positions_mm(points) for points in end_points_mm])
    low_mm, high_mm = positions_mm.min(axis=0), positions_mm.max(axis=0)
    margin_mm = (1.0 + _NOTCH_EXCESS_SHARE) * wall_depth_mm
    in_groove = np.zeros(len(low_mm), np.bool_)
    for groove in side.grooves:
        is_beside = (low_mm > groove.low_mm - margin_mm) & (high_mm < groove.high_mm + margin_mm)
        in_groove |= is_beside & _find_moves_between(end_points_mm, side, wall_depth_mm, groove.depth_mm)
    return in_groove


def _find_moves_between(
    end_points_mm: tuple[Floats, Floats], side: HiddenSide, wall_depth_mm: float, notch_depth_mm: float
) -> Bools:
    """Mark the moves (k,) between the wall along a side and the wall in a notch of depth `notch_depth_mm`."""
    depths_mm = np.stack([side.measure_depths_mm(points) for points in end_points_mm]) - wall_depth_mm
    deepest_mm = notch_depth_mm + _NOTCH_EXCESS_SHARE * wall_depth_mm
    return np.asarray(((depths_mm > -_LINE_TOLERANCE_MM) & (depths_mm < deepest_mm)).all(axis=0))
