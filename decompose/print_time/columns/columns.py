"""Upright columns of a part, which show where its supports are and how its mass grows while it is printed.

A support ends on the first face below it, which often belongs to the part itself; sums over faces do not show
this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Bools, Floats
from decompose.geometry.rays import find_bounds, place_rays
from decompose.jit import jit
from decompose.print_time.columns.brim import count_brim_columns
from decompose.print_time.columns.sweep import MIN_STEP_MM, sum_steps_mm, sweep_columns, sweep_supports

COLUMN_COUNT = 12_000  # approximate number of columns; support volumes have errors of 1 to 2 %
# Maximum distance between these columns, for which there may be more of them: with 4 mm instead of 2 mm, the
# narrow supports of a model that is larger than a bed have a quarter less area on their sides.
MAX_STEP_MM = 2.0
MAX_COLUMN_COUNT = 60_000  # maximum number of columns, approximately: those of a bed of 490 x 490 mm
# The closer the columns, the more of the uneven sides of supports they show. With 0.5 mm instead of 2 mm, the
# area of these sides in five large models is 0 to 75 % larger, on average 36 %.
SIDE_STEP_MM = 0.7  # sides are priced as if columns were at this distance, which is usual for parts
SIDE_EXPONENT = 0.25  # the area grows with the inverse of the distance, raised to this power


@dataclass(frozen=True, slots=True)
class Columns:
    """Supports, mass and islands of a part in its printing pose.

    An island is a connected region of a layer, of the part or of its support; a body is an island of the
    part. Their numbers are found at a few heights, and integrated over the height of the part.

    Attributes
    ----------
    support_mm3
        Volume below faces that overhang too far, down to the bed or to the part.
    support_side_mm2
        Area of the upright sides of this support, counted along the columns' grid. The slicer also places
        narrow strips of support below edges in mid-air at which the faces need no support themselves; the
        sides of these strips are included.
    towers_mm
        Total height of all support towers. A tower stands below a tip in mid-air at which the faces need no
        support themselves.
    islands_mm
        Integral of the number of islands minus one. The nozzle has to travel to each island.
    bodies_mm
        Integral of the number of bodies minus one. In each body, inner walls are shorter than the outline.
    holes_mm
        Integral of the number of holes of the part.
    island_paths_mm2
        Integral of the length of the travel between islands in a layer.
    first_layer
        (nx, ny) bool, true where the part or its support stands on the bed.
    step_mm
        Distance between columns.
    bed_support_mm2, bed_support_border_mm
        Area, as seen from above, of the support that stands on the bed and carries the part, and (p, 2)
        points on the border of that area: both ends of each row of columns.
    touched_mm2
        Area, as seen from above, of the faces in the mask `is_marked` that support touches at its upper or
        lower end.
    volumes_mm3, centres_mm
        (LEVEL_COUNT,) volume and (LEVEL_COUNT, 3) centre of mass of the part below each of LEVEL_COUNT evenly
        spaced heights; the last row is for the whole part.
    """

    support_mm3: float
    support_side_mm2: float
    towers_mm: float
    islands_mm: float
    bodies_mm: float
    holes_mm: float
    island_paths_mm2: float
    first_layer: Bools
    step_mm: float
    bed_support_mm2: float
    bed_support_border_mm: Floats
    touched_mm2: float
    volumes_mm3: Floats
    centres_mm: Floats

    @property
    def fine_support_side_mm2(self) -> float:
        """Area of the sides of the support that columns at a distance of `SIDE_STEP_MM` would show."""
        return _compute_fine_side_ratio(self.step_mm) * self.support_side_mm2

    def measure_brim_mm2(self, width_mm: float) -> float:
        """Measure the area of a brim around everything that stands on the bed; holes get no brim."""
        if width_mm <= 0.0:
            return 0.0
        is_standing = np.pad(self.first_layer, math.ceil(width_mm / self.step_mm) + 1)
        return count_brim_columns(is_standing, width_mm, self.step_mm) * self.step_mm**2


def measure_columns(triangles: Floats, is_marked: Bools, overhang_cos: float) -> Columns:
    """Cut a closed mesh into upright columns and measure its supports, mass and islands.

    Parameters
    ----------
    triangles
        (m, 3, 3) in mm, facing outward, standing on z = 0.
    is_marked
        (m,) bool, true for faces to which no support should stick.
    overhang_cos
        Downward component of a face's unit normal above which the face gets support.
    """
    triangles = np.ascontiguousarray(triangles)
    lo_mm, hi_mm = find_bounds(triangles)
    rays = place_rays(lo_mm, hi_mm, _choose_step_mm(lo_mm, hi_mm))
    height_mm = float(hi_mm[2] - lo_mm[2])
    sums = sweep_columns(triangles, is_marked.astype(np.float64), rays, height_mm, overhang_cos)
    supports, mass = sums.supports, np.maximum(sums.level_moments[:, 3:], 1e-12)
    area_mm2 = rays.step_mm**2
    return Columns(
        support_mm3=float(supports.supports_mm.sum() * area_mm2),
        support_side_mm2=sum_steps_mm(supports.supports_mm) * rays.step_mm + supports.strip_sides_mm2,
        towers_mm=supports.towers_mm,
        islands_mm=sums.islands_mm,
        bodies_mm=sums.bodies_mm,
        holes_mm=sums.holes_mm,
        island_paths_mm2=sums.island_paths_mm2,
        first_layer=sums.is_standing | supports.is_bed_support,
        step_mm=rays.step_mm,
        bed_support_mm2=float(supports.is_bed_support.sum() * area_mm2),
        bed_support_border_mm=rays.origin_mm + rays.step_mm * _find_row_ends(supports.is_bed_support),
        touched_mm2=float(supports.touched_count * area_mm2),
        volumes_mm3=sums.level_moments[:, 3] * area_mm2,
        centres_mm=sums.level_moments[:, :3] / mass,
    )


def estimate_supports(triangles: Floats, overhang_cos: float, count: int) -> tuple[float, float, float]:
    """Estimate the supports of a closed mesh from a few columns.

    Parameters
    ----------
    triangles, overhang_cos
        As in `measure_columns`.
    count
        Approximate number of columns.

    Returns
    -------
    tuple
        `support_mm3`, `fine_support_side_mm2` and `towers_mm` of `Columns`.
    """
    triangles = np.ascontiguousarray(triangles)
    lo_mm, hi_mm = find_bounds(triangles)
    rays = place_rays(lo_mm, hi_mm, _compute_step_mm(lo_mm, hi_mm, count))
    supports = sweep_supports(triangles, np.zeros(len(triangles)), rays, overhang_cos)
    side_mm2 = sum_steps_mm(supports.supports_mm) * rays.step_mm + supports.strip_sides_mm2
    # With the ratio of all columns, as that of a few would overestimate the sides of large even supports.
    return (
        float(supports.supports_mm.sum() * rays.step_mm**2),
        _compute_fine_side_ratio(_choose_step_mm(lo_mm, hi_mm)) * side_mm2,
        supports.towers_mm,
    )


def _compute_fine_side_ratio(step_mm: float) -> float:
    """Compute the ratio of the area of sides at a distance of `SIDE_STEP_MM` to that at another distance."""
    ratio: float = (step_mm / SIDE_STEP_MM) ** SIDE_EXPONENT
    return ratio


def _choose_step_mm(lo_mm: Floats, hi_mm: Floats) -> float:
    """Choose the distance of the columns over the bounds (3,) of a mesh."""
    width_mm, depth_mm = (hi_mm - lo_mm)[:2].tolist()
    count = min(MAX_COLUMN_COUNT, max(COLUMN_COUNT, width_mm * depth_mm / MAX_STEP_MM**2))
    return _compute_step_mm(lo_mm, hi_mm, count)


def _compute_step_mm(lo_mm: Floats, hi_mm: Floats, count: float) -> float:
    """Compute the distance of approximately this number of columns over the bounds (3,) of a mesh."""
    width_mm, depth_mm = (hi_mm - lo_mm)[:2].tolist()
    return max(MIN_STEP_MM, math.sqrt(width_mm * depth_mm / count))


@jit
def _find_row_ends(is_marked: Bools) -> Floats:
    """Find the first and the last marked column in each row.

    Parameters
    ----------
    is_marked
        (nx, ny) bool.

    Returns
    -------
    ndarray
        (2 r, 2) float64 indices: the first marked column of each of r rows, then the last ones.
    """
    row_count, row_length = is_marked.shape
    ends = np.empty((row_count, 3))  # row, first and last marked column
    count = 0
    for i in range(row_count):
        first, last = -1, -1
        for j in range(row_length):
            if is_marked[i, j]:
                first, last = (j if first < 0 else first), j
        if first >= 0:
            ends[count, 0], ends[count, 1], ends[count, 2] = i, first, last
            count += 1
    points = np.empty((2 * count, 2))
    for k in range(count):
        points[k, 0], points[k, 1] = ends[k, 0], ends[k, 1]
        points[count + k, 0], points[count + k, 1] = ends[k, 0], ends[k, 2]
    return points
