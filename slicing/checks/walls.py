"""Printed outer wall: closed rings, walls of a single line, and the area that they enclose.

A ring is a closed line of a wall, or of a section of the model (`checks.section`). `glued_parts` calls the
moves of a wall's ring a loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from shapely import Geometry

from slicing.checks.section import Floats, Rings, measure_rings
from slicing.checks.toolpath import Toolpath
from slicing.settings import EngineSettings

TOLERANCE_MM = 0.15
"""Tolerance for points of an outline: the engine simplifies it (by 0.05 mm) and rounds sections of slopes."""
_MAX_FILLING_DISTANCE_MM = 1.0  # maximum distance of a line from an area that it fills
_MAX_GAPS = 8  # maximum number of gaps in a ring
_EXACT_OUTLINE_SETTINGS = {
    "adaptive_layer_height_enabled": "False",
    "coasting_enable": "False",
    "conical_overhang_enabled": "False",
    "magic_fuzzy_skin_enabled": "False",
    "magic_mesh_surface_mode": "normal",
    "magic_spiralize": "False",
    "mold_enabled": "False",
    "slicing_tolerance": "middle",
}
"""Values with which the outer wall follows the model's outline without gaps."""


@dataclass(frozen=True, slots=True)
class WallLayout:
    """Position of the outer wall relative to the model's outline, in mm."""

    layer_height_0_mm: float
    layer_height_mm: float
    width_mm: float
    line_width_factor_0: float  # ratio of the first layer's line width to that of the others
    inset_mm: float
    offset_0_mm: float  # horizontal expansion of the first layer
    offset_mm: float
    slack_mm: float  # distance by which the engine may move the outlines of holes
    step_mm: float = 0.0  # maximum distance between the centre lines of neighbouring walls
    inner_wall_count: int = 0  # number of closed rings within the outer one; 0 if it is not known

    def compute_reach_mm(self, layer: npt.NDArray[np.int32]) -> Floats:
        """Compute the distance (n,) from a ring's centre line to the model's outline, for layers (n,)."""
        return np.where(layer == 0, self.line_width_factor_0, 1.0) * self.width_mm / 2 + self.inset_mm

    def compute_section_heights_mm(self, layer_count: int) -> Floats:
        """Compute the heights (layer_count,) at which the engine cuts the model: the middle of each layer."""
        later_mm = self.layer_height_0_mm + self.layer_height_mm * (np.arange(1, layer_count) - 0.5)
        return np.concatenate(([self.layer_height_0_mm / 2], later_mm))[:layer_count]

    def compute_top_mm(self, layer: int) -> float:
        """Compute the height of a layer's top."""
        return self.layer_height_0_mm + layer * self.layer_height_mm


def read_wall_layout(settings: EngineSettings) -> WallLayout | None:
    """Read the outer wall's layout from settings; None if the wall does not follow the model's outline."""
    scopes = (settings.extruder, settings.global_)

    def read_number(key: str) -> float:
        return float(settings.extruder.get(key) or settings.global_.get(key) or 0.0)

    if settings.wall_count < 1 or any(
        scope.get(key, default) != default
        for scope in scopes
        for key, default in _EXACT_OUTLINE_SETTINGS.items()
    ):
        return None
    return WallLayout(
        layer_height_0_mm=settings.layer_height_0_mm,
        layer_height_mm=settings.layer_height_mm,
        width_mm=settings.line_width_0_mm,
        line_width_factor_0=read_number("initial_layer_line_width_factor") / 100 or 1.0,
        inset_mm=read_number("wall_0_inset"),
        offset_0_mm=read_number("xy_offset_layer_0"),
        offset_mm=read_number("xy_offset"),
        slack_mm=abs(read_number("hole_xy_offset")),
        step_mm=max(settings.line_width_0_mm, read_number("wall_line_width_x"))
        * max(1.0, read_number("initial_layer_line_width_factor") / 100),
        # Cura 5 draws as many walls as fit, of any width.
        inner_wall_count=0 if "inset_direction" in settings.extruder else settings.wall_count - 1,
    )


@dataclass(frozen=True, slots=True)
class Walls:
    """Printed lines of the outer wall: (n,) one for each move, in mm from the bed's centre."""

    start: Floats  # (n, 2)
    end: Floats  # (n, 2)
    layer: npt.NDArray[np.int32]
    run: npt.NDArray[np.intp]  # index of the unbroken line of a move
    is_closed: npt.NDArray[np.bool_]  # whether that line is a ring
    width_mm: Floats  # computed from the extruded filament
    reach_mm: Floats  # from a ring's centre line to the model's outline; for an open line, half its width
    other_lines: Floats  # (m, 6) all other lines of the part: start, end, layer, half width
    inner_lines: Floats  # (k, 5) lines of the inner walls: start, end, layer

    @classmethod
    def from_toolpath(
        cls, toolpath: Toolpath, layout: WallLayout, centre_mm: tuple[float, float], filament_mm2: float
    ) -> Walls:
        """Select the walls of a toolpath, with the parameters of `check_outline`."""
        extruded_mm = toolpath.extruded_mm
        length_mm = np.hypot(*(toolpath.end[:, :2] - toolpath.start[:, :2]).T)
        is_printing = (extruded_mm > 0) & (length_mm > 0) & (toolpath.layer >= 0)
        height_mm = np.where(toolpath.layer == 0, layout.layer_height_0_mm, layout.layer_height_mm)
        half_widths_mm = np.zeros(len(length_mm))
        half_widths_mm[is_printing] = (
            (extruded_mm * filament_mm2)[is_printing] / (length_mm * height_mm)[is_printing] / 2
        )
        # A wider line is a blob, which covers no more area.
        half_widths_mm = np.minimum(half_widths_mm, layout.width_mm)
        wall_moves = np.flatnonzero(is_printing & toolpath.is_feature("WALL-OUTER"))
        start, end = toolpath.start[wall_moves, :2] - centre_mm, toolpath.end[wall_moves, :2] - centre_mm
        layer = toolpath.layer[wall_moves]
        bridges, run, is_closed = _join_runs(start, end, layer)
        order = np.argsort(np.concatenate((np.arange(len(wall_moves)), bridges)), kind="stable")

        def splice(values: npt.NDArray[Any], bridge_values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            return np.asarray(np.concatenate((values, bridge_values))[order])

        start, end = splice(start, end[bridges]), splice(end, np.roll(start, -1, axis=0)[bridges])
        half_width_mm = splice(half_widths_mm[wall_moves], half_widths_mm[wall_moves][bridges])
        layer, run = splice(layer, layer[bridges]), splice(run, run[bridges])
        is_closed = is_closed[run]
        is_other = np.zeros(len(length_mm), bool)
        for name in ("WALL-INNER", "SKIN", "FILL"):
            is_other |= toolpath.is_feature(name)
        is_other &= is_printing
        ends = (toolpath.start[is_other, :2] - centre_mm, toolpath.end[is_other, :2] - centre_mm)
        other_lines = np.column_stack((*ends, toolpath.layer[is_other], half_widths_mm[is_other])).astype(
            np.float64
        )
        reach_mm = np.where(is_closed, layout.compute_reach_mm(layer), half_width_mm)
        inner_lines = other_lines[toolpath.is_feature("WALL-INNER")[is_other]][:, :5]
        return cls(start, end, layer, run, is_closed, 2 * half_width_mm, reach_mm, other_lines, inner_lines)

    def sum_rings(self, layer_count: int) -> Rings:
        """Sum the area within the outer edge of the outer wall, to first order, for `layer_count` layers."""
        is_ring = self.is_closed
        inside = measure_rings(
            iter([(self.layer[is_ring].astype(np.intp), self.start[is_ring], self.end[is_ring])]), layer_count
        )
        # An engine may draw rings in the opposite direction, but then it does so for all rings of a layer.
        sign = np.where(inside.area_mm2 < 0, -1.0, 1.0)
        band_mm2 = np.hypot(*(self.end - self.start).T) * self.reach_mm * np.where(is_ring, 1.0, 2.0)
        corners_mm2 = np.bincount(self.layer, self._compute_corners_mm2(), layer_count)
        area_mm2 = sign * (inside.area_mm2 + corners_mm2) + np.bincount(self.layer, band_mm2, layer_count)
        moment_mm3 = sign[:, None] * inside.moment_mm3
        for axis in range(2):
            middle_mm = (self.start[:, axis] + self.end[:, axis]) / 2
            moment_mm3[:, axis] += np.bincount(self.layer, band_mm2 * middle_mm, layer_count)
        return Rings(area_mm2, inside.length_mm, moment_mm3)

    def compute_missing_areas_mm2(self, layout: WallLayout, layer_count: int) -> Floats:
        """Compute the expected area (layer_count,) that the inner walls of each layer fail to enclose.

        A ring that is offset inwards by d loses at most d times its length in area. The result is 0 where an
        inner wall is not a whole ring.
        """
        start, end, layer = (
            self.inner_lines[:, :2],
            self.inner_lines[:, 2:4],
            self.inner_lines[:, 4].astype(np.int32),
        )
        bridges, run, is_closed = _join_runs(start, end, layer)
        has_open_lines = (
            np.bincount(layer, ~is_closed[run], layer_count)
            + np.bincount(layer[bridges], minlength=layer_count)
            > 0
        )
        inner = measure_rings(iter([(layer.astype(np.intp), start, end)]), layer_count)
        is_ring = self.is_closed
        outer = measure_rings(
            iter([(self.layer[is_ring].astype(np.intp), self.start[is_ring], self.end[is_ring])]), layer_count
        )
        expected_mm2 = np.zeros(layer_count)
        for number in range(1, layout.inner_wall_count + 1):
            distance_mm = number * layout.step_mm
            expected_mm2 += np.maximum(0.0, np.abs(outer.area_mm2) - distance_mm * outer.length_mm)
        return np.where(has_open_lines, 0.0, expected_mm2 - np.abs(inner.area_mm2))

    def _compute_corners_mm2(self) -> Floats:
        """Compute the area (n,) of the band outside a ring at the corner after each move."""
        if not len(self.run):
            return np.empty(0)
        next_index = np.arange(1, len(self.run) + 1)
        first_moves = np.flatnonzero(np.diff(self.run, prepend=-1))
        next_index[np.append(first_moves[1:], len(self.run)) - 1] = first_moves
        direction = self.end - self.start
        next_direction = direction[next_index]
        cross = direction[:, 0] * next_direction[:, 1] - direction[:, 1] * next_direction[:, 0]
        scale = np.hypot(*direction.T) * np.hypot(*next_direction.T) + (direction * next_direction).sum(
            axis=1
        )
        half_angle_tan = np.clip(cross / np.maximum(scale, 1e-9), -2.0, 2.0)
        return np.where(self.is_closed, self.reach_mm**2 * half_angle_tan, 0.0)

    def build_printed_area(self, layer: int, model: Geometry) -> Geometry:
        """Build the area within the outer edge of the outer wall in one layer.

        A ring is the edge of an area, or a wall of a single line, which has the model on neither side.
        """
        indices = np.flatnonzero(self.layer == layer)
        is_line = ~self.is_closed[indices]
        inside: Geometry = shapely.Polygon()
        for run in np.unique(self.run[indices][~is_line]):
            in_run = self.run[indices] == run
            points = np.vstack((self.start[indices[in_run][:1]], self.end[indices[in_run]]))
            if self._is_single_line(indices[in_run], model):
                is_line |= in_run
            elif len(points) > 3:
                # Rings do not cross each other: one within another is a hole.
                inside = inside.symmetric_difference(shapely.make_valid(shapely.Polygon(points)))
        reach_mm = float(self.reach_mm[indices][~is_line].max(initial=0.0))
        strokes = _build_strokes(
            self.start[indices[is_line]], self.end[indices[is_line]], self.width_mm[indices[is_line]] / 2
        )
        return shapely.union_all([inside.buffer(reach_mm, join_style="mitre"), strokes])

    def _is_single_line(self, ring: npt.NDArray[np.intp], model: Geometry) -> bool:
        """Check whether a line is a wall by itself: the model lies on neither of its sides."""
        direction = self.end[ring] - self.start[ring]
        normal = np.column_stack((-direction[:, 1], direction[:, 0])) / np.hypot(*direction.T)[:, None]
        normal *= (self.width_mm[ring] / 2 + TOLERANCE_MM)[:, None]
        middle = (self.start[ring] + self.end[ring]) / 2
        on_model = [shapely.contains_xy(model, *(middle + side * normal).T) for side in (-1.0, 1.0)]
        return float(np.mean(on_model[0] | on_model[1])) < 0.5

    def build_filling(self, layer: int, bounds: tuple[float, float, float, float]) -> Geometry:
        """Build the area of the other lines in a layer that come near a rectangle (x0, y0, x1, y1)."""
        rows = self.other_lines[self.other_lines[:, 4] == layer]
        low_mm, high_mm = (
            np.minimum(rows[:, :2], rows[:, 2:4]) - _MAX_FILLING_DISTANCE_MM,
            np.maximum(rows[:, :2], rows[:, 2:4]) + _MAX_FILLING_DISTANCE_MM,
        )
        is_near = (low_mm[:, 0] < bounds[2]) & (low_mm[:, 1] < bounds[3])
        rows = rows[is_near & (high_mm[:, 0] > bounds[0]) & (high_mm[:, 1] > bounds[1])]
        return _build_strokes(rows[:, :2], rows[:, 2:4], rows[:, 5])


def _join_runs(
    start: Floats, end: Floats, layer: npt.NDArray[np.int32]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
    """Join moves into unbroken lines, and determine which of them are rings.

    Where two walls overlap, an engine leaves a move or two without flow: a line that is not closed is
    joined across these gaps to the following lines if this closes it.

    Returns
    -------
    tuple
        The moves after which a gap is bridged; (n,) the line of each move; whether each line is a ring.
    """
    if not len(start):
        return np.empty(0, np.intp), np.empty(0, np.intp), np.empty(0, bool)
    is_first = np.ones(len(start), bool)
    is_first[1:] = (start[1:] != end[:-1]).any(axis=1) | (layer[1:] != layer[:-1])
    starts = np.flatnonzero(is_first)
    ends = np.append(starts[1:], len(start)) - 1
    is_near = np.hypot(*(start[starts] - end[ends]).T) < TOLERANCE_MM
    bridges: list[int] = []
    number = 0
    while number < len(starts):
        stop = number + 1
        if not is_near[number]:
            for last in range(number + 1, min(number + _MAX_GAPS, len(starts))):
                if is_near[last] or layer[starts[last]] != layer[starts[number]]:
                    break
                if np.hypot(*(start[starts[number]] - end[ends[last]])) < TOLERANCE_MM:
                    bridges += [int(move) for move in ends[number:last]]
                    stop = last + 1
                    break
        number = stop
    is_first[np.array(bridges, np.intp) + 1] = False
    run = np.cumsum(is_first) - 1
    first_moves = np.flatnonzero(is_first)
    last_moves = np.append(first_moves[1:], len(start)) - 1
    is_closed = np.hypot(*(start[first_moves] - end[last_moves]).T) < TOLERANCE_MM
    return np.array(bridges, np.intp), run, is_closed


def _build_strokes(start: Floats, end: Floats, half_width_mm: Floats) -> Geometry:
    """Build the area of lines (n, 2) with half widths (n,)."""
    lines = shapely.linestrings(np.stack((start, end), axis=1))
    return shapely.union_all(shapely.buffer(lines, half_width_mm))
