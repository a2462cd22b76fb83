"""Places of keys: pins that lie along a joint, half in a V groove of each part.

Grooves take less print time than holes. They are shallow and taper, so that they stay inside a sloping thin
wall, where a hole has no space. The sides of a key prevent movement across the key, and its ends prevent
movement along it. Where faces slide over each other, keys lie along the direction of the step. The groove of
one part is closed at both ends; that of the other part leads to a face that meets only at the end of the
movement, and the key enters through this exit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import shapely
from scipy.spatial.distance import cdist

from decompose.arrays import Floats
from decompose.connectors.coverage import Site, sample_points
from decompose.connectors.faces import Side, Workpieces
from decompose.connectors.records import KEY_RIM_MM, Pin, Tool
from decompose.connectors.tools import (
    LIP_MM,
    MAX_GROOVE_SIN,
    compute_overhang_sin,
    cut_groove_at_exit,
    make_groove,
    needs_bridge,
)
from decompose.geometry import compute_cross_product
from decompose.pieces import list_polygons

MIN_KEY_MM = 4.0  # minimum length of a key
# Minimum length of a key beyond its diameter. The long key exceeds the short one by this length and its
# diameter, so that it does not fit into the groove of the short one.
EXCESS_MM = 1.0
END_GAP_MM = 0.25  # gap at each end of a key
DEPTH_SAMPLES = 6  # number of depths at which the wall around a groove is examined
# Grooves are tried between pairs of points on the boundary of a polygon: minimum distance between successive
# points, and maximum number of points.
BOUNDARY_PITCH_MM, MAX_BOUNDARY_POINTS = 1.0, 150
PLACE_PITCH_MM = 3.0  # distance between the places that are tried on faces that slide
ROUNDING_MARGIN_MM = 0.05  # tolerance for the rounded corners of shapely's buffers
MAX_EXIT_DISTANCE_MM = 80.0  # maximum distance that a key slides through its groove


def choose_key_lengths_mm(key_mm: float) -> tuple[float, float]:
    """Choose the lengths of the long and the short key of a pair, in steps of 0.5 mm.

    Additional keys are short as well. Both are as short as possible, because the print time of a groove in a
    level face grows with its length.
    """
    short_mm = max(MIN_KEY_MM, math.ceil(2.0 * (key_mm + EXCESS_MM)) / 2.0)
    return math.ceil(2.0 * (short_mm + key_mm + EXCESS_MM)) / 2.0, short_mm


def compute_groove_depth_mm(key_mm: float, fit_mm: float) -> float:
    """Compute the depth of a groove, which is half its width.

    The sides of the groove touch a circle whose diameter is that of the key plus the clearance.

    Parameters
    ----------
    key_mm
        Diameter of the key.
    fit_mm
        Clearance of the groove.
    """
    return (key_mm + fit_mm) / 2.0 * math.sqrt(2.0)


def compute_bottom_length_mm(key_mm: float, depth_mm: float, length_mm: float) -> float:
    """Compute the length of the bottom of a groove.

    The ends of the groove slope by 45 degrees. At the depth of the key's lowest line, which is the radius of
    the key, the groove is longer than the key by a gap at each end.

    Parameters
    ----------
    key_mm, depth_mm
        Diameter of the key, and depth of the groove.
    length_mm
        Length of the key.
    """
    return length_mm + 2.0 * END_GAP_MM - 2.0 * (depth_mm - key_mm / 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class KeyPlace:
    """Place where a key may lie.

    Attributes
    ----------
    site, middle_mm, direction
        Glued face, middle (3,) of the key, and its direction, a (3,) unit vector.
    open_part
        Part whose groove has an exit in that direction; None if neither groove has an exit.
    exit_distance_mm
        Distance from the middle of the key to the exit.
    """

    site: Site
    middle_mm: Floats
    direction: Floats
    open_part: int | None = None
    exit_distance_mm: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class KeyPath:
    """Path of a key on a site: the side whose groove has an exit, and the direction (3,) of the exit.

    An exit of the moved part points against the direction of the step, and one of the fixed part along it.
    """

    site: Site
    open_side: Side
    direction: Floats


@dataclass(frozen=True, slots=True)
class KeyMaker:
    """Maker of keys of one diameter for a step with a direction (3,); also finds places for them."""

    workpieces: Workpieces
    step_number: int
    direction: Floats
    key_mm: float
    _bottom_areas: dict[int, tuple[int, shapely.Geometry]] = field(default_factory=dict)

    @property
    def lengths_mm(self) -> tuple[float, float]:
        """Lengths of the long and the short key of a pair."""
        return choose_key_lengths_mm(self.key_mm)

    @property
    def short_mm(self) -> float:
        """Length of the short key of a pair, and of additional keys."""
        return self.lengths_mm[1]

    def find_places(self, sites: Sequence[Site], length_mm: float) -> list[KeyPlace]:
        """Find the places on the sites where the grooves of a key leave enough wall in both parts.

        Parameters
        ----------
        sites
            Faces that close along the direction of the step.
        length_mm
            Length of the key.
        """
        return [place for site in sites for place in self._find_places_on_site(site, length_mm)]

    def find_sliding_places(
        self, sites: Sequence[Site], exits: Sequence[Site], length_mm: float
    ) -> list[KeyPlace]:
        """Find the places on faces that slide, those with the shortest way to their exit first.

        Parameters
        ----------
        sites
            Faces that slide over each other along the direction of the step.
        exits
            Faces that close along the direction of the step.
        length_mm
            Length of the key.
        """
        places: list[KeyPlace] = []
        for site in sites:
            middles_mm = self._find_sliding_middles(site, length_mm)
            for side, direction in ((site.moved_side, -self.direction), (site.fixed_side, self.direction)):
                exit_sides = [end for pair in exits for end in (pair.moved_side, pair.fixed_side)]
                exit_sides = [end for end in exit_sides if end.part == side.part]
                if len(middles_mm) and exit_sides:
                    key_path = KeyPath(site, side, direction)
                    places += self._find_places_with_exit(key_path, middles_mm, exit_sides)
        return sorted(places, key=lambda place: place.exit_distance_mm)

    def make_key(self, place: KeyPlace, length_mm: float) -> Pin | None:
        """Make a key with its grooves; None if a groove would need support.

        Parameters
        ----------
        place
            Place of the key.
        length_mm
            Length of the key.
        """
        site = place.site
        half_mm = self._compute_bottom_mm(site, length_mm) / 2.0
        grooves: list[Tool] = []
        for side in (site.moved_side, site.fixed_side):
            up = self.workpieces.blanks[side.part].up_direction
            is_open = side.part == place.open_part
            ends_mm = [-half_mm, place.exit_distance_mm + LIP_MM if is_open else half_mm]
            ends = place.middle_mm + np.outer(ends_mm, place.direction)
            groove = make_groove(side.part, ends, side.inward_normal, self._compute_depth_mm(site))
            overhang_sin = compute_overhang_sin(groove.points_mm, side.inward_normal, up)
            if overhang_sin > MAX_GROOVE_SIN or needs_bridge(groove, up):
                return None
            grooves.append(cut_groove_at_exit(groove, ends[1], place.direction) if is_open else groove)
        return Pin(
            step=self.step_number,
            joint=site.moved_side.joint,
            position_mm=place.middle_mm,
            axis=self.direction,
            diameter_mm=self.key_mm,
            depth_mm=self._compute_depth_mm(site),
            length_mm=length_mm,
            is_slotted=False,
            holes=(grooves[0], grooves[1]),
            key_direction=place.direction,
        )

    def _compute_depth_mm(self, site: Site) -> float:
        """Compute the depth of both grooves, for the larger clearance of the two parts."""
        fit_mm = max(
            self.workpieces.blanks[side.part].pin_fit_mm for side in (site.moved_side, site.fixed_side)
        )
        return compute_groove_depth_mm(self.key_mm, fit_mm)

    def _compute_bottom_mm(self, site: Site, length_mm: float) -> float:
        """Compute the length of the bottom of a groove."""
        return compute_bottom_length_mm(self.key_mm, self._compute_depth_mm(site), length_mm)

    def _find_places_on_site(self, site: Site, length_mm: float) -> Iterator[KeyPlace]:
        """Yield the places on a site where both ends of a groove's bottom are on the boundary of an area."""
        bottom_mm = self._compute_bottom_mm(site, length_mm)
        for polygon in list_polygons(self._find_common_area(site)):
            points, pitch_mm = _sample_boundary(polygon)
            distances_mm = np.triu(cdist(points, points))
            first, second = np.nonzero(np.abs(distances_mm - bottom_mm) < min(pitch_mm, PLACE_PITCH_MM) / 2.0)
            if not len(first):
                continue
            directions = (points[second] - points[first]) / distances_mm[first, second][:, None]
            middles = (points[first] + points[second]) / 2.0
            half_mm = bottom_mm / 2.0 * directions
            lines = shapely.linestrings(np.stack([middles - half_mm, middles + half_mm], axis=1))
            shapely.prepare(polygon)
            for n in np.flatnonzero(shapely.covers(polygon.buffer(ROUNDING_MARGIN_MM / 2.0), lines)).tolist():
                direction = directions[n] @ site.moved_side.face.axes
                yield KeyPlace(site, site.moved_side.compute_points_mm(middles[n]), direction)

    def _find_sliding_middles(self, site: Site, length_mm: float) -> Floats:
        """Find the middles (n, 3) of keys in the direction of the step that have enough wall around them."""
        area = self._find_common_area(site)
        middles = site.moved_side.project_onto_face(sample_points(site.moved_side, area, PLACE_PITCH_MM))
        half_mm = (
            self._compute_bottom_mm(site, length_mm) / 2.0 * site.moved_side.project_onto_face(self.direction)
        )
        lines = shapely.linestrings(np.stack([middles - half_mm, middles + half_mm], axis=1))
        shapely.prepare(area)
        return site.moved_side.compute_points_mm(middles[shapely.covers(area, lines)])

    def _find_places_with_exit(
        self, key_path: KeyPath, middles_mm: Floats, exit_sides: Sequence[Side]
    ) -> Iterator[KeyPlace]:
        """Yield the places at these middles (n, 3) whose groove can have an exit through one of the sides."""
        side, direction = key_path.open_side, key_path.direction
        half_width_mm = self._compute_depth_mm(key_path.site) + KEY_RIM_MM + ROUNDING_MARGIN_MM
        area = self.workpieces.find_solid_area(side, half_width_mm, KEY_RIM_MM)
        shapely.prepare(area)
        across = half_width_mm * compute_cross_product(side.inward_normal, direction)
        for end in exit_sides:
            end_mm = float(end.face.offset_mm * end.face.normal @ direction)
            for middle_mm in middles_mm:
                exit_distance_mm = end_mm - float(middle_mm @ direction)
                if not 0.0 < exit_distance_mm <= MAX_EXIT_DISTANCE_MM:
                    continue
                section = middle_mm + exit_distance_mm * direction + np.array([-across, across])
                lower_corners = [
                    section + depth_mm * side.inward_normal
                    for depth_mm in (ROUNDING_MARGIN_MM, half_width_mm)
                ]
                path_corners = np.concatenate(
                    [middle_mm + np.array([-across, across]), section - ROUNDING_MARGIN_MM * direction]
                )
                if end.face.outline.covers(
                    _build_hull(end.project_onto_face(np.concatenate(lower_corners)))
                ) and area.covers(_build_hull(side.project_onto_face(path_corners))):
                    yield KeyPlace(key_path.site, middle_mm, direction, side.part, exit_distance_mm)

    def _find_common_area(self, site: Site) -> shapely.Geometry:
        """Find the area of a site for the bottoms of both grooves; cached until a part's tools change."""
        sides = (site.moved_side, site.fixed_side)
        change_count = sum(self.workpieces.count_changes(side.part) for side in sides)
        kept_count, area = self._bottom_areas.get(id(site), (-1, shapely.Polygon()))
        if kept_count != change_count:
            depth_mm = self._compute_depth_mm(site)
            area = shapely.intersection_all([self._find_bottom_area(side, depth_mm) for side in sides])
            self._bottom_areas[id(site)] = change_count, area
        return area

    def _find_bottom_area(self, side: Side, depth_mm: float) -> shapely.Geometry:
        """Find the area for the bottom of a groove.

        The groove becomes narrower with depth, so its distance from the outside is checked at several depths.
        """
        levels_mm = np.linspace(0.0, depth_mm + KEY_RIM_MM, DEPTH_SAMPLES)
        areas = []
        for above_mm, below_mm in pairwise(levels_mm.tolist()):
            margin_mm = depth_mm + min(KEY_RIM_MM, math.sqrt(2.0) * KEY_RIM_MM - above_mm)
            areas.append(
                self.workpieces.find_solid_area(side, below_mm, KEY_RIM_MM).buffer(
                    -margin_mm - ROUNDING_MARGIN_MM
                )
            )
        return shapely.intersection_all(areas)


def _build_hull(points: Floats) -> shapely.Geometry:
    """Build the convex hull of points (n, 2)."""
    return shapely.MultiPoint(points).convex_hull


def _sample_boundary(polygon: shapely.Polygon) -> tuple[Floats, float]:
    """Sample points (n, 2) along the boundary of a polygon; return the points and their spacing in mm."""
    rings = [polygon.exterior, *polygon.interiors]
    pitch_mm = max(BOUNDARY_PITCH_MM, sum(ring.length for ring in rings) / MAX_BOUNDARY_POINTS)
    points = [shapely.line_interpolate_point(ring, np.arange(0.0, ring.length, pitch_mm)) for ring in rings]
    return np.asarray(shapely.get_coordinates(np.concatenate(points))), pitch_mm
