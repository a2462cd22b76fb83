"""Sample points of the glued area of an assembly step, and the points that no pin of the step reaches.

A pin reaches the glued area around it, up to a distance at which it still aligns the faces well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial.distance import cdist

from decompose.arrays import Floats
from decompose.connectors.faces import Side
from decompose.connectors.records import Pin

REACH_MM = 60.0  # distance up to which a pin aligns the glued area around it
MIN_REACHED_SHARE = 0.95  # minimum share of a step's glued area that its pins have to reach
GLUE_PITCH_MM = 5.0  # pitch of the sample points of the glued area
MIN_GAIN_MM2 = 100.0  # a pin is added only if it reaches at least this area that no other pin reaches


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Glued face on which connectors may be placed: its sides on the moved and on the fixed part."""

    moved_side: Side
    fixed_side: Side


def sample_glue(sides: Sequence[Side]) -> Floats:
    """List sample points (n, 3) in mm of all glued faces, including those that slide over each other."""
    return np.concatenate(
        [sample_points(side, side.face.outline, GLUE_PITCH_MM) for side in sides] or [np.zeros((0, 3))]
    )


def find_unreached_glue(glue_points_mm: Floats, pins: Sequence[Pin]) -> Floats:
    """Find the sample points that no pin reaches.

    Parameters
    ----------
    glue_points_mm
        (n, 3) points from `sample_glue`.
    pins
        Pins and keys so far.

    Returns
    -------
    ndarray
        (k, 3) points; all if there are no pins, none if the pins reach nearly all points.
    """
    if not pins:
        return glue_points_mm
    unreached_points_mm = glue_points_mm[
        cdist(glue_points_mm, [pin.position_mm for pin in pins]).min(axis=1, initial=np.inf) > REACH_MM
    ]
    return np.asarray(
        unreached_points_mm
        if len(unreached_points_mm) > (1.0 - MIN_REACHED_SHARE) * len(glue_points_mm)
        else unreached_points_mm[:0]
    )


def sort_places_by_gain(
    places_mm: Floats, unreached_points_mm: Floats, weights: Floats | float = 1.0
) -> list[int]:
    """Sort places for a pin by the area that only it would reach, multiplied by the weight of the place.

    Places where this area would be smaller than `MIN_GAIN_MM2` are left out.

    Parameters
    ----------
    places_mm
        (n, 3) points.
    unreached_points_mm
        (k, 3) points from `find_unreached_glue`.
    weights
        (n,) weights, or one for all.

    Returns
    -------
    list[int]
        Numbers of the places, the best first.
    """
    gains_mm2 = (cdist(places_mm, unreached_points_mm) < REACH_MM).sum(axis=1) * GLUE_PITCH_MM**2
    order = np.argsort(-gains_mm2 * weights, kind="stable")
    return [int(number) for number in order if gains_mm2[number] >= MIN_GAIN_MM2]


def sample_points(side: Side, area: shapely.Geometry, pitch_mm: float) -> Floats:
    """List the points of a square grid inside an area of a face; at least one, unless the area is empty.

    Parameters
    ----------
    side
        Side of the face.
    area
        Area in the coordinates of the face.
    pitch_mm
        Distance between points.

    Returns
    -------
    ndarray
        (n, 3) points in mm.
    """
    if area.is_empty:
        return np.zeros((0, 3))
    low_x, low_y, high_x, high_y = area.bounds
    spans = (np.arange(a + pitch_mm / 2.0, b, pitch_mm) for a, b in ((low_x, high_x), (low_y, high_y)))
    grid = np.array(np.meshgrid(*spans)).reshape(2, -1).T
    inside = grid[shapely.contains_xy(area, grid)]
    return side.compute_points_mm(
        inside if len(inside) else shapely.get_coordinates(area.representative_point())
    )
