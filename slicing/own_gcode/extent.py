"""Extent of a print: bounding boxes and sums, gathered move by move."""

from __future__ import annotations

import math
from collections import defaultdict

CLIP_HEIGHT_MM = 10.0
"""[assumed] Height below which the head must avoid the bed's clips, even in travel moves."""
MAX_PRIMED_MM = 1.0
"""Maximum filament that slicers extrude at standstill, beyond what was retracted before."""
_NEGLIGIBLE_PRIME_MM = 0.001

Point = list[float]


class Extent:
    """Bounding boxes in the printer's coordinates, and the sums that show whether E counts mm of filament.

    Attributes
    ----------
    low_mm, high_mm
        Corners of the box around all extrusion and, in X and Y, around the moves as low as the bed's clips.
    reach_low_mm, reach_high_mm
        Corners of the box around all moves up to the last one that printed.
    filament_mm
        Filament fed, excluding the return of retracted filament.
    path_mm, line_count
        Length and number of all printed lines.
    """

    def __init__(self) -> None:
        self.low_mm, self.high_mm = [math.inf] * 3, [-math.inf] * 3
        self.reach_low_mm, self.reach_high_mm = [math.inf] * 3, [-math.inf] * 3
        self.filament_mm = 0.0
        self.path_mm = 0.0
        self.line_count = 0
        # Number of returns of retracted filament, and of those that extrude more than was retracted.
        self._return_count = self._prime_count = 0
        self._primed_mm = self._jumped_mm = 0.0
        self._moves: list[Point] = []  # since the last line that was printed
        self._fed_mm = 0.0
        self._layer_z_mm = self._step_mm = 0.0
        self._path_on_step_mm: defaultdict[float, float] = defaultdict(float)

    def record_move(self, target: Point, fed_mm: float) -> None:
        """Record a move, which counts once something is printed after it.

        `fed_mm` is the filament that it extrudes, without the return of retracted filament.
        """
        self._moves.append(target)
        self._fed_mm += max(0.0, fed_mm)

    def record_prime(self, fed_mm: float) -> None:
        """Record that retracted filament, and `fed_mm` more, is extruded at standstill."""
        self._return_count += 1
        if fed_mm > MAX_PRIMED_MM:
            self._jumped_mm += fed_mm
        elif fed_mm > _NEGLIGIBLE_PRIME_MM:
            self._prime_count += 1
            self._primed_mm += fed_mm

    @property
    def stray_filament_mm(self) -> float:
        """Filament extruded at standstill that belongs to missing lines.

        A slicer that primes after retractions does so after most of them; such primes do not count.
        """
        return self._jumped_mm + (self._primed_mm if 2 * self._prime_count < self._return_count else 0.0)

    def is_higher(self, start: Point, target: Point) -> bool:
        """Check whether a printed line lies higher than all before it, but is not the first."""
        return self.path_mm > 0 and start[2] == target[2] > self._layer_z_mm + 0.01

    def record_line(self, start: Point, target: Point) -> None:
        """Record that the last move printed a line."""
        z, path_mm = target[2], math.dist(start, target)
        if start[2] == z != self._layer_z_mm:
            self._step_mm = round(z - self._layer_z_mm, 3) if z > self._layer_z_mm else self._step_mm
            self._layer_z_mm = z
        self._path_on_step_mm[self._step_mm] += path_mm
        self.path_mm += path_mm
        self.line_count += 1
        self.filament_mm += self._fed_mm
        self._fed_mm = 0.0
        for point in self._moves:
            _extend_box(self.reach_low_mm, self.reach_high_mm, point)
            if point[2] < CLIP_HEIGHT_MM:
                _extend_box(self.low_mm, self.high_mm, point[:2])
        self._moves.clear()
        _extend_box(self.low_mm, self.high_mm, start)
        _extend_box(self.low_mm, self.high_mm, target)

    @property
    def layer_height_mm(self) -> float:
        """Median height of a layer in mm, weighted by the length of its path; 0 without layers."""
        sum_mm = 0.0
        for step_mm, path_mm in sorted(self._path_on_step_mm.items()):
            sum_mm += path_mm
            if sum_mm >= self.path_mm / 2:
                return step_mm
        return 0.0


def _extend_box(low: Point, high: Point, point: Point) -> None:
    """Extend a bounding box to contain a point."""
    for axis, value in enumerate(point):
        if value < low[axis]:
            low[axis] = value
        if value > high[axis]:
            high[axis] = value
