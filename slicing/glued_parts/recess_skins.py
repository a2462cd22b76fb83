"""Removal of skin at hidden recesses: marks and grooves for keys in level faces that gluing hides.

CuraEngine closes each recess with as many solid layers as a visible face has, in patches that take longer
than the recess itself. Walls close a groove, which tapers, and the solid layers of the face close a mark.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from slicing.checks import Toolpath
from slicing.glued_parts.inner_walls import removes_inner_walls
from slicing.glued_parts.rewriting import Segment, change_moves, measure_lengths_mm
from slicing.glued_parts.sides import (
    Bools,
    Indices,
    find_level_lines,
    measure_spare_times_s,
)
from slicing.glued_parts.travel import (
    OuterWalls,
    Trail,
    list_runs,
    mark_level_travel,
    mark_moves_after_commands,
    mark_wipes,
)
from slicing.settings import EngineSettings

MARGIN_MM = 2.5
"""Distance from a recess within which its patch of skin ends: two walls, and the expansion of the skin."""
_Z_TOLERANCE_MM = 0.01
_LINE_REACH_MM = 0.4  # distance from the centre of a line of skin that the next line may have
_EDGE_DEPTH_MM = 0.3  # depth of a patch's edge behind the centre line of the outer wall beside it
_RIM_MM = 0.6  # maximum distance from a recess to that depth behind the wall around it
_GAP_TOLERANCE_MM = 0.1  # half the maximum width of a gap in another layer that needs no skin
_MIN_GAP_MM2 = 0.05  # minimum area of a gap that needs skin, without that width at its edges
_SAVED_TIME_FACTOR = 1.2
"""Ratio of the time that removing a patch saves to its length over its speed: the head also accelerates less
often. It keeps layers from becoming shorter than the minimum layer time."""


@dataclass(frozen=True, slots=True)
class HiddenRecess:
    """Hidden recess in a level face: its box in bed-centred mm, and the heights of face and bottom."""

    min_x_mm: float
    min_y_mm: float
    max_x_mm: float
    max_y_mm: float
    face_z_mm: float
    bottom_z_mm: float

    @property
    def opens_upwards(self) -> bool:
        """True if it opens upwards, false if it opens towards the bed."""
        return self.bottom_z_mm < self.face_z_mm

    def move(self, shift_mm: tuple[float, float]) -> HiddenRecess:
        """Move the recess by X and Y in mm."""
        x_mm, y_mm = shift_mm
        return replace(
            self,
            min_x_mm=self.min_x_mm + x_mm,
            max_x_mm=self.max_x_mm + x_mm,
            min_y_mm=self.min_y_mm + y_mm,
            max_y_mm=self.max_y_mm + y_mm,
        )

    def build_area(self, margin_mm: float) -> shapely.Polygon:
        """Build the area of its box and of a margin around it."""
        box = shapely.box(self.min_x_mm, self.min_y_mm, self.max_x_mm, self.max_y_mm)
        return box.buffer(margin_mm, join_style="mitre")

    def find_patch_heights_mm(self, settings: EngineSettings) -> tuple[float, float]:
        """Find the heights between which its patches are printed, without the solid layers of its face."""
        layer_mm, values = settings.layer_height_mm, settings.extruder
        if not self.opens_upwards:
            first_mm = settings.layer_height_0_mm + (int(values["initial_bottom_layers"]) - 1) * layer_mm
            return self.face_z_mm + first_mm, self.bottom_z_mm + (settings.bottom_layers + 1) * layer_mm
        top_mm = int(values["top_layers"]) * layer_mm
        return self.bottom_z_mm - top_mm - layer_mm, self.face_z_mm - top_mm


def remove_recess_skins(
    gcode: bytes, path: Toolpath, recesses: Sequence[HiddenRecess], settings: EngineSettings
) -> bytes:
    """Remove the patches of skin that close hidden recesses, if `removes_inner_walls`.

    Patches that extend beyond the surroundings of a recess close something else as well, and stay. So do
    those at which a layer below or above has another gap.

    Parameters
    ----------
    gcode
        CuraEngine's output.
    path
        Moves and comments of the same file.
    recesses
        Hidden recesses of the part, in its place on the bed.
    settings
        Settings with which it was sliced.

    Returns
    -------
    bytes
        G-code without these lines; the same object if there are none.

    Raises
    ------
    SliceRejected
        `FLAVOUR` if the changed file cannot be read; see `read_toolpath`.
    """
    if not recesses or not removes_inner_walls(settings):
        return gcode
    is_removed = np.zeros(len(path.layer), np.bool_)
    spare_s = measure_spare_times_s(path, settings)
    lengths_mm = measure_lengths_mm(path)
    for patch in _list_patches(path, recesses, settings):
        layer = int(path.layer[patch[0]])
        saved_s = _SAVED_TIME_FACTOR * 60.0 * float((lengths_mm[patch] / path.feed_mm_min[patch]).sum())
        if saved_s <= spare_s.get(layer, 0.0):
            spare_s[layer] -= saved_s
            is_removed[patch] = True
    segments = _list_segments(path, is_removed, settings)
    return change_moves(gcode, path, segments, settings)


def _list_patches(
    path: Toolpath, recesses: Sequence[HiddenRecess], settings: EngineSettings
) -> Iterator[Indices]:
    """Yield the moves (k,) of each patch of skin that closes nothing but hidden recesses."""
    skin_moves = np.flatnonzero(find_level_lines(path) & path.is_feature("SKIN") & (path.layer > 0))
    z_mm = path.end[skin_moves, 2]
    limits_mm = [recess.find_patch_heights_mm(settings) for recess in recesses]
    bed_mm = [float(settings.global_[f"machine_{axis}"]) for axis in ("width", "depth")]
    placed_recesses = [recess.move((bed_mm[0] / 2.0, bed_mm[1] / 2.0)) for recess in recesses]
    outer_walls, last_layer = OuterWalls(path), int(path.layer.max())
    solid_count = max(settings.bottom_layers, int(settings.extruder["top_layers"]))
    for layer in np.unique(path.layer[skin_moves]).tolist():
        in_layer = path.layer[skin_moves] == layer
        layer_z_mm = float(z_mm[in_layer][0])
        near_recesses = [
            recess
            for recess, (low_mm, high_mm) in zip(placed_recesses, limits_mm, strict=True)
            if low_mm + _Z_TOLERANCE_MM < layer_z_mm < high_mm + _Z_TOLERANCE_MM
        ]
        if not near_recesses:
            continue
        area, moves = _join_areas(near_recesses, MARGIN_MM), skin_moves[in_layer]
        lower_area = _join_areas([r for r in near_recesses if not r.opens_upwards], _RIM_MM)
        upper_area = _join_areas([r for r in near_recesses if r.opens_upwards], _RIM_MM)
        lower_layers = range(max(0, layer - solid_count), layer)
        upper_layers = range(layer + 1, min(last_layer, layer + solid_count) + 1)
        lines = shapely.linestrings(np.stack([path.start[moves, :2], path.end[moves, :2]], axis=1))
        skin = shapely.union_all(shapely.buffer(lines, _LINE_REACH_MM))
        for polygon in getattr(skin, "geoms", [skin]):
            patch = polygon.buffer(-_LINE_REACH_MM / 2.0)
            if (
                area.covers(patch)
                and not _has_gaps(patch, lower_layers, outer_walls, lower_area)
                and not _has_gaps(patch, upper_layers, outer_walls, upper_area)
            ):
                yield moves[shapely.intersects(polygon, lines)]


def _join_areas(recesses: Sequence[HiddenRecess], margin_mm: float) -> shapely.Geometry:
    return shapely.union_all([recess.build_area(margin_mm) for recess in recesses])


def _has_gaps(
    patch: shapely.Geometry, layers: Iterable[int], outer_walls: OuterWalls, recess_area: shapely.Geometry
) -> bool:
    """Check whether layers of a part have gaps at a patch, other than holes within an area of recesses."""
    for layer in layers:
        area = outer_walls.build_travel_area(layer)
        polygons = shapely.get_parts(area)
        holes = [
            shapely.Polygon(ring)
            for polygon in polygons[shapely.intersects(polygons, patch)]
            for ring in polygon.interiors
        ]
        recesses = [hole for hole in holes if recess_area.covers(hole)]
        filled_area = shapely.union_all([area, *recesses]).buffer(-_EDGE_DEPTH_MM)
        if patch.difference(filled_area).buffer(-_GAP_TOLERANCE_MM).area > _MIN_GAP_MM2:
            return True
    return False


def _list_segments(path: Toolpath, is_removed: Bools, settings: EngineSettings) -> dict[int, list[Segment]]:
    """List the segments that replace removed moves (n,), and the travel between them, by shorter travel."""
    segments: dict[int, list[Segment]] = {}
    outer_walls, travel_mm_min = OuterWalls(path), 60.0 * settings.speed_travel_mm_s
    is_travel = mark_level_travel(path)
    is_linked = is_removed | (is_travel & ~mark_wipes(path, settings))
    is_joined = is_linked[1:] & is_linked[:-1] & ~mark_moves_after_commands(path)[1:-1]
    for moves in list_runs(is_joined):
        removed_moves = moves[is_removed[moves]]
        if len(removed_moves) == 0:
            continue
        points_mm = np.concatenate([path.start[moves[:1], :2], path.end[moves, :2]])
        area = outer_walls.build_travel_area(int(path.layer[removed_moves[0]]))
        route_mm = Trail(points_mm).find_route(points_mm[0], points_mm[-1], area)
        segments |= {int(move): [] for move in moves}
        segments[int(moves[0])] = [Segment(x, y, travel_mm_min) for x, y in route_mm[1:].tolist()]
    return segments
