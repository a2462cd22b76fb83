"""Shapes of holes and grooves that print without support in the pose of their part."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import shapely
from scipy.spatial import ConvexHull

from decompose.arrays import Floats
from decompose.connectors.records import Tool
from decompose.geometry import choose_plane_axes, compute_cross_product

LIP_MM = 0.1  # distance by which a tool extends beyond its face, so that no film remains
# The ceiling of a hole or groove consists of the sides that overhang it in the pose of the part. This is the
# maximum sine of the angle between the ceiling of a hole and the vertical.
MAX_HOLE_SIN = math.sin(math.radians(40.0))
# Maximum sine of this angle for a groove; the slicer supports ceilings of 50 degrees or more.
MAX_GROOVE_SIN = math.sin(math.radians(47.5))
GROOVE_DEPTH_MM = 0.6  # depth of a groove, and half its width: its sides slope by 45 degrees

# Heights of the roof and the tip of a hole as multiples of its inner radius, in ascending order of removed
# volume. The roof runs along the hole and points upwards; the tip rises from the end of the hole.
_CEILINGS = (
    (0.0, 0.0),
    (1.9, 0.0),
    (0.0, 1.75),
    (2.2, 0.0),
    (1.9, 1.75),
    (1.9, 3.0),
    (2.2, 3.5),
    (2.6, 4.5),
    (2.6, 6.0),
)
HALF_RIDGE_MM = 0.5
"""Half the length of the ridge in which a tip ends. A ceiling that ends in a point would need support: the
slicer leaves out outlines shorter than 1 mm, and so covers a hole that is still wide (`needs_bridge`)."""
LAYER_HEIGHT_MM = 0.2
MAX_BRIDGED_MM = 0.23  # maximum distance by which a layer may protrude beyond the layer below without support
MIN_OUTLINE_MM = 1.0  # minimum length of an outline in a layer: the slicer leaves out shorter ones
_SAME_HEIGHT_MM = 1e-3  # maximum difference of two heights that count as equal
_MAX_MOUTH_COS = -0.99  # maximum cosine between the normal of the mouth and the direction into the part
_HEXAGON_ANGLES_RAD = np.deg2rad(90.0 + 60.0 * np.arange(6))
_CONE_ANGLES_RAD = np.deg2rad(45.0 * np.arange(8))


def make_hole(
    part: int,
    mouth_mm: Floats,
    inward_normal: Floats,
    up_direction: Floats,
    size_mm: tuple[float, float],
    elongation_mm: Floats,
) -> Tool | None:
    """Make a hexagonal hole, with a ceiling that needs no support in the pose of its part.

    The corners of a hexagon leave space for air and glue; its sides touch a round pin along six lines.

    Parameters
    ----------
    part
        Number of the part.
    mouth_mm
        (3,) point where the axis meets the face.
    inward_normal
        (3,) unit vector of the axis, into the part.
    up_direction
        (3,) upward direction of the bed in the part's pose, in the same frame.
    size_mm
        Width across the flats, and depth.
    elongation_mm
        (3,) elongation perpendicular to the axis, in both directions; 0 for a regular hexagon.

    Returns
    -------
    Tool | None
        None if no hole of this size can be printed without support.
    """
    width_mm, depth_mm = size_mm
    inner_mm = width_mm / 2.0
    upwards, across = _choose_cross_axes(inward_normal, up_direction)
    corners = _make_hexagon(upwards, across, inner_mm)
    if elongation_mm.any():
        corners = np.concatenate([corners + elongation_mm, corners - elongation_mm])
    for roof, tip in _CEILINGS:
        section = np.vstack([corners, roof * inner_mm * upwards]) if roof else corners
        points = np.concatenate([section - LIP_MM * inward_normal, section + depth_mm * inward_normal])
        if tip:
            ridge = HALF_RIDGE_MM * np.array([[-1.0], [1.0]]) * across
            points = np.vstack([points, depth_mm * inward_normal + tip * inner_mm * up_direction + ridge])
        hole = Tool(part, points + mouth_mm, inward_normal, float(mouth_mm @ inward_normal))
        if compute_overhang_sin(points, inward_normal, up_direction) <= MAX_HOLE_SIN and not needs_bridge(
            hole, up_direction
        ):
            return hole
    return None


def make_groove(
    part: int,
    ends_mm: Floats,
    inward_normal: Floats,
    depth_mm: float = GROOVE_DEPTH_MM,
    width_ratio: float = 1.0,
) -> Tool:
    """Make a V groove along a stroke, or a cone if both ends are equal.

    Parameters
    ----------
    part
        Number of the part.
    ends_mm
        (2, 3) ends of the groove's centre line, on the face; at each end, a half cone follows.
    inward_normal
        (3,) unit vector from the face into the part.
    depth_mm
        Depth of the groove.
    width_ratio
        Half the width of the groove divided by its depth: 1 for an angle of 90 degrees.
    """
    along = ends_mm[1] - ends_mm[0]
    if not along.any():
        along = compute_cross_product(inward_normal, np.eye(3)[int(np.abs(inward_normal).argmin())])
    first = along / np.linalg.norm(along)
    second = compute_cross_product(inward_normal, first)
    rim = (
        first * np.cos(_CONE_ANGLES_RAD)[:, None] + width_ratio * second * np.sin(_CONE_ANGLES_RAD)[:, None]
    ) * (depth_mm + LIP_MM)
    cone = np.vstack([rim - LIP_MM * inward_normal, depth_mm * inward_normal])
    points = np.concatenate([cone + end for end in np.unique(ends_mm, axis=0)])
    return Tool(part, points, inward_normal, float(ends_mm[0] @ inward_normal))


def cut_groove_at_exit(groove: Tool, end_mm: Floats, exit_direction: Floats) -> Tool:
    """Cut a groove off squarely at its exit.

    Parameters
    ----------
    groove
        Groove that extends beyond the exit.
    end_mm
        (3,) point at which the groove leaves the part.
    exit_direction
        (3,) unit vector out of the part.
    """
    beyond_mm = ((groove.points_mm - end_mm) @ exit_direction).clip(min=0.0)
    return replace(
        groove,
        points_mm=groove.points_mm - np.outer(beyond_mm, exit_direction),
        exit_direction=exit_direction,
    )


def _choose_cross_axes(inward_normal: Floats, up_direction: Floats) -> tuple[Floats, Floats]:
    """Choose two unit vectors (3,) perpendicular to a hole's axis: one as steep as possible, one level."""
    upwards = up_direction - (up_direction @ inward_normal) * inward_normal
    if np.linalg.norm(upwards) < 1e-6:
        upwards = compute_cross_product(np.eye(3)[int(np.abs(inward_normal).argmin())], inward_normal)
    upwards = upwards / np.linalg.norm(upwards)
    return upwards, compute_cross_product(inward_normal, upwards)


def _make_hexagon(upwards: Floats, across: Floats, inner_mm: float) -> Floats:
    """Compute the corners (6, 3) of a hexagon around the origin with one corner at the top."""
    directions = (
        upwards * np.sin(_HEXAGON_ANGLES_RAD)[:, None] + across * np.cos(_HEXAGON_ANGLES_RAD)[:, None]
    )
    return np.asarray(directions * (inner_mm / math.cos(math.pi / 6.0)))


def compute_overhang_sin(points_mm: Floats, inward_normal: Floats, up_direction: Floats) -> float:
    """Compute the sine of the angle between the flattest ceiling of a convex tool and the vertical.

    The mouth does not count as a ceiling. The sine is negative if nothing overhangs.

    Parameters
    ----------
    points_mm
        (n, 3) corners of the tool.
    inward_normal
        (3,) unit vector from the mouth into the part.
    up_direction
        (3,) upward direction of the bed in the part's pose, in the same frame.
    """
    normals = ConvexHull(points_mm).equations[:, :3]
    sides = normals[normals @ inward_normal > _MAX_MOUTH_COS]
    return float((sides @ up_direction).max())


def needs_bridge(tool: Tool, up_direction: Floats) -> bool:
    """Check whether the layer that covers the top of a tool bridges too wide a gap to print without support.

    The sections of a convex tool shrink towards its top. The slicer leaves out short outlines, so a ceiling
    that ends in a point is covered one or two layers early, where the section is still wide.

    Parameters
    ----------
    tool
        Tool that is cut out of a part.
    up_direction
        (3,) upward direction of the bed in the part's pose, in the same frame.
    """
    heights_mm = tool.points_mm @ up_direction
    high_mm = float(heights_mm.max())
    top = tool.points_mm[heights_mm > high_mm - _SAME_HEIGHT_MM]
    if (top @ tool.inward_normal).min() < tool.face_offset_mm + _SAME_HEIGHT_MM:
        return False  # the section is open at the mouth: it is a notch in the part's outline, not a hole
    if 2.0 * float(np.ptp(top, axis=0).max()) < MIN_OUTLINE_MM:
        low_mm = float(heights_mm.min())
        for _ in range(10):
            middle_mm = (low_mm + high_mm) / 2.0
            is_short = _cut_section(tool, up_direction, middle_mm).length < MIN_OUTLINE_MM
            low_mm, high_mm = (low_mm, middle_mm) if is_short else (middle_mm, high_mm)
    last_section = _cut_section(tool, up_direction, high_mm - LAYER_HEIGHT_MM)
    return last_section.area > 0.0 and not last_section.buffer(-MAX_BRIDGED_MM).is_empty


def _cut_section(tool: Tool, up_direction: Floats, height_mm: float) -> shapely.Geometry:
    """Cut the section of a tool at a height along `up_direction`; empty if the tool is not at that height."""
    offsets_mm = tool.points_mm @ up_direction - height_mm
    above, below = np.flatnonzero(offsets_mm > 0.0), np.flatnonzero(offsets_mm <= 0.0)
    if not len(above) or not len(below):
        return shapely.Polygon()
    share = offsets_mm[above][:, None] / (offsets_mm[above][:, None] - offsets_mm[below])
    start = tool.points_mm[above][:, None]
    points = (start + share[..., None] * (tool.points_mm[below] - start)).reshape(-1, 3)
    return shapely.MultiPoint(points @ choose_plane_axes(up_direction).T).convex_hull
