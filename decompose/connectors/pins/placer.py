"""Placer of the pins and keys of an assembly step: a pair far apart, and more where glue is far from both.

Keys in grooves, which lie along the joint, are preferred to pins in holes, because grooves print faster.
The two holes differ in depth, and the two grooves in length, so that the joint stays open by some millimetres
if a body is rotated by 180 degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial.distance import cdist

from decompose.arrays import Floats
from decompose.assembly import AssemblyStep
from decompose.connectors.coverage import Site, find_unreached_glue, sample_points, sort_places_by_gain
from decompose.connectors.faces import Side, Workpieces, erode_area
from decompose.connectors.keys import KeyMaker, KeyPlacer
from decompose.connectors.pair_shapes import PairShapes, find_free_pairs
from decompose.connectors.pins.sizes import END_GAP_MM, choose_depths_mm, choose_key_diameters_mm
from decompose.connectors.records import RIM_MM, Pin, Tool
from decompose.connectors.tools import make_hole
from decompose.options import PairShape
from decompose.pieces import list_polygons

# Minimum difference between the pin distances of two pairs, or distance of a key's ends from the groove of
# another pair, besides twice the largest clearance of a hole.
MIN_DISTANCE_DIFFERENCE_MM = 0.7
MIN_PAIR_DISTANCE_MM = 8.0  # minimum distance between the two pins of a pair, which prevent rotation
MIN_SLOT_DISTANCE_MM = 80.0  # minimum distance between two pins for which one hole is a slot
SLOT_MM = 0.25  # elongation of a slot at each end, for 0.2 % of shrinkage and the play of the pins
PLACE_PITCH_MM = 15.0  # distance between the places that are tried for further pins of a step
MAX_FURTHER_PINS = 8  # maximum number of pins of a step besides its pair
# Additional distance of a pair from the border of the face. It is added only if the pins then remain at least
# EXTRA_MARGIN_SHARE times as far apart as without it.
EXTRA_MARGIN_MM, EXTRA_MARGIN_SHARE = 2.0, 0.8
ROUNDING_MARGIN_MM = 0.03  # margin for shapely's buffers, which may cut off inner corners
MIN_CORNER_MM = 0.5  # corners of a hull that protrude by less are ignored


@dataclass(frozen=True, slots=True)
class PinPlacer:
    """Placer of the pins and keys of one step on its sites.

    Attributes
    ----------
    workpieces
        Parts, with the tools placed so far; new tools are added.
    step_number, step
        Number of the step, and the step.
    sites, sliding_sites
        Faces that close along the direction of the step, and faces that slide along it.
    glue_points_mm
        (n, 3) sample points on all glued faces of the step.
    pin_mm
        Diameter of the pins.
    """

    workpieces: Workpieces
    step_number: int
    step: AssemblyStep
    sites: list[Site]
    sliding_sites: list[Site]
    glue_points_mm: Floats
    pin_mm: float

    def place_connectors(self, used_shapes: Sequence[PairShape]) -> list[Pin]:
        """Place all keys and pins of the step; its pair is unlike those that are used.

        A pair of keys is tried first, because its grooves take the least print time; then pins, for inclined
        faces, and thin keys, for thin walls.
        """
        pins: list[Pin] = []
        key_placer, *thin_key_placers = [
            KeyPlacer(
                KeyMaker(self.workpieces, self.step_number, self.step.direction, key_mm),
                self.sites,
                self.glue_points_mm,
                pins,
                used_shapes,
                self.min_difference_mm,
            )
            for key_mm in choose_key_diameters_mm(self.pin_mm)
        ]
        key_placer.place_pair()
        if not pins:
            pins += self._place_pair(used_shapes)
        for placer in thin_key_placers:
            if not pins:
                placer.place_pair()
        for placer in (key_placer, *thin_key_placers):
            if not pins:
                placer.place_close_pair()
        if not pins:
            pins += self._place_single_pin()
        for placer in (key_placer, *thin_key_placers):
            if len(pins) < 2:
                placer.place_second_key()
        key_placer.place_further_keys()
        for _ in range(MAX_FURTHER_PINS if pins else 0):
            further_pin = self._place_further_pin(pins)
            if further_pin is None:
                break
            pins.append(further_pin)
        for placer in thin_key_placers:
            placer.place_further_keys()
        for placer in (key_placer, *thin_key_placers):
            placer.place_sliding_keys(self.sliding_sites)
        return pins

    @property
    def min_difference_mm(self) -> float:
        """Minimum difference between the pin distances of two pairs, or between the ends of their keys."""
        return 2.0 * max(blank.pin_fit_mm for blank in self.workpieces.blanks) + MIN_DISTANCE_DIFFERENCE_MM

    def _compute_hole_size_mm(self, side: Side, is_shallow: bool) -> tuple[float, float]:
        """Compute the width across flats and the depth of a deep or shallow hole in a part."""
        return self.pin_mm + self.workpieces.blanks[side.part].pin_fit_mm, choose_depths_mm(self.pin_mm)[
            is_shallow
        ]

    def _find_axis_areas(self, is_shallow: bool) -> list[shapely.Geometry]:
        """Find the area of each site in which the axis of a pin may lie, in the coordinates of its face."""
        return [
            shapely.intersection_all(
                [self._find_axis_area(side, is_shallow) for side in (site.moved_side, site.fixed_side)]
            )
            for site in self.sites
        ]

    def _find_axis_area(self, side: Side, is_shallow: bool) -> shapely.Geometry:
        """Find the area on one side of a face in which the axis of a pin may lie."""
        tool = make_hole(
            side.part,
            np.zeros(3),
            side.inward_normal,
            self._find_up_direction(side),
            self._compute_hole_size_mm(side, is_shallow),
            np.zeros(3),
        )
        if tool is None:
            return shapely.Polygon()
        slack_mm = ROUNDING_MARGIN_MM + (SLOT_MM if is_shallow else 0.0)
        outline = shapely.MultiPoint(side.project_onto_face(tool.points_mm)).convex_hull
        centre = shapely.minimum_bounding_circle(outline).centroid
        radius_mm = shapely.minimum_bounding_radius(outline) + RIM_MM + slack_mm
        area = self.workpieces.find_tool_area(side, float((tool.points_mm @ side.inward_normal).max()))
        places = area.buffer(-radius_mm)
        if places.is_empty:  # the outline may fit into a thin wall although its bounding circle does not
            return erode_area(area, outline.buffer(RIM_MM + slack_mm, 3))
        return shapely.transform(places, lambda points: points - (centre.x, centre.y))

    def _find_up_direction(self, side: Side) -> Floats:
        """Find the unit vector (3,) that points up in the pose of a side's part."""
        return self.workpieces.blanks[side.part].up_direction

    def _place_pair(self, used_shapes: Sequence[PairShape]) -> list[Pin]:
        """Place a deep and a shallow pin as far apart as possible, at a distance that no used pair has."""
        deep_areas, shallow_areas = (self._find_axis_areas(is_shallow) for is_shallow in (False, True))
        best_pair = self._find_farthest_pair(deep_areas, shallow_areas)
        if best_pair is None:
            return []
        inner_areas = [
            [area.buffer(-EXTRA_MARGIN_MM) for area in areas] for areas in (deep_areas, shallow_areas)
        ]
        inner_pair = self._find_farthest_pair(*inner_areas)
        if inner_pair is not None and inner_pair[0] >= EXTRA_MARGIN_SHARE * best_pair[0]:
            best_pair = inner_pair
        separation_mm, (deep_site, deep_point_mm), (shallow_site, farthest_point_mm) = best_pair
        deep_mm, shallow_mm = choose_depths_mm(self.pin_mm)
        for shift_mm in np.arange(0.0, separation_mm - MIN_PAIR_DISTANCE_MM, 0.5):
            # Move the shallow pin towards the deep one, within the plane of its face.
            offset_mm = self._project_points((deep_point_mm - farthest_point_mm)[None])[0]
            shallow_point_mm = farthest_point_mm + offset_mm * shift_mm / separation_mm
            shape = PairShapes.from_places(
                self.step.direction,
                (deep_point_mm[None], shallow_point_mm[None]),
                (None, None),
                (_compute_length_mm(deep_mm), _compute_length_mm(shallow_mm)),
            )
            if not find_free_pairs(shape, used_shapes, self.min_difference_mm).all():
                continue
            if not shallow_areas[shallow_site].contains(
                shapely.Point(self.sites[shallow_site].moved_side.project_onto_face(shallow_point_mm))
            ):
                continue
            deep_pin = self._make_pin(deep_site, deep_point_mm, False, np.zeros(3))
            if deep_pin is None:
                return []
            self.workpieces.add_tools(deep_pin.holes)
            shallow_pin = self._make_pin(
                shallow_site,
                shallow_point_mm,
                True,
                self._compute_slot_mm(deep_point_mm, shallow_point_mm),
            )
            if shallow_pin is not None:
                self.workpieces.add_tools(shallow_pin.holes)
                return [deep_pin, shallow_pin]
            self.workpieces.remove_tools(deep_pin.holes)
        return []

    def _compute_slot_mm(self, point_mm: Floats, end_mm: Floats) -> Floats:
        """Compute the elongation (3,) in mm of a hole along the line to another hole; 0 if that is near."""
        offset_mm, direction = end_mm - point_mm, self.step.direction
        separation_vector_mm = offset_mm - (offset_mm @ direction) * direction
        separation_mm = float(np.linalg.norm(separation_vector_mm))
        has_slot = separation_mm > MIN_SLOT_DISTANCE_MM
        return SLOT_MM * separation_vector_mm / separation_mm if has_slot else np.zeros(3)

    def _find_farthest_pair(
        self, deep_areas: list[shapely.Geometry], shallow_areas: list[shapely.Geometry]
    ) -> tuple[float, tuple[int, Floats], tuple[int, Floats]] | None:
        """Find the deep and the shallow place that are farthest apart: their distance, sites and points."""
        corners = [self._list_corners(areas) for areas in (deep_areas, shallow_areas)]
        if not all(len(sites) for sites, _ in corners):
            return None
        separations_mm = cdist(*(self._project_points(points) for _, points in corners))
        first, second = np.unravel_index(int(separations_mm.argmax()), separations_mm.shape)
        if separations_mm[first, second] < MIN_PAIR_DISTANCE_MM:
            return None
        (deep_sites, deep_points_mm), (shallow_sites, shallow_points_mm) = corners
        return (
            float(separations_mm[first, second]),
            (deep_sites[first], deep_points_mm[first]),
            (shallow_sites[second], shallow_points_mm[second]),
        )

    def _list_corners(self, areas: list[shapely.Geometry]) -> tuple[list[int], Floats]:
        """List the corners of the convex hull of each site's area, as points (n, 3), and their sites."""
        sites: list[int] = []
        points = [np.zeros((0, 3))]
        for number, area in enumerate(areas):
            corners = shapely.get_coordinates(
                area.buffer(-ROUNDING_MARGIN_MM).convex_hull.simplify(MIN_CORNER_MM)
            )
            sites += [number] * len(corners)
            points.append(self.sites[number].moved_side.compute_points_mm(corners))
        return sites, np.concatenate(points)

    def _project_points(self, points_mm: Floats) -> Floats:
        """Project points (n, 3) along the direction of the step."""
        return points_mm - np.outer(points_mm @ self.step.direction, self.step.direction)

    def _place_single_pin(self) -> list[Pin]:
        """Place one pin in the middle of the widest place, deep if possible."""
        for is_shallow in (False, True):
            areas = self._find_axis_areas(is_shallow)
            polygons = [(p, n) for n, area in enumerate(areas) for p in list_polygons(area) if p.area > 0.0]
            if polygons:
                polygon, number = max(polygons, key=lambda pair: pair[0].area)
                middle = shapely.maximum_inscribed_circle(polygon).coords[0]
                pin = self._make_pin(
                    number,
                    self.sites[number].moved_side.compute_points_mm(np.array(middle)),
                    is_shallow,
                    np.zeros(3),
                )
                if pin is not None:
                    self.workpieces.add_tools(pin.holes)
                    return [pin]
        return []

    def _place_further_pin(self, pins: Sequence[Pin]) -> Pin | None:
        """Place a shallow pin where it reaches the largest area that no pin reaches yet.

        None if this area is too small at every place where a pin is possible.
        """
        unreached_points_mm = find_unreached_glue(self.glue_points_mm, pins)
        if not len(unreached_points_mm):
            return None
        areas = self._find_axis_areas(True)
        sites, corners_mm = self._list_corners(areas)
        inner_points_mm = [
            sample_points(site.moved_side, area.buffer(-ROUNDING_MARGIN_MM), PLACE_PITCH_MM)
            for site, area in zip(self.sites, areas, strict=True)
        ]
        sites += [number for number, points in enumerate(inner_points_mm) for _ in points]
        points_mm = np.concatenate([corners_mm, *inner_points_mm])
        for best in sort_places_by_gain(points_mm, unreached_points_mm):
            pin = self._make_pin(sites[best], points_mm[best], True, np.zeros(3))
            if pin is not None:
                self.workpieces.add_tools(pin.holes)
                return pin
        return None

    def _make_pin(self, site_number: int, point_mm: Floats, is_shallow: bool, slot_mm: Floats) -> Pin | None:
        """Make a pin with its holes; None if a hole would need support, or have too thin a wall around it."""
        site = self.sites[site_number]
        depth_mm = choose_depths_mm(self.pin_mm)[is_shallow]
        holes: list[Tool] = []
        for side, elongation_mm in ((site.moved_side, slot_mm), (site.fixed_side, np.zeros(3))):
            hole = make_hole(
                side.part,
                point_mm,
                side.inward_normal,
                self._find_up_direction(side),
                self._compute_hole_size_mm(side, is_shallow),
                elongation_mm,
            )
            if hole is None or not self._has_clearance(side, hole):
                return None
            holes.append(hole)
        return Pin(
            step=self.step_number,
            joint=site.moved_side.joint,
            position_mm=point_mm,
            axis=self.step.direction,
            diameter_mm=self.pin_mm,
            depth_mm=depth_mm,
            length_mm=_compute_length_mm(depth_mm),
            is_slotted=bool(slot_mm.any()),
            holes=(holes[0], holes[1]),
        )

    def _has_clearance(self, side: Side, hole: Tool) -> bool:
        """Check whether a hole keeps its distance from the outside of the part and from other tools."""
        depth_mm = float((hole.points_mm @ side.inward_normal).max()) - side.sign * side.face.offset_mm
        outline = shapely.MultiPoint(side.project_onto_face(hole.points_mm)).convex_hull
        return bool(self.workpieces.find_tool_area(side, depth_mm).contains(outline.buffer(RIM_MM)))


def _compute_length_mm(depth_mm: float) -> float:
    """Compute the length of a pin from the depth of its holes."""
    return 2.0 * (depth_mm - END_GAP_MM)
