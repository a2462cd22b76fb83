"""Adhesion of a part to the bed: its first layer, the brim that it needs, and its elephant's foot."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats
from decompose.geometry import find_convex_outline, find_half_planes
from decompose.jit import jit

FIRST_LAYER_MIDDLE_MM = 0.15  # height of the middle of the first layer, at which the mesh is cut
MAX_SHARP_DEG = 120.0  # maximum angle of a sharp corner
MAX_ROUNDING_MM = 1.0  # maximum size of a chamfer or a rounding that counts as one corner

# [assumed] Limits that decide the width of a brim.
MAX_STEADY_RATIO = 3.0  # maximum ratio of a part's height to `hydraulic_diameter_mm` without a brim
SUFFICIENT_CONTACT_MM2 = 400.0  # from this contact area on, no brim is needed for adhesion
# Minimum length of a base whose corners lift, and minimum length of one that needs the widest brim.
WARP_LENGTHS_MM = (60.0, 120.0)
REFERENCE_SHRINKAGE = 0.007
"""Shrinkage (of ABS) to which `WARP_LENGTHS_MM` applies. The lift of a corner is proportional to the
shrinkage and to the square of the length."""
MIN_BRIM_MM = 2.0  # a narrower brim is omitted

# [assumed] The first layer is pressed on the bed, and so grows by this width on each side. If its hydraulic
# diameter is at least this minimum, a negative expansion compensates for the growth.
ELEPHANT_FOOT_MM = 0.2
MIN_HYDRAULIC_DIAMETER_MM = 2.0


@dataclass(frozen=True, slots=True)
class Footing:
    """Contact of a part with the bed.

    Attributes
    ----------
    contact_mm2, hydraulic_diameter_mm
        Area of the first layer, and its hydraulic diameter: four times the area divided by the outline's
        length. For a disc, this is the diameter; for a long wall, it is twice the width.
    length_mm, sharp_corner_count
        Greatest extent of the convex outline of the first layer, and the number of corners of this outline
        with an angle below `MAX_SHARP_DEG`.
    width_mm, half_planes
        Least extent of the footing's outline, and this outline as (q, 3) half-planes; none if it has no area.
        The outline is convex, around the first layer and the supports on the bed. A point p (in mm) is inside
        if ``half_planes[:, :2] @ p + half_planes[:, 2] <= 0``.
    """

    contact_mm2: float
    hydraulic_diameter_mm: float
    length_mm: float
    sharp_corner_count: int
    width_mm: float
    half_planes: Floats

    @classmethod
    def from_mesh(cls, triangles: Floats, bed_support_border_mm: Floats) -> Footing:
        """Measure the footing of a closed mesh and of its supports.

        Parameters
        ----------
        triangles
            (m, 3, 3) in mm, facing outward, standing on z = 0.
        bed_support_border_mm
            (p, 2) points on the border of the supports on the bed.
        """
        contact_mm2, outline_length_mm, points = _measure_first_layer(triangles)
        base_outline = find_convex_outline(points)
        length_mm, sharp_corner_count = _measure_base(base_outline)
        outline = (
            find_convex_outline(np.concatenate([base_outline, bed_support_border_mm]))
            if len(bed_support_border_mm)
            else base_outline
        )
        half_planes = find_half_planes(outline)
        return cls(
            contact_mm2=contact_mm2,
            hydraulic_diameter_mm=4.0 * contact_mm2 / outline_length_mm if outline_length_mm > 0.0 else 0.0,
            length_mm=length_mm,
            sharp_corner_count=sharp_corner_count,
            width_mm=_measure_width_mm(outline, half_planes),
            half_planes=half_planes,
        )

    def measure_margins_mm(self, points: Floats) -> list[float]:
        """Measure how far inside the footing's outline each of points (n, 2) is; below 0 outside."""
        margins_mm: list[float] = _measure_margins_mm(self.half_planes, points).tolist()
        return margins_mm

    def choose_brim_width_mm(
        self, height_mm: float, margin_mm: float, max_brim_mm: float, shrinkage: float = REFERENCE_SHRINKAGE
    ) -> float:
        """Choose the width of a part's brim, from 0 to the maximum.

        A part that is tall for its base, or whose centre of mass is not above the base (`margin_mm`), gets a
        brim that widens the base. A small contact area needs a brim for adhesion. A long base curls up at its
        corners, but less at blunt corners and with a material that shrinks less.

        Parameters
        ----------
        height_mm
            Height of the part.
        margin_mm
            Distance of the part's centre of mass from the edge of the footing; negative outside.
        max_brim_mm
            Maximum width of a brim.
        shrinkage
            Share of the length by which the material shrinks.
        """
        lever_mm = (height_mm / MAX_STEADY_RATIO - self.hydraulic_diameter_mm) / 2.0
        contact_mm = max_brim_mm * (1.0 - self.contact_mm2 / SUFFICIENT_CONTACT_MM2)
        length_ratio = math.sqrt(REFERENCE_SHRINKAGE / max(shrinkage, 1e-4))
        first_mm, full_mm = (length_ratio * length_mm for length_mm in WARP_LENGTHS_MM)
        warp_mm = max_brim_mm * (self.length_mm - first_mm) / (full_mm - first_mm)
        offset_mm = max_brim_mm if margin_mm < 0.0 else 0.0
        width_mm = max(lever_mm, contact_mm, offset_mm, warp_mm if self.sharp_corner_count else warp_mm / 2.0)
        return 0.0 if width_mm < MIN_BRIM_MM else math.floor(10.0 * min(width_mm, max_brim_mm)) / 10.0

    def choose_expansion_mm(self, is_joined: bool) -> float:
        """Choose the horizontal expansion of the first layer: negative if cut faces begin in it.

        It would otherwise protrude at a joint.
        """
        is_wide = self.hydraulic_diameter_mm >= MIN_HYDRAULIC_DIAMETER_MM
        return -ELEPHANT_FOOT_MM if is_joined and is_wide else 0.0


@jit
def _measure_base(outline: Floats) -> tuple[float, int]:
    """Measure the greatest extent of a convex outline, and count its sharp corners.

    Parameters
    ----------
    outline
        (k, 2) float64 in mm, from `find_convex_outline`.

    Returns
    -------
    tuple
        Length in mm, and number of corners with an angle below `MAX_SHARP_DEG`; sides up to
        `MAX_ROUNDING_MM` belong to a corner.
    """
    length_mm, side_count = 0.0, 0
    directions_rad = np.zeros(len(outline))
    for i in range(len(outline)):
        for k in range(i):
            length_mm = max(length_mm, np.hypot(outline[i, 0] - outline[k, 0], outline[i, 1] - outline[k, 1]))
        end = (i + 1) % len(outline)
        x, y = outline[end, 0] - outline[i, 0], outline[end, 1] - outline[i, 1]
        if np.hypot(x, y) > MAX_ROUNDING_MM:
            directions_rad[side_count] = np.arctan2(y, x)
            side_count += 1
    sharp_corner_count = 0
    for side in range(side_count):
        bend_rad = directions_rad[(side + 1) % side_count] - directions_rad[side]
        bend_rad = (bend_rad + np.pi) % (2.0 * np.pi) - np.pi
        sharp_corner_count += bend_rad > np.radians(180.0 - MAX_SHARP_DEG)
    return length_mm, sharp_corner_count


@jit
def _measure_width_mm(outline: Floats, half_planes: Floats) -> float:
    """Measure the least extent of a convex outline.

    Parameters
    ----------
    outline, half_planes
        (k, 2) float64 in mm, and (k, 3) float64 from `find_half_planes`; both may be empty.

    Returns
    -------
    float
        Width in mm; 0 for an empty outline.
    """
    width_mm = np.inf if len(half_planes) else 0.0
    for side in range(len(half_planes)):
        low_mm, high_mm = np.inf, -np.inf
        for corner in range(len(outline)):
            along_mm = outline[corner, 0] * half_planes[side, 0] + outline[corner, 1] * half_planes[side, 1]
            low_mm, high_mm = min(low_mm, along_mm), max(high_mm, along_mm)
        width_mm = min(width_mm, high_mm - low_mm)
    return width_mm


@jit
def _measure_margins_mm(half_planes: Floats, points: Floats) -> Floats:
    """Measure how far each point is inside half-planes.

    Parameters
    ----------
    half_planes
        (q, 3) float64 from `find_half_planes`; may be empty.
    points
        (n, 2) float64 in mm.

    Returns
    -------
    ndarray
        (n,) float64 in mm, below 0 outside; -inf without half-planes.
    """
    margins_mm = np.full(len(points), np.inf if len(half_planes) else -np.inf)
    for i in range(len(points)):
        for side in range(len(half_planes)):
            nx, ny, offset_mm = half_planes[side]
            margins_mm[i] = min(margins_mm[i], -(nx * points[i, 0] + ny * points[i, 1] + offset_mm))
    return margins_mm


@jit
def _measure_first_layer(triangles: Floats) -> tuple[float, float, Floats]:
    """Measure the first layer of a mesh.

    By the divergence theorem, the area of a cross-section is the area of the downward faces below it minus
    that of the upward faces below it, all as seen from above.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm, facing outward, standing on z = 0.

    Returns
    -------
    tuple
        Area in mm2, length of the outline in mm, and (n, 2) float64 points in mm that span the layer.
    """
    area_mm2, outline_length_mm, count = 0.0, 0.0, 0
    points = np.zeros((4 * _count_low_triangles(triangles), 2))
    ends = np.zeros((2, 2))
    for t in range(len(triangles)):
        low_corner_count = 0
        for corner in range(3):
            if triangles[t, corner, 2] < FIRST_LAYER_MIDDLE_MM:
                low_corner_count += 1
                points[count] = triangles[t, corner, :2]
                count += 1
        if low_corner_count == 0:
            continue
        a, b, c = triangles[t]
        down_mm2 = ((b[1] - a[1]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[1] - a[1])) / 2.0
        if low_corner_count == 3:
            area_mm2 += down_mm2
            continue
        share = _cut_triangle(triangles[t], low_corner_count == 1, ends)
        area_mm2 += down_mm2 * (share if low_corner_count == 1 else 1.0 - share)
        outline_length_mm += np.hypot(ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1])
        points[count : count + 2] = ends
        count += 2
    return max(0.0, area_mm2), outline_length_mm, points[:count].copy()


@jit
def _count_low_triangles(triangles: Floats) -> int:
    """Count the triangles that reach below the middle of the first layer.

    Parameters
    ----------
    triangles
        (m, 3, 3) float64 in mm, standing on z = 0.
    """
    count = 0
    for t in range(len(triangles)):
        if min(triangles[t, 0, 2], triangles[t, 1, 2], triangles[t, 2, 2]) < FIRST_LAYER_MIDDLE_MM:
            count += 1
    return count


@jit
def _cut_triangle(triangle: Floats, is_apex_below: bool, ends: Floats) -> float:
    """Cut a triangle at the middle of the first layer, so that a single corner (the apex) is on one side.

    Parameters
    ----------
    triangle
        (3, 3) float64 in mm.
    is_apex_below
        Whether the apex is below the cut.
    ends
        (2, 2) float64, filled in with the ends of the cut in mm.

    Returns
    -------
    float
        Share of the triangle's area on the side of the apex.
    """
    apex = 0
    for corner in range(3):
        if (triangle[corner, 2] < FIRST_LAYER_MIDDLE_MM) == is_apex_below:
            apex = corner
    product = 1.0
    for k in range(2):
        other = (apex + 1 + k) % 3
        share = (FIRST_LAYER_MIDDLE_MM - triangle[apex, 2]) / (triangle[other, 2] - triangle[apex, 2])
        product *= share
        for axis in range(2):
            ends[k, axis] = triangle[apex, axis] + share * (triangle[other, axis] - triangle[apex, axis])
    return product
