"""Usable build volumes of a printer for one part, and the placement of the part. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

from drivers.printers.profile import Profile, Rect


@dataclass(frozen=True, slots=True)
class UsableVolume:
    """A box that a part may fill: a rectangle of the bed and a height, in mm."""

    rect: Rect
    height_mm: float

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Width, depth and height in mm."""
        return (self.rect.width_mm, self.rect.depth_mm, self.height_mm)


def list_usable_volumes(
    profile: Profile, brim_mm: float, volume_mm: tuple[float, float, float] | None = None
) -> tuple[UsableVolume, ...]:
    """List the boxes that a part with a brim may fill on this printer.

    A part fits on the printer if it fits in one of these boxes. Their rectangles are the largest ones that
    remain on the bed and clear of the clips when the brim is added; their height is the printer's.

    Parameters
    ----------
    profile
        The printer model.
    brim_mm
        Width of the brim (or skirt) that is printed around the part.
    volume_mm
        User's limit (x, y, z) for this printer in mm; on each axis, the smaller of limit and printer size
        applies.

    Returns
    -------
    tuple of UsableVolume
        Sorted by volume, largest first; empty if the brim leaves no space for a part.
    """
    sizes_mm = (*profile.bed_mm, profile.height_mm)
    if volume_mm is not None:
        sizes_mm = (
            min(sizes_mm[0], volume_mm[0]),
            min(sizes_mm[1], volume_mm[1]),
            min(sizes_mm[2], volume_mm[2]),
        )
    width_mm, depth_mm, height_mm = sizes_mm
    bed = Rect(-width_mm / 2, -depth_mm / 2, width_mm / 2, depth_mm / 2).expand(-brim_mm)
    clips = [clip.expand(brim_mm) for clip in profile.clips]
    xs_mm = sorted({bed.min_x_mm, bed.max_x_mm, *(x for c in clips for x in (c.min_x_mm, c.max_x_mm))})
    ys_mm = sorted({bed.min_y_mm, bed.max_y_mm, *(y for c in clips for y in (c.min_y_mm, c.max_y_mm))})
    free_rects = [
        rect
        for x0, x1 in combinations(xs_mm, 2)
        for y0, y1 in combinations(ys_mm, 2)
        if bed.contains(rect := Rect(x0, y0, x1, y1)) and not any(rect.overlaps(clip) for clip in clips)
    ]
    largest_rects = [r for r in free_rects if not any(o is not r and o.contains(r) for o in free_rects)]
    largest_rects.sort(key=lambda r: r.width_mm * r.depth_mm, reverse=True)
    return tuple(UsableVolume(rect, height_mm) for rect in largest_rects)


FIT_TOLERANCE_MM = 1e-3
"""Tolerance for STL files, whose single precision may enlarge an exactly fitting part slightly."""


@dataclass(frozen=True, slots=True)
class Placement:
    """Position of the centre of a part's bounding box on the bed, and rotation of the part.

    `is_rotated` is true if the part is rotated by 90 degrees about Z.
    """

    x_mm: float
    y_mm: float
    is_rotated: bool


def place_part(extents_mm: tuple[float, float, float], volumes: tuple[UsableVolume, ...]) -> Placement | None:
    """Place a part near the bed's centre.

    Parameters
    ----------
    extents_mm
        Size (x, y, z) of the part's bounding box, in mm.
    volumes
        Boxes that the part may fill; see `list_usable_volumes`.

    Returns
    -------
    Placement or None
        The placement nearest to the bed's centre; None if the part does not fit.
    """
    best_key: tuple[float, bool, float, float] | None = None
    for box in volumes:
        for is_rotated in (False, True):
            dx_mm, dy_mm = (extents_mm[1], extents_mm[0]) if is_rotated else (extents_mm[0], extents_mm[1])
            tolerance_mm = FIT_TOLERANCE_MM
            if dx_mm > box.rect.width_mm + tolerance_mm or dy_mm > box.rect.depth_mm + tolerance_mm:
                continue
            if extents_mm[2] > box.height_mm + tolerance_mm:
                continue
            x_mm = min(max(0.0, box.rect.min_x_mm + dx_mm / 2), box.rect.max_x_mm - dx_mm / 2)
            y_mm = min(max(0.0, box.rect.min_y_mm + dy_mm / 2), box.rect.max_y_mm - dy_mm / 2)
            key = (math.hypot(x_mm, y_mm), is_rotated, x_mm, y_mm)
            if best_key is None or key < best_key:
                best_key = key
    return None if best_key is None else Placement(best_key[2], best_key[3], best_key[1])
