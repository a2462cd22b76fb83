"""Glue of a step that is far from its pins, as points on its faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial.distance import cdist

from decompose.arrays import Floats
from decompose.connectors.faces import Side
from decompose.connectors.records import Pin

REACH_MM = 60.0  # distance of glue from the nearest pin at which another pin is placed
NEAR_SHARE = 0.95  # minimum share of a step's glue that is nearer
GLUE_MM = 5.0  # pitch of the points of glue
WORTH_MM2 = 100.0  # minimum area of glue for which another pin is worthwhile


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Face that closes along the direction of a step: the side of the moved part, and of the other."""

    moved: Side
    fixed: Side


def sample_glue(sides: Sequence[Side]) -> Floats:
    """List points (n, 3) of the glue on faces, those that slide included."""
    return np.concatenate(
        [sample_points(side, side.face.outline, GLUE_MM) for side in sides] or [np.zeros((0, 3))]
    )


def find_far_glue(glue_mm: Floats, pins: Sequence[Pin]) -> Floats:
    """Find the points (n, 3) of glue that are far from all pins; none where nearly all glue is near."""
    if not pins:
        return glue_mm
    far = glue_mm[cdist(glue_mm, [pin.at_mm for pin in pins]).min(axis=1, initial=np.inf) > REACH_MM]
    return np.asarray(far if len(far) > (1.0 - NEAR_SHARE) * len(glue_mm) else far[:0])


def sort_by_gain(places_mm: Floats, far_mm: Floats, weights: Floats | float = 1.0) -> list[int]:
    """Sort the numbers of places (n, 3) by the far glue in their reach, times their weights (n,).

    Places in reach of little far glue are left out.
    """
    gains_mm2 = (cdist(places_mm, far_mm) < REACH_MM).sum(axis=1) * GLUE_MM**2
    order = np.argsort(-gains_mm2 * weights, kind="stable")
    return [int(number) for number in order if gains_mm2[number] >= WORTH_MM2]


def sample_points(side: Side, area: shapely.Geometry, pitch_mm: float) -> Floats:
    """List points (n, 3) of a square grid inside an area of a face; at least one, unless it is empty."""
    if area.is_empty:
        return np.zeros((0, 3))
    low_x, low_y, high_x, high_y = area.bounds
    spans = (np.arange(a + pitch_mm / 2.0, b, pitch_mm) for a, b in ((low_x, high_x), (low_y, high_y)))
    grid = np.array(np.meshgrid(*spans)).reshape(2, -1).T
    inside = grid[shapely.contains_xy(area, grid)]
    return side.lift(inside if len(inside) else shapely.get_coordinates(area.representative_point()))
