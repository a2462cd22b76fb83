"""Regions of a solid, out of which boxes are cut faster than out of the whole solid."""

from __future__ import annotations

import numpy as np

from decompose.arrays import Floats
from decompose.geometry.solid import Solid

# Number of regions along each axis: each is half as long as the solid, and half of it overlaps the next one.
REGION_COUNT = 3
MIN_DISTANCE_MM = 0.01  # minimum distance of a box from the planes at which its region is cut
OUTSIDE_MM = 1.0  # distance from the solid at which the outer regions end
_WHOLE = -1  # number of the region that is as long as the solid

RegionKey = tuple[int, int, int]


class SolidRegions:
    """Regions of a solid that overlap; each is cut out when it is first needed, and kept.

    The time to cut a box out of a solid grows with the number of triangles of the solid.

    Parameters
    ----------
    solid
        Solid to cut; it is not changed.

    Attributes
    ----------
    cut_face_count
        Number of triangles of the solid, times the number of regions that have been cut out of it.
    """

    def __init__(self, solid: Solid) -> None:
        self._solid = solid
        self._regions: dict[RegionKey, Solid] = {}
        low_mm, high_mm = solid.bounds_mm
        step_mm = (high_mm - low_mm) / (REGION_COUNT + 1)
        starts_mm = low_mm + np.arange(REGION_COUNT)[:, None] * step_mm
        self._bounds_mm = np.stack([starts_mm, starts_mm + 2.0 * step_mm], axis=1)  # (regions, 2, 3)
        self._bounds_mm[0, 0], self._bounds_mm[-1, 1] = low_mm - OUTSIDE_MM, high_mm + OUTSIDE_MM
        self._whole_bounds_mm = np.array([low_mm - OUTSIDE_MM, high_mm + OUTSIDE_MM])
        self.cut_face_count = 0

    def find_region(self, box_mm: Floats) -> Solid:
        """Find a region that contains all of the solid in a box.

        Parameters
        ----------
        box_mm
            (2, 3) corners of the box in mm.

        Returns
        -------
        Solid
            A box cut out of it has the same shape as one that is cut out of the whole solid.
        """
        inside_mm = np.clip(box_mm, self._whole_bounds_mm[0], self._whole_bounds_mm[1])
        numbers = [self._find_number(axis, *inside_mm[:, axis]) for axis in range(3)]
        key = (numbers[0], numbers[1], numbers[2])
        if all(number == _WHOLE for number in key):
            return self._solid
        if key not in self._regions:
            bounds_mm = [
                self._whole_bounds_mm[:, axis] if number == _WHOLE else self._bounds_mm[number, :, axis]
                for axis, number in enumerate(key)
            ]
            self._regions[key] = self._solid.clip(*np.transpose(bounds_mm))
            self.cut_face_count += self._solid.face_count
        return self._regions[key]

    def _find_number(self, axis: int, low_mm: float, high_mm: float) -> int:
        """Find the number of the first region along an axis that contains an interval."""
        for number, (start_mm, end_mm) in enumerate(self._bounds_mm[:, :, axis]):
            starts_inside = number == 0 or low_mm >= start_mm + MIN_DISTANCE_MM
            ends_inside = number == REGION_COUNT - 1 or high_mm <= end_mm - MIN_DISTANCE_MM
            if starts_inside and ends_inside:
                return number
        return _WHOLE
