"""Infill beside a removed inner wall: the stretches that it supports, and the moves that extend it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from slicing.checks import Toolpath
from slicing.checks.section import Floats
from slicing.glued_parts.loops import join_loops, list_loops
from slicing.glued_parts.rewriting import Segment, measure_extrusion_per_mm
from slicing.glued_parts.sides import (
    MAX_NOTCH_DEPTH_MM,
    TRANSITION_MM,
    HiddenSide,
    Indices,
    find_level_lines,
    list_side_runs,
)

MAX_UNSUPPORTED_MM = 18.5
"""[assumed] Maximum length of the outer wall between two points where infill reaches it, or a side ends. The
lines of the sparsest infill of quality `glue` are 12.4 mm apart along a side that they meet at 45 degrees."""
MAX_GAPS_MM = 3.0
"""Maximum length of a stretch without an inner wall that the next layer's outer wall may leave uncovered."""
_BOUNDARY_DEPTH_MM = 0.3  # depth below the edge of the inner wall within which lines of infill end
_SAME_PLACE_MM = 0.01  # maximum distance between the ends of stretches that touch
_TAPER_MM = 1.0  # range of depths below this boundary in which the shift of the infill decreases to zero
_SKIN_DEPTH_MM = 2.0  # depth behind a side up to which skin needs the inner wall


@dataclass(frozen=True, slots=True)
class Stretch:
    """Part of a hidden side without an inner wall in one layer, between two positions along the side."""

    layer: int
    side: int
    low_mm: float
    high_mm: float


@dataclass(frozen=True, slots=True)
class _Band:
    """Points near a side: their layers (k,) in ascending order, and their positions (k,) along the side."""

    layers: npt.NDArray[np.int32]
    positions_mm: Floats

    def find_positions_mm(self, stretch: Stretch, margin_mm: float = 0.0) -> Floats:
        """Find the positions (m,) of the points beside a stretch, in ascending order."""
        layer = slice(*np.searchsorted(self.layers, (stretch.layer, stretch.layer + 1)))
        positions_mm = np.sort(self.positions_mm[layer])
        limits_mm = (stretch.low_mm - margin_mm, stretch.high_mm + margin_mm)
        return positions_mm[slice(*np.searchsorted(positions_mm, limits_mm))]

    def measure_gaps_mm(self, stretch: Stretch, layer: int) -> float:
        """Measure the length of a stretch that no line of a layer covers; each pair of points is a line."""
        rows = slice(*np.searchsorted(self.layers, (layer, layer + 1)))
        ends_mm = np.sort(self.positions_mm[rows].reshape(-1, 2), axis=1)
        ends_mm = np.clip(ends_mm[ends_mm[:, 0].argsort()], stretch.low_mm, stretch.high_mm)
        reached_mm = np.maximum.accumulate(np.append(stretch.low_mm, ends_mm[:, 1]))
        gaps_mm = np.append(ends_mm[:, 0], stretch.high_mm) - reached_mm
        return float(np.maximum(gaps_mm, 0.0).sum())


@dataclass(frozen=True, slots=True)
class Backing:
    """Ends of lines of infill, of skin and of the outer wall near each side; those of a line are adjacent."""

    infill: list[_Band]
    skin: list[_Band]
    outer_wall: list[_Band]

    @classmethod
    def from_path(
        cls,
        path: Toolpath,
        points_mm: tuple[Floats, Floats],
        sides: Sequence[HiddenSide],
        outer_wall_depth_mm: float,
        infill_depth_mm: float,
    ) -> Backing:
        """Find the ends of lines beside the inner wall.

        Parameters
        ----------
        path
            Moves of CuraEngine's output.
        points_mm
            (n, 2) bed-centred starts and ends of the moves.
        sides
            Hidden sides of the part.
        outer_wall_depth_mm, infill_depth_mm
            Depths of the outer wall's centre line and of the inner wall's inner edge behind a side.
        """
        is_line = find_level_lines(path)

        def list_bands(feature: str, low_mm: float, high_mm: float) -> list[_Band]:
            moves = np.flatnonzero(is_line & path.is_feature(feature))
            layers = np.repeat(path.layer[moves], 2)
            points = np.stack([points[moves] for points in points_mm], axis=1).reshape(-1, 2)
            bands = []
            for side in sides:
                depths_mm = side.measure_depths_mm(points)
                is_near = (depths_mm > low_mm) & (depths_mm < high_mm)
                bands.append(_Band(layers[is_near], side.measure_positions_mm(points[is_near])))
            return bands

        wall_moves = np.flatnonzero(is_line & path.is_feature("WALL-OUTER"))
        return cls(
            infill=list_bands(
                "FILL", infill_depth_mm, infill_depth_mm + MAX_NOTCH_DEPTH_MM + _BOUNDARY_DEPTH_MM
            ),
            skin=list_bands("SKIN", 0.0, _SKIN_DEPTH_MM),
            outer_wall=[
                _find_outer_wall(path, points_mm, wall_moves, side, outer_wall_depth_mm) for side in sides
            ],
        )

    def supports(self, run: Sequence[Stretch]) -> bool:
        """Check whether the outer wall along a run of stretches without skin needs no inner wall.

        Infill has to reach it, and the next layer's outer wall has to lie on it. A short stretch needs no
        infill if infill reaches the stretch before or after it, because the corner between them is rigid.

        Parameters
        ----------
        run
            Successive stretches of a wall, all those of a ring if it is one.
        """
        run = _join_ends(run)
        infill_mm = [self.infill[stretch.side].find_positions_mm(stretch) for stretch in run]
        has_infill = [len(positions_mm) > 0 for positions_mm in infill_mm]
        # The last stretch precedes the first one in a ring; at the ends of an open run, an inner wall stays.
        for number, (stretch, positions_mm) in enumerate(zip(run, infill_mm, strict=True)):
            gaps_mm = np.diff(positions_mm, prepend=stretch.low_mm, append=stretch.high_mm)
            is_long = stretch.high_mm - stretch.low_mm > TRANSITION_MM
            is_held = has_infill[number - 1] or has_infill[number] or has_infill[(number + 1) % len(run)]
            if (is_long and not is_held) or float(gaps_mm.max()) > MAX_UNSUPPORTED_MM:
                return False
        return all(
            self.outer_wall[stretch.side].measure_gaps_mm(stretch, stretch.layer + 1) <= MAX_GAPS_MM
            for stretch in run
        )


def _join_ends(run: Sequence[Stretch]) -> list[Stretch]:
    """Join the first and the last stretch of a ring, if the ring begins in the middle of a side."""
    first, last = run[0], run[-1]
    is_split = len(run) > 1 and first.side == last.side
    is_split &= (
        first.low_mm <= last.high_mm + _SAME_PLACE_MM and last.low_mm <= first.high_mm + _SAME_PLACE_MM
    )
    if not is_split:
        return list(run)
    low_mm, high_mm = min(first.low_mm, last.low_mm), max(first.high_mm, last.high_mm)
    return [replace(first, low_mm=low_mm, high_mm=high_mm), *run[1:-1]]


def _find_outer_wall(
    path: Toolpath,
    points_mm: tuple[Floats, Floats],
    wall_moves: Indices,
    side: HiddenSide,
    wall_depth_mm: float,
) -> _Band:
    """Find the ends of the outer wall's runs along a side; `wall_moves` (k,) are all moves of this wall."""
    if len(wall_moves) == 0:
        return _Band(np.zeros(0, np.int32), np.zeros(0))
    moves, numbers = join_loops(list_loops(path, wall_moves, points_mm))
    starts_mm, ends_mm = points_mm[0][moves], points_mm[1][moves]
    layers, positions_mm = [], []
    for run in list_side_runs(numbers, (starts_mm, ends_mm), side, wall_depth_mm):
        layers += 2 * [path.layer[moves[run[0]]]]
        positions_mm += [starts_mm[run[0]], ends_mm[run[-1]]]
    positions = side.measure_positions_mm(np.array(positions_mm).reshape(-1, 2))
    return _Band(np.array(layers, np.int32), positions)


@dataclass(frozen=True, slots=True)
class _Step:
    """Step of a line along the wall at the end of a stretch: its place as a share of the line, and the shift.

    `is_end_shifted` is true if the line is shifted after the step, not before it.
    """

    share: float
    shift_mm: Floats
    is_end_shifted: bool


def extend_infill(
    path: Toolpath,
    points_mm: Floats,
    sides: Sequence[HiddenSide],
    stretches: Sequence[Stretch],
    infill_depth_mm: float,
    spacing_mm: float,
) -> dict[int, list[Segment]]:
    """Build the segments that replace moves of the infill, so that it reaches the outer wall.

    Ends near the removed wall are shifted by the spacing of the walls, and deeper ones by less, so that lines
    do not cross. A line along the wall that passes the end of a stretch gets a step there.

    Parameters
    ----------
    path
        Moves of CuraEngine's output.
    points_mm
        (n, 2) bed-centred ends of the moves.
    sides
        Hidden sides of the part.
    stretches
        Stretches along which the inner wall is removed.
    infill_depth_mm
        Depth of the inner edge of the inner wall behind a side.
    spacing_mm
        Distance between the centre lines of the two walls.
    """
    is_infill, ends = _find_infill_ends(path)
    shifts_mm = np.zeros((len(path.layer), 2))
    steps: dict[int, _Step] = {}
    for stretch in stretches:
        side, shift_mm = sides[stretch.side], spacing_mm * np.array(sides[stretch.side].normal)
        beside = ends[slice(*np.searchsorted(path.layer[ends], (stretch.layer, stretch.layer + 1)))]
        depths_mm = side.measure_depths_mm(points_mm[beside])
        positions_mm = side.measure_positions_mm(points_mm[beside])
        share = np.clip(1.0 - (depths_mm - infill_depth_mm - _BOUNDARY_DEPTH_MM) / _TAPER_MM, 0.0, 1.0)
        share[depths_mm < infill_depth_mm] = 0.0
        is_within = (positions_mm >= stretch.low_mm) & (positions_mm <= stretch.high_mm)
        shifts_mm[beside] += (share * is_within)[:, None] * shift_mm
        is_step = (np.diff(beside) == 1) & is_infill[beside[1:]] & (is_within[1:] != is_within[:-1])
        for first in np.flatnonzero(is_step & (np.minimum(share[1:], share[:-1]) == 1.0)):
            begin_mm, end_mm = positions_mm[first : first + 2]
            limit_mm = stretch.low_mm if min(begin_mm, end_mm) < stretch.low_mm else stretch.high_mm
            step_share = float((limit_mm - begin_mm) / (end_mm - begin_mm))
            steps[int(beside[first + 1])] = _Step(step_share, shift_mm, bool(is_within[first + 1]))
    return _list_segments(path, is_infill, shifts_mm, steps)


def _find_infill_ends(path: Toolpath) -> tuple[npt.NDArray[np.bool_], Indices]:
    """Find the lines of the infill (n,), and the moves whose ends are ends of these lines alone."""
    is_line = find_level_lines(path)
    is_infill = is_line & path.is_feature("FILL")
    is_other = is_line & ~is_infill
    is_end = is_infill | np.append(is_infill[1:], False)
    is_end &= (
        path.is_head_move & ~is_other & ~np.append(is_other[1:], False) & (path.end[:, 2] == path.start[:, 2])
    )
    return is_infill, np.flatnonzero(is_end)


def _list_segments(
    path: Toolpath, is_infill: npt.NDArray[np.bool_], shifts_mm: Floats, steps: dict[int, _Step]
) -> dict[int, list[Segment]]:
    """List the segments of the moves whose starts or ends are shifted (n, 2)."""
    is_shifted = (shifts_mm != 0.0).any(axis=1)
    starts_mm, ends_mm = path.start[:, :2], path.end[:, :2]
    extruded_per_mm = measure_extrusion_per_mm(path)
    segments = {}
    for move in np.flatnonzero(is_shifted | (is_infill & np.append(False, is_shifted[:-1]))).tolist():
        points = [ends_mm[move] + shifts_mm[move]]
        if move in steps:
            step = steps[move]
            point = starts_mm[move] + step.share * (ends_mm[move] - starts_mm[move])
            corner = [point + step.shift_mm, point]
            points = [*(reversed(corner) if step.is_end_shifted else corner), *points]
        extrusion = float(extruded_per_mm[move]) if is_infill[move] else 0.0
        feed_mm_min = float(path.feed_mm_min[move])
        segments[move] = [Segment(float(x), float(y), feed_mm_min, extrusion) for x, y in points]
    return segments
