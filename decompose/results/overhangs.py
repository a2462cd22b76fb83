"""Ceilings of holes and grooves, measured layer by layer as a slicer sees them.

The slicer supports what reaches further over the layer below than the support angle allows. The rule of
connectors cuts the hollows into layers, without the formulas of the search for their shapes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.geometry import Solid, choose_plane_axes

LAYER_MM = 0.2
REACH_MM = LAYER_MM * math.tan(math.radians(50.0))  # reach of a layer beyond the one below, without support
RING_MM = 1.0  # minimum length of a ring: the slicer drops shorter ones
SLACK_MM = 0.004  # tolerance for the rounding of sections
LEVEL = 0.5  # minimum vertical component of the normal of a level face; others are upright
AIR_MM = 5.0  # thickness of the air in front of an upright face, and around its tools


def measure_ceiling_mm2(
    tools: Sequence[Floats],
    into: Floats,
    face_mm: float,
    up: Floats,
    exit_direction: Floats | None = None,
) -> float:
    """Measure the largest area of a layer over a hollow that needs support.

    Parameters
    ----------
    tools
        (n, 3) corners of each convex body that is cut out, in mm.
    into
        (3,) unit vector from their face into the part.
    face_mm
        Coordinate of the face along `into`.
    up
        (3,) upward direction of the bed in the pose of the part, in the same frame.
    exit_direction
        (3,) unit vector along which they leave the part through another face, above which nothing is printed.
    """
    rise = float(into @ up)
    if rise < -LEVEL:
        return 0.0  # a hollow that opens upwards only gets wider
    corners_mm = np.concatenate(tools)
    high_mm = float((corners_mm @ up).max()) + 2.0 * LAYER_MM
    if exit_direction is not None:
        tools = [_lengthen(tool, exit_direction) for tool in tools]
        high_mm -= 3.0 * LAYER_MM * float(exit_direction @ up > 0.0)
    bodies = [Solid.hull(tool) for tool in tools]
    if rise <= LEVEL:
        bodies.append(_build_air(corners_mm, into, face_mm, up))
    hollow = Solid.union(bodies)
    frame = np.vstack([choose_plane_axes(up), up])
    low_mm = float((corners_mm @ up).min())
    layers = np.arange(low_mm + LAYER_MM / 2.0, high_mm, LAYER_MM)
    areas = np.array([_cut_layer(hollow, frame, at_mm) for at_mm in layers])
    open_below = shapely.buffer(areas[:-1], -REACH_MM - SLACK_MM, quad_segs=4)
    return float(shapely.area(shapely.difference(open_below, areas[1:])).max(initial=0.0))


def _lengthen(corners_mm: Floats, direction: Floats) -> Floats:
    """Continue a convex body with corners (n, 3) beyond its end in a direction (3,)."""
    along_mm = corners_mm @ direction
    end = corners_mm[along_mm > along_mm.max() - LAYER_MM / 2.0]
    return np.concatenate([corners_mm, end + AIR_MM * direction])


def _build_air(corners_mm: Floats, into: Floats, face_mm: float, up: Floats) -> Solid:
    """Build the air in front of an upright face, so that a ceiling at the mouth has no wall there."""
    upwards = up - (up @ into) * into
    upwards = upwards / np.linalg.norm(upwards)
    frame = np.stack([np.cross(upwards, into), upwards, into])
    low, high = (
        (corners_mm @ frame[:2].T).min(axis=0) - AIR_MM,
        (corners_mm @ frame[:2].T).max(axis=0) + AIR_MM,
    )
    ring = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    return Solid.prism([ring], frame, face_mm - AIR_MM, face_mm)


def _cut_layer(hollow: Solid, frame: Floats, at_mm: float) -> shapely.Geometry:
    """Cut a hollow at a height without rings that are too short, as the slicer does."""
    rings = [ring for ring in hollow.section(frame, at_mm) if len(ring) > 2]
    outlines = [ring for ring in map(shapely.Polygon, rings) if ring.length >= RING_MM]
    if len(outlines) == 1:
        return outlines[0].buffer(0.0)
    area: shapely.Geometry = shapely.Polygon()
    for outline in sorted(outlines, key=lambda ring: -ring.area):
        area = area.symmetric_difference(outline.buffer(0.0))
    return area
