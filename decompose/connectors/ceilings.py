"""Ceilings of holes and grooves, as the slicer sees them: how far they lean, and how they close."""

from __future__ import annotations

import numpy as np
import shapely
from scipy.spatial import ConvexHull

from decompose.arrays import Floats
from decompose.connectors.records import Tool
from decompose.geometry import choose_plane_axes

LAYER_MM, STEP_MM = 0.2, 0.23  # a layer, and the step between two of them that is not supported yet
RING_MM = 1.0  # shorter rings are dropped by the slicer, so that a ceiling closes early
_EDGE_MM = 1e-3
_MOUTH = -0.99  # cosine between a side of a tool and the direction into the part, from which it is the mouth


def overhang_sin(points_mm: Floats, into: Floats, up: Floats) -> float:
    """Compute the sine of the angle to the vertical of the flattest ceiling of a convex tool (n, 3).

    The mouth is left out. Negative where nothing hangs over.
    """
    normals = ConvexHull(points_mm).equations[:, :3]
    sides = normals[normals @ into > _MOUTH]
    return float((sides @ up).max())


def closes_in_a_step(tool: Tool, up: Floats) -> bool:
    """Check whether the ceiling of a tool closes from one layer to the next by more than prints unsupported.

    The sections of a convex tool shrink towards its top. The slicer drops the short ones, so that a ceiling
    that ends in a point closes one or two layers early.

    Parameters
    ----------
    tool
        The tool.
    up
        (3,) the bed's up in the pose of its part, in the same frame.
    """
    heights = tool.points_mm @ up
    high_mm = float(heights.max())
    top = tool.points_mm[heights > high_mm - _EDGE_MM]
    if (top @ tool.into).min() < tool.face_mm + _EDGE_MM:
        return False  # it ends at the mouth: a notch in the outline, not a ring
    if 2.0 * float(np.ptp(top, axis=0).max()) < RING_MM:
        low_mm = float(heights.min())
        for _ in range(10):
            middle_mm = (low_mm + high_mm) / 2.0
            is_short = _cut(tool, up, middle_mm).length < RING_MM
            low_mm, high_mm = (low_mm, middle_mm) if is_short else (middle_mm, high_mm)
    last = _cut(tool, up, high_mm - LAYER_MM)
    return last.area > 0.0 and not last.buffer(-STEP_MM).is_empty


def _cut(tool: Tool, up: Floats, at_mm: float) -> shapely.Geometry:
    """Cut the convex body of a tool at a height; empty if it does not reach there."""
    off_mm = tool.points_mm @ up - at_mm
    above, below = np.flatnonzero(off_mm > 0.0), np.flatnonzero(off_mm <= 0.0)
    if not len(above) or not len(below):
        return shapely.Polygon()
    share = off_mm[above][:, None] / (off_mm[above][:, None] - off_mm[below])
    start = tool.points_mm[above][:, None]
    points = (start + share[..., None] * (tool.points_mm[below] - start)).reshape(-1, 3)
    return shapely.MultiPoint(points @ choose_plane_axes(up).T).convex_hull
