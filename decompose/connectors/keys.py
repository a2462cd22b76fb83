"""Places of keys: pins that lie along a joint, half in a V groove of each part.

A key serves joints whose rims have no room for a hole. Its groove is shallow and tapers, so that it stays
inside of a sloping thin wall. It holds the parts across its length by its sides, along it by its ends.
Where faces slide over each other, keys lie along the direction of the step: the groove of one part ends on
both sides, and that of the other leaves it through a face that closes, so that the key enters there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import shapely
from scipy.spatial.distance import cdist

from decompose.arrays import Bools, Floats
from decompose.connectors.coverage import Site, find_far_glue, sample_points, sort_by_gain
from decompose.connectors.faces import Room, Side
from decompose.connectors.records import KEY_RIM_MM, Pin, Tool
from decompose.connectors.tools import (
    GROOVE_SIN,
    LIP_MM,
    closes_in_a_step,
    cut_at_exit,
    make_groove,
    overhang_sin,
)
from decompose.pieces import list_polygons

SHORT_MM = 5.0  # length of the shorter key of a pair, and of additional keys
LONGER_MM = 1.0  # excess over the mouth of the short groove, on whose rims a reversed long key stays
END_MM = 0.25  # gap at each end of a key
LEVELS = 6  # depths at which the wall around a groove is examined
NEAREST_MM = 12.0  # minimum distance between two keys, or between a key and a pin
LEVEL_LOSS = 0.1  # loss of weight of a place for each level face: a groove there prints several times longer
MAX_TRIED = 20  # places that are tried, the best first
PITCH_MM = 1.0  # least distance of the points between which grooves are tried
MAX_POINTS = 150  # maximum number of these points on a face
SEAT_MM = 3.0  # pitch of the places that are tried on faces that slide
SLACK_MM = 0.05  # tolerance for the rounding of buffers
MAX_EXIT_MM = 80.0  # maximum distance that a key slides through its groove


def choose_key_lengths_mm(key_mm: float) -> tuple[float, float]:
    """Choose the lengths of the long and the short key of a pair, in half millimetres."""
    return math.ceil(2.0 * (SHORT_MM + key_mm + LONGER_MM)) / 2.0, SHORT_MM


def compute_groove_depth_mm(key_mm: float, fit_mm: float) -> float:
    """Compute the depth of a groove, which is half its width.

    Its sides touch a circle as wide as the key and the fit.
    """
    return (key_mm + fit_mm) / 2.0 * math.sqrt(2.0)


def compute_bottom_mm(key_mm: float, depth_mm: float, length_mm: float) -> float:
    """Compute the length of the bottom of a groove; its ends rise from there to the ends of the key."""
    return length_mm + 2.0 * END_MM - 2.0 * (depth_mm - key_mm / 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class KeyPlace:
    """Place where a key may lie.

    Attributes
    ----------
    site, at_mm, along
        Its faces, its middle (3,), and its direction (3,).
    open_part, exit_mm
        Part whose groove has an exit along that direction, and the distance of the exit from the middle; None
        if no groove has one.
    """

    site: Site
    at_mm: Floats
    along: Floats
    open_part: int | None = None
    exit_mm: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class KeySlide:
    """Path of a key on a site: the side through which its groove exits, and the direction (3,) of the exit.

    The groove of the moved part exits against the direction of the step, that of the fixed part along it.
    """

    site: Site
    open_side: Side
    along: Floats


@dataclass(frozen=True, slots=True)
class KeyMaker:
    """Finds places of keys of one diameter, and makes them for a step with a direction (3,)."""

    room: Room
    step: int
    direction: Floats
    key_mm: float

    @property
    def lengths_mm(self) -> tuple[float, float]:
        """Lengths of the long and the short key of a pair."""
        return choose_key_lengths_mm(self.key_mm)

    def find_places(self, sites: Sequence[Site], length_mm: float) -> list[KeyPlace]:
        """List the places on the sites where a key of a length leaves a sufficient wall on both sides."""
        return [place for site in sites for place in self._find_on_site(site, length_mm)]

    def find_sliding_places(
        self, sites: Sequence[Site], exits: Sequence[Site], length_mm: float
    ) -> list[KeyPlace]:
        """List the places on faces that slide, the nearest to its exit first.

        Parameters
        ----------
        sites
            Faces that slide over each other along the direction of the step.
        exits
            Faces of the step that close along it.
        length_mm
            Length of the key.
        """
        places: list[KeyPlace] = []
        for site in sites:
            seats = self._find_seats(site, length_mm)
            for side, along in ((site.moved, -self.direction), (site.fixed, self.direction)):
                ends = [end for pair in exits for end in (pair.moved, pair.fixed) if end.part == side.part]
                if len(seats) and ends:
                    places += self._find_exits(KeySlide(site, side, along), seats, ends)
        return sorted(places, key=lambda place: place.exit_mm)

    def make(self, place: KeyPlace, length_mm: float) -> Pin | None:
        """Make a key with its grooves; None where one of them does not print without support."""
        site = place.site
        half_mm = self._groove_mm(site, length_mm) / 2.0
        grooves: list[Tool] = []
        for side in (site.moved, site.fixed):
            up = self.room.blanks[side.part].up
            is_open = side.part == place.open_part
            ends_mm = [-half_mm, place.exit_mm + LIP_MM if is_open else half_mm]
            ends = place.at_mm + np.outer(ends_mm, place.along)
            groove = make_groove(side.part, ends, side.into, self._depth_mm(site))
            if overhang_sin(groove.points_mm, side.into, up) > GROOVE_SIN or closes_in_a_step(groove, up):
                return None
            grooves.append(cut_at_exit(groove, ends[1], place.along) if is_open else groove)
        return Pin(
            step=self.step,
            joint=site.moved.joint,
            at_mm=place.at_mm,
            axis=self.direction,
            diameter_mm=self.key_mm,
            depth_mm=self._depth_mm(site),
            length_mm=length_mm,
            slotted=False,
            holes=(grooves[0], grooves[1]),
            along=place.along,
        )

    def _depth_mm(self, site: Site) -> float:
        """Compute the depth of both grooves, for the wider fit of the two parts."""
        fit_mm = max(self.room.blanks[side.part].pin_fit_mm for side in (site.moved, site.fixed))
        return compute_groove_depth_mm(self.key_mm, fit_mm)

    def _groove_mm(self, site: Site, length_mm: float) -> float:
        """Compute the length of the bottom of a groove."""
        return compute_bottom_mm(self.key_mm, self._depth_mm(site), length_mm)

    def _find_on_site(self, site: Site, length_mm: float) -> Iterator[KeyPlace]:
        room = shapely.intersection_all(
            [self._find_room(side, self._depth_mm(site)) for side in (site.moved, site.fixed)]
        )
        bottom_mm = self._groove_mm(site, length_mm)
        for polygon in list_polygons(room):
            points, pitch_mm = _list_rim(polygon)
            distances_mm = np.triu(cdist(points, points))
            first, second = np.nonzero(np.abs(distances_mm - bottom_mm) < min(pitch_mm, SEAT_MM) / 2.0)
            if not len(first):
                continue
            along = (points[second] - points[first]) / distances_mm[first, second][:, None]
            middles = (points[first] + points[second]) / 2.0
            half = bottom_mm / 2.0 * along
            lines = shapely.linestrings(np.stack([middles - half, middles + half], axis=1))
            shapely.prepare(polygon)
            for n in np.flatnonzero(shapely.covers(polygon.buffer(SLACK_MM / 2.0), lines)).tolist():
                direction = along[n] @ site.moved.face.axes
                yield KeyPlace(site, site.moved.lift(middles[n]), direction)

    def _find_seats(self, site: Site, length_mm: float) -> Floats:
        """Find the middles (n, 3) of keys along the direction of the step that leave sufficient walls."""
        room = shapely.intersection_all(
            [self._find_room(side, self._depth_mm(site)) for side in (site.moved, site.fixed)]
        )
        middles = site.moved.flatten(sample_points(site.moved, room, SEAT_MM))
        half = self._groove_mm(site, length_mm) / 2.0 * site.moved.flatten(self.direction)
        lines = shapely.linestrings(np.stack([middles - half, middles + half], axis=1))
        shapely.prepare(room)
        return site.moved.lift(middles[shapely.covers(room, lines)])

    def _find_exits(self, slide: KeySlide, seats_mm: Floats, ends: Sequence[Side]) -> Iterator[KeyPlace]:
        """Yield places of keys at seats (n, 3) whose groove can leave the part through one of its faces."""
        side, along = slide.open_side, slide.along
        half_width_mm = self._depth_mm(slide.site) + KEY_RIM_MM + SLACK_MM
        area = self.room.find_solid_area(side, half_width_mm, KEY_RIM_MM)
        shapely.prepare(area)
        across = half_width_mm * np.cross(side.into, along)
        for end in ends:
            end_mm = float(end.face.offset_mm * end.face.normal @ along)
            for seat_mm in seats_mm:
                exit_mm = end_mm - float(seat_mm @ along)
                if not 0.0 < exit_mm <= MAX_EXIT_MM:
                    continue
                section = seat_mm + exit_mm * along + np.array([-across, across])
                below = [section + depth_mm * side.into for depth_mm in (SLACK_MM, half_width_mm)]
                way = np.concatenate([seat_mm + np.array([-across, across]), section - SLACK_MM * along])
                if end.face.outline.covers(_hull(end.flatten(np.concatenate(below)))) and area.covers(
                    _hull(side.flatten(way))
                ):
                    yield KeyPlace(slide.site, seat_mm, along, side.part, exit_mm)

    def _find_room(self, side: Side, depth_mm: float) -> shapely.Geometry:
        """Find where the bottom of a groove may be, level by level, as its sides taper."""
        levels_mm = np.linspace(0.0, depth_mm + KEY_RIM_MM, LEVELS)
        rooms = []
        for above_mm, below_mm in pairwise(levels_mm.tolist()):
            reach_mm = depth_mm + min(KEY_RIM_MM, math.sqrt(2.0) * KEY_RIM_MM - above_mm)
            rooms.append(self.room.find_solid_area(side, below_mm, KEY_RIM_MM).buffer(-reach_mm - SLACK_MM))
        return shapely.intersection_all(rooms)


@dataclass(slots=True)
class KeyPlacer:
    """Places keys of one diameter for a step, and adds their grooves to the tools of the room.

    Attributes
    ----------
    maker
        Maker of keys for the step.
    sites, glue_mm, pins
        Faces of the step that close along its direction; sample points (n, 3) on all of its glued faces; its
        pins and keys so far.
    taken_mm
        Distance between the two keys or pins of each other step; that of this step differs from each of them
        by at least `distinct_mm`.
    """

    maker: KeyMaker
    sites: Sequence[Site]
    glue_mm: Floats
    pins: list[Pin]
    taken_mm: Sequence[float]
    distinct_mm: float
    _places: dict[float, list[KeyPlace]] = field(default_factory=dict)

    def place_pair(self) -> None:
        """Place a long and a short key as far apart as possible."""
        lengths_mm = self.maker.lengths_mm
        long, short = (self._list_places(length_mm) for length_mm in lengths_mm)
        if not long or not short:
            return
        separations_mm = cdist(*(self._project_places(places) for places in (long, short)))
        separations_mm[~self._is_free(separations_mm)] = 0.0
        separations_mm[separations_mm < NEAREST_MM] = 0.0
        weighted_mm = separations_mm * np.add.outer(self._weigh(long), self._weigh(short)) / 2.0
        for index in np.argsort(-weighted_mm, axis=None, kind="stable")[:MAX_TRIED].tolist():
            first, second = np.unravel_index(index, separations_mm.shape)
            if not separations_mm[first, second]:
                return
            keys = [
                self.maker.make(place, length_mm)
                for place, length_mm in zip((long[first], short[second]), lengths_mm, strict=True)
            ]
            if all(keys):
                self._add(*(key for key in keys if key is not None))
                return

    def place_second_key(self) -> None:
        """Place a short key as far as possible from the only pin; anywhere if there is no pin."""
        places = self._list_places(SHORT_MM)
        if not places:
            return
        if not self.pins:
            self._place_first_of(range(len(places)))
            return
        separations_mm = cdist(self._project_places(places), self._project(self.pins[0].at_mm[None]))[:, 0]
        order = np.argsort(-separations_mm * self._weigh(places), kind="stable")
        self._place_first_of(order[self._is_free(separations_mm[order])].tolist())

    def place_further_keys(self) -> None:
        """Place short keys near the most glue that is far from all pins and keys."""
        count = 0
        while self.pins and len(self.pins) > count:
            count = len(self.pins)
            far_glue = find_far_glue(self.glue_mm, self.pins)
            places = self._list_places(SHORT_MM) if len(far_glue) else []
            if places:
                self._place_first_of(sort_by_gain(_list_points(places), far_glue, self._weigh(places)))

    def place_sliding_keys(self, sites: Sequence[Site]) -> None:
        """Place short keys on faces that slide, near the most glue that is far from all pins and keys."""
        count = -1
        while len(self.pins) > count:
            count = len(self.pins)
            far_glue = find_far_glue(self.glue_mm, self.pins)
            places = self.maker.find_sliding_places(sites, self.sites, SHORT_MM) if len(far_glue) else []
            places = self._list_free(places)
            if places:
                numbers = sort_by_gain(_list_points(places), far_glue, self._weigh(places))
                self._add_first_printable([places[number] for number in numbers])

    def _place_first_of(self, numbers: Sequence[int]) -> None:
        """Place a short key at the first printable one of the places with these numbers."""
        places = self._list_places(SHORT_MM)
        self._add_first_printable([places[number] for number in numbers[:MAX_TRIED]])

    def _add_first_printable(self, places: Sequence[KeyPlace]) -> None:
        """Place a short key at the first of some places where its grooves print without support."""
        for place in places[:MAX_TRIED]:
            key = self.maker.make(place, SHORT_MM)
            if key is not None:
                self._add(key)
                return

    def _add(self, *keys: Pin) -> None:
        self.pins += keys
        self.maker.room.tools += [groove for key in keys for groove in key.holes]

    def _list_places(self, length_mm: float) -> list[KeyPlace]:
        """List the places of a length that are not near a key or pin of the step."""
        if length_mm not in self._places:
            self._places[length_mm] = self.maker.find_places(self.sites, length_mm)
        return self._list_free(self._places[length_mm])

    def _list_free(self, places: Sequence[KeyPlace]) -> list[KeyPlace]:
        return [
            place
            for place in places
            if all(np.linalg.norm(place.at_mm - pin.at_mm) > NEAREST_MM for pin in self.pins)
        ]

    def _weigh(self, places: Sequence[KeyPlace]) -> Floats:
        """Compute the weights (n,) of places by their print time: less for faces that are printed level."""
        is_level = self.maker.room.is_level
        sites = [place.site for place in places]
        return 1.0 - LEVEL_LOSS * np.array([is_level(site.moved) + is_level(site.fixed) for site in sites])

    def _is_free(self, separations_mm: Floats) -> Bools:
        """Check which distances differ enough from those of the pairs of other steps."""
        is_free = np.ones(separations_mm.shape, dtype=np.bool_)
        for taken_mm in self.taken_mm:
            is_free &= np.abs(separations_mm - taken_mm) > self.distinct_mm
        return is_free

    def _project_places(self, places: Sequence[KeyPlace]) -> Floats:
        return self._project(_list_points(places))

    def _project(self, points_mm: Floats) -> Floats:
        direction = self.maker.direction
        return points_mm - np.outer(points_mm @ direction, direction)


def _list_points(places: Sequence[KeyPlace]) -> Floats:
    """List the middles (n, 3) of places."""
    return np.array([place.at_mm for place in places]).reshape(-1, 3)


def _hull(points: Floats) -> shapely.Geometry:
    return shapely.MultiPoint(points).convex_hull


def _list_rim(polygon: shapely.Polygon) -> tuple[Floats, float]:
    """List points (n, 2) along the rims of a polygon; return also the distance between them."""
    rings = [polygon.exterior, *polygon.interiors]
    pitch_mm = max(PITCH_MM, sum(ring.length for ring in rings) / MAX_POINTS)
    points = [shapely.line_interpolate_point(ring, np.arange(0.0, ring.length, pitch_mm)) for ring in rings]
    return np.asarray(shapely.get_coordinates(np.concatenate(points))), pitch_mm
