"""Placer of keys: chooses places for the keys of an assembly step, spread over the glued area of the step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.distance import cdist

from decompose.arrays import Floats
from decompose.connectors.coverage import Site, find_unreached_glue, sort_places_by_gain
from decompose.connectors.keys.places import KeyMaker, KeyPlace
from decompose.connectors.pair_shapes import PairShapes, find_free_pairs
from decompose.connectors.records import Pin
from decompose.options import PairShape

MIN_SEPARATION_MM = 12.0  # minimum distance between two keys, or between a key and a pin
MIN_CLOSE_SEPARATION_MM = 7.0  # minimum distance between two keys that have no space farther apart
MAX_CLOSE_PLACES = 6  # maximum number of places of the long key of such a pair
# Reduction of a place's weight for each level face: a groove in it takes several times longer to print.
LEVEL_PENALTY = 0.1
MAX_TRIED_PLACES = 20  # maximum number of places that are tried, the best first


@dataclass(slots=True)
class KeyPlacer:
    """Placer of keys of one diameter for an assembly step; adds the grooves of the keys to the workpieces.

    Attributes
    ----------
    maker
        Maker of keys for the step.
    sites
        Joint faces that meet only at the end of the step's movement, unlike those that slide over each other.
    glue_points_mm
        (n, 3) sample points on all glued faces of the step.
    pins
        Pins and keys of the step so far; new keys are added.
    used_shapes, min_difference_mm
        Shapes of the pairs of earlier steps and of existing parts (`ConnectorOptions.used_shapes`). A new
        pair is unlike each of them (`PairShapes.find_alike`).
    """

    maker: KeyMaker
    sites: Sequence[Site]
    glue_points_mm: Floats
    pins: list[Pin]
    used_shapes: Sequence[PairShape]
    min_difference_mm: float
    _places: dict[float, list[KeyPlace]] = field(default_factory=dict)

    def place_pair(self) -> None:
        """Place a long and a short key as far apart as possible."""
        lengths_mm = self.maker.lengths_mm
        long_places, short_places = (self._list_places(length_mm) for length_mm in lengths_mm)
        if not long_places or not short_places:
            return
        shapes = PairShapes.from_places(
            self.maker.direction,
            (_list_middles(long_places), _list_middles(short_places)),
            (_list_directions(long_places), _list_directions(short_places)),
            lengths_mm,
        )
        is_free = find_free_pairs(shapes, self.used_shapes, self.min_difference_mm)
        separations_mm = np.where(is_free, shapes.distances_mm, 0.0)
        separations_mm[separations_mm < MIN_SEPARATION_MM] = 0.0
        weighted_mm = (
            separations_mm
            * np.add.outer(self._weigh_places(long_places), self._weigh_places(short_places))
            / 2.0
        )
        for index in _find_largest(weighted_mm.ravel(), MAX_TRIED_PLACES):
            first, second = np.unravel_index(index, separations_mm.shape)
            if not separations_mm[first, second]:
                return
            keys = [
                self.maker.make_key(place, length_mm)
                for place, length_mm in zip(
                    (long_places[first], short_places[second]), lengths_mm, strict=True
                )
            ]
            if all(keys):
                self._add_keys(*(key for key in keys if key is not None))
                return

    def place_close_pair(self) -> None:
        """Place a long and a short key at less than the usual distance, the long one near the border.

        The places of the short key are found anew, beside the grooves of the long one.
        """
        long_mm, short_mm = self.maker.lengths_mm
        workpieces = self.maker.workpieces
        places = self._list_places(long_mm)
        for place in self._sort_from_border(places, long_mm)[:MAX_CLOSE_PLACES] if places else ():
            long_key = self.maker.make_key(place, long_mm)
            if long_key is None:
                continue
            workpieces.add_tools(long_key.holes)
            short_places = self.maker.find_places(self.sites, short_mm)
            shapes = PairShapes.from_places(
                self.maker.direction,
                (place.middle_mm[None], _list_middles(short_places)),
                (place.direction[None], _list_directions(short_places)),
                (long_mm, short_mm),
            )
            is_free = find_free_pairs(shapes, self.used_shapes, self.min_difference_mm)[0]
            separations_mm = np.where(is_free, shapes.distances_mm[0], 0.0)
            for index in _find_largest(separations_mm, MAX_TRIED_PLACES):
                if separations_mm[index] < MIN_CLOSE_SEPARATION_MM:
                    break
                short_key = self.maker.make_key(short_places[index], short_mm)
                if short_key is not None:
                    workpieces.add_tools(short_key.holes)
                    self.pins += [long_key, short_key]
                    return
            workpieces.remove_tools(long_key.holes)

    def place_second_key(self) -> None:
        """Place a short key as far as possible from the only pin, or anywhere if there is no pin."""
        places = self._list_places(self.maker.short_mm)
        if not places:
            return
        if not self.pins:
            self._place_key(range(len(places)))
            return
        pin = self.pins[0]
        shapes = PairShapes.from_places(
            self.maker.direction,
            (pin.position_mm[None], _list_middles(places)),
            (None if pin.key_direction is None else pin.key_direction[None], _list_directions(places)),
            (pin.length_mm, self.maker.short_mm),
        )
        is_free = find_free_pairs(shapes, self.used_shapes, self.min_difference_mm)[0]
        order = np.argsort(-shapes.distances_mm[0] * self._weigh_places(places), kind="stable")
        self._place_key(order[is_free[order]].tolist())

    def place_further_keys(self) -> None:
        """Place short keys that reach as much as possible of the area that none reaches yet (`coverage`)."""
        count = 0
        while self.pins and len(self.pins) > count:
            count = len(self.pins)
            unreached_points_mm = find_unreached_glue(self.glue_points_mm, self.pins)
            places = self._list_places(self.maker.short_mm) if len(unreached_points_mm) else []
            if places:
                self._place_key(
                    sort_places_by_gain(
                        _list_middles(places), unreached_points_mm, self._weigh_places(places)
                    )
                )

    def place_sliding_keys(self, sites: Sequence[Site]) -> None:
        """Place short keys on faces that slide, to reach the area that no pin or key reaches yet."""
        count = -1
        while len(self.pins) > count:
            count = len(self.pins)
            unreached_points_mm = find_unreached_glue(self.glue_points_mm, self.pins)
            places = (
                self.maker.find_sliding_places(sites, self.sites, self.maker.short_mm)
                if len(unreached_points_mm)
                else []
            )
            places = self._list_free_places(places)
            if places:
                indices = sort_places_by_gain(
                    _list_middles(places), unreached_points_mm, self._weigh_places(places)
                )
                self._add_printable_key([places[index] for index in indices])

    def _sort_from_border(self, places: Sequence[KeyPlace], length_mm: float) -> list[KeyPlace]:
        """Sort places by the distance of a key's inner end from the middle of the glue, farthest first."""
        offsets_mm = _list_middles(places) - self.glue_points_mm.mean(axis=0)
        radii_mm = np.linalg.norm(offsets_mm, axis=1)
        radial_mm = np.abs((offsets_mm * _list_directions(places)).sum(axis=1)) / radii_mm.clip(1e-6)
        order = np.argsort(radial_mm * length_mm / 2.0 - radii_mm, kind="stable")
        return [places[index] for index in order.tolist()]

    def _place_key(self, indices: Sequence[int]) -> None:
        """Place a short key at the first printable place with one of these indices."""
        places = self._list_places(self.maker.short_mm)
        self._add_printable_key([places[index] for index in indices[:MAX_TRIED_PLACES]])

    def _add_printable_key(self, places: Sequence[KeyPlace]) -> None:
        """Place a short key at the first of these places at which its grooves print without support."""
        for place in places[:MAX_TRIED_PLACES]:
            key = self.maker.make_key(place, self.maker.short_mm)
            if key is not None:
                self._add_keys(key)
                return

    def _add_keys(self, *keys: Pin) -> None:
        """Add keys to the step, and their grooves to the workpieces."""
        self.pins += keys
        self.maker.workpieces.add_tools(groove for key in keys for groove in key.holes)

    def _list_places(self, length_mm: float) -> list[KeyPlace]:
        """List the places for keys of this length that are not near a key or pin of the step."""
        if length_mm not in self._places:
            self._places[length_mm] = self.maker.find_places(self.sites, length_mm)
        return self._list_free_places(self._places[length_mm])

    def _list_free_places(self, places: Sequence[KeyPlace]) -> list[KeyPlace]:
        """List the places that are not near a key or pin of the step."""
        if not self.pins:
            return list(places)
        distances_mm = cdist(_list_middles(places), [pin.position_mm for pin in self.pins])
        is_free = (distances_mm > MIN_SEPARATION_MM).all(axis=1)
        return [places[index] for index in np.flatnonzero(is_free).tolist()]

    def _weigh_places(self, places: Sequence[KeyPlace]) -> Floats:
        """Compute the weights (n,) of places; level faces lower the weight, because they print slowly."""
        is_level = self.maker.workpieces.is_level
        sites = {id(place.site): place.site for place in places}
        level_counts = {
            key: is_level(site.moved_side) + is_level(site.fixed_side) for key, site in sites.items()
        }
        return 1.0 - LEVEL_PENALTY * np.array([level_counts[id(place.site)] for place in places])


def _find_largest(values: Floats, count: int) -> list[int]:
    """Find the indices of the largest values (n,), the largest first; equal values keep their order."""
    least = np.partition(values, -count)[-count] if count < len(values) else -np.inf
    candidates = np.flatnonzero(values >= least)
    order = np.argsort(-values[candidates], kind="stable")
    return [int(index) for index in candidates[order[:count]]]


def _list_middles(places: Sequence[KeyPlace]) -> Floats:
    """List the middles (n, 3) of places."""
    return np.array([place.middle_mm for place in places]).reshape(-1, 3)


def _list_directions(places: Sequence[KeyPlace]) -> Floats:
    """List the directions (n, 3) of the keys at places."""
    return np.array([place.direction for place in places]).reshape(-1, 3)
