"""Shapes of pairs of pins, which differ from step to step, so that a body fits only in its own place.

Two pairs differ by the distance between their pins, or by the angles of their keys, because small parts leave
room for only few distances.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Bools, Floats
from decompose.connectors.records import Pin
from decompose.geometry import choose_plane_axes
from decompose.options import PairShape


@dataclass(frozen=True, slots=True, eq=False)
class PairShapes:
    """Shapes of pairs, seen along the direction of their step; all pairs have pins of the same kinds.

    Attributes
    ----------
    distances_mm
        (n, m) distances between the two pins of each pair.
    angles
        (n, m) angles from the line between the two pins to the first key, and to the second one, in radians
        modulo pi; None for pins in holes.
    lengths_mm
        Lengths of the first and of the second pins.
    """

    distances_mm: Floats
    angles: tuple[Floats | None, Floats | None]
    lengths_mm: tuple[float, float]

    @classmethod
    def from_places(
        cls,
        axis: Floats,
        points_mm: tuple[Floats, Floats],
        key_directions: tuple[Floats | None, Floats | None],
        lengths_mm: tuple[float, float],
    ) -> PairShapes:
        """Measure the shapes of the pairs of each first place and each second one.

        Parameters
        ----------
        axis
            (3,) direction of the step.
        points_mm
            (n, 3) and (m, 3) places of the first and of the second pins.
        key_directions
            (n, 3) and (m, 3) unit vectors along the keys; None for pins in holes.
        lengths_mm
            Lengths of the first and of the second pins.
        """
        across = choose_plane_axes(axis)
        first_mm, second_mm = (points @ across.T for points in points_mm)
        x_mm, y_mm = (second_mm - first_mm[:, None]).transpose(2, 0, 1)
        lines = np.arctan2(y_mm, x_mm)
        first, second = (
            None if directions is None else np.arctan2(*(directions @ across.T).T[::-1])
            for directions in key_directions
        )
        return cls(
            np.hypot(x_mm, y_mm),
            (
                None if first is None else (first[:, None] - lines) % math.pi,
                None if second is None else (second - lines) % math.pi,
            ),
            lengths_mm,
        )

    def find_alike(self, other: PairShape, max_difference_mm: float) -> Bools:
        """Find the pairs that are like another one, or like what is seen of it from the other side.

        Parameters
        ----------
        other
            Shape of one pair.
        max_difference_mm
            Distances that differ by no more are alike, and angles at which the ends of the shorter key are no
            farther beside the other one.

        Returns
        -------
        Bools
            (n, m) true for each pair that is alike.
        """
        is_alike = np.zeros(self.distances_mm.shape, np.bool_)
        if [angle is None for angle in self.angles] != [angle is None for angle in other.angles]:
            return is_alike
        near = np.nonzero(np.abs(self.distances_mm - other.distance_mm) <= max_difference_mm)
        for sign in (1.0, -1.0):
            is_turned_alike = np.ones(len(near[0]), np.bool_)
            for angles, other_angle, *lengths_mm in zip(
                self.angles, other.angles, self.lengths_mm, other.lengths_mm, strict=True
            ):
                if angles is not None and other_angle is not None:
                    sines = np.abs(np.sin(angles[near] - sign * other_angle))
                    is_turned_alike &= min(lengths_mm) / 2.0 * sines <= max_difference_mm
            is_alike[near] |= is_turned_alike
        return is_alike


def measure_pair(first: Pin, second: Pin) -> PairShape:
    """Measure the shape of a pair."""
    return measure_shape(
        first.axis,
        (first.position_mm, second.position_mm),
        (first.key_direction, second.key_direction),
        (first.length_mm, second.length_mm),
    )


def measure_shape(
    axis: Floats,
    points_mm: tuple[Floats, Floats],
    key_directions: tuple[Floats | None, Floats | None],
    lengths_mm: tuple[float, float],
) -> PairShape:
    """Measure the shape of a pair at two places (3,); see `PairShapes.from_places`."""
    first, second = (None if direction is None else direction[None] for direction in key_directions)
    shapes = PairShapes.from_places(
        axis, (points_mm[0][None], points_mm[1][None]), (first, second), lengths_mm
    )
    angles = [None if values is None else float(values[0, 0]) for values in shapes.angles]
    return PairShape(float(shapes.distances_mm[0, 0]), (angles[0], angles[1]), lengths_mm)


def find_free_pairs(shapes: PairShapes, used_shapes: Sequence[PairShape], min_difference_mm: float) -> Bools:
    """Find the pairs (n, m) that are unlike all used ones; distances are alike within `min_difference_mm`."""
    is_free = np.ones(shapes.distances_mm.shape, np.bool_)
    for used_shape in used_shapes:
        is_free &= ~shapes.find_alike(used_shape, min_difference_mm)
    return is_free
