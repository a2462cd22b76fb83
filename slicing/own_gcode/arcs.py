"""Arcs as straight moves, as the firmware makes them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

LONGEST_MM = 1.0
"""The firmware's ``MM_PER_ARC_SEGMENT``."""
DEVIATION_MM = 0.01

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Arc:
    """Arc from `start` round `centre` to `end`, in mm; a whole circle where start and end are the same."""

    start: Point
    end: Point
    centre: Point
    clockwise: bool

    @property
    def radius_mm(self) -> float:
        return math.dist(self.start, self.centre)

    @property
    def end_radius_mm(self) -> float:
        return math.dist(self.end, self.centre)

    @property
    def turn(self) -> float:
        """Angle swept, in radians; negative clockwise."""
        turn = (self._angle(self.end) - self._angle(self.start)) % math.tau
        if self.clockwise:
            return turn - math.tau
        return turn or math.tau

    @property
    def length_mm(self) -> float:
        return abs(self.turn) * self.radius_mm

    def points(self) -> Iterator[tuple[Point, float]]:
        """Yield the end of each straight move, and the share of the arc done there; `end` is the last."""
        radius_mm, turn, first = self.radius_mm, self.turn, self._angle(self.start)
        step_mm = max(0.05, min(LONGEST_MM, math.sqrt(8 * radius_mm * DEVIATION_MM)))
        count = max(1, math.ceil(self.length_mm / step_mm))
        for i in range(1, count):
            angle = first + turn * i / count
            yield self._at(angle, radius_mm), i / count
        yield self.end, 1.0

    def _angle(self, point: Point) -> float:
        return math.atan2(point[1] - self.centre[1], point[0] - self.centre[0])

    def _at(self, angle: float, radius_mm: float) -> Point:
        return (
            self.centre[0] + radius_mm * math.cos(angle),
            self.centre[1] + radius_mm * math.sin(angle),
        )
