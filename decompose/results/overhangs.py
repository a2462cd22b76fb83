"""Ceilings of holes and grooves, measured layer by layer as in a slicer.

The slicer supports areas that extend further beyond the layer below than the support angle allows. To check
connectors independently of the formulas with which the search chooses their shapes, the hollows that are cut
for them are divided into layers. Between two heights at which a hollow has corners, the edges of its sections
move linearly, so the lowest and the highest layers between them represent the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import shapely

from decompose.arrays import Floats
from decompose.geometry import Solid, choose_plane_axes

Polygons = npt.NDArray[np.object_]

LAYER_HEIGHT_MM = 0.2
# Maximum distance by which a layer may extend beyond the layer below without support.
MAX_OVERHANG_MM = LAYER_HEIGHT_MM * math.tan(math.radians(50.0))
MIN_OUTLINE_MM = 1.0  # minimum length of an outline: the slicer leaves out shorter ones
ROUNDING_MARGIN_MM = 0.004  # tolerance for rounding errors of sections
LEVEL_COS = 0.5  # minimum vertical component of the normal of a level face; other faces count as upright
CORNER_TOLERANCE_MM = 1e-6  # height difference up to which a layer and a corner count as equally high
AIR_MM = 5.0  # thickness of the air in front of an upright face, and beyond the bodies cut out


def measure_ceiling_mm2(
    tools: Sequence[Floats],
    inward_normal: Floats,
    face_offset_mm: float,
    up_direction: Floats,
    exit_direction: Floats | None = None,
) -> float:
    """Measure the area that needs support in each layer above a hollow, and return the largest.

    Parameters
    ----------
    tools
        (n, 3) corners in mm of each convex body that is cut out.
    inward_normal
        (3,) unit vector from the tools' face into the part.
    face_offset_mm
        Coordinate of the face along `inward_normal`.
    up_direction
        (3,) upward direction of the bed in the pose of the part, in the same frame.
    exit_direction
        (3,) unit vector along which the tools leave the part through another face, beyond which nothing is
        printed; None if the tools open in one face only.
    """
    rise = float(inward_normal @ up_direction)
    if rise < -LEVEL_COS:
        return 0.0  # a hollow that opens upwards becomes wider with height
    corners_mm = np.concatenate(tools)
    high_mm = float((corners_mm @ up_direction).max()) + 2.0 * LAYER_HEIGHT_MM
    if exit_direction is not None:
        tools = [_lengthen_body(tool, exit_direction) for tool in tools]
        high_mm -= 3.0 * LAYER_HEIGHT_MM * float(exit_direction @ up_direction > 0.0)
    bodies = [Solid.hull(tool) for tool in tools]
    if rise <= LEVEL_COS:
        bodies.append(_build_air(corners_mm, inward_normal, face_offset_mm, up_direction))
    hollow = Solid.union(bodies)
    frame = np.vstack([choose_plane_axes(up_direction), up_direction])
    low_mm = float((corners_mm @ up_direction).min())
    layer_heights_mm = np.arange(low_mm + LAYER_HEIGHT_MM / 2.0, high_mm, LAYER_HEIGHT_MM)
    areas = _cut_layers(hollow, frame, layer_heights_mm)
    lower_layers = [n for n in areas if n + 1 in areas]
    open_below = shapely.buffer(
        [areas[n] for n in lower_layers], -MAX_OVERHANG_MM - ROUNDING_MARGIN_MM, quad_segs=4
    )
    ceilings = shapely.difference(open_below, [areas[n + 1] for n in lower_layers])
    return float(shapely.area(ceilings).max(initial=0.0))


def _cut_layers(hollow: Solid, frame: Floats, layer_heights_mm: Floats) -> dict[int, shapely.Geometry]:
    """Cut a hollow at heights (n,), but leave out layers that are similar to others.

    A run consists of successive layers between which the hollow has no corner. Only the first two and the
    last two of them are cut, unless an outline in the first or the last one is so short that the slicer
    leaves it out.

    Returns
    -------
    dict
        Area of each layer that is cut, by its number.
    """
    corner_heights_mm = np.sort(hollow.arrays()[0] @ frame[2])
    has_corner_between = np.searchsorted(
        corner_heights_mm, layer_heights_mm[:-1] - CORNER_TOLERANCE_MM
    ) < np.searchsorted(corner_heights_mm, layer_heights_mm[1:] + CORNER_TOLERANCE_MM)
    breaks = 1 + np.flatnonzero(has_corner_between)
    runs = [run.tolist() for run in np.split(np.arange(len(layer_heights_mm)), breaks) if len(run)]
    end_layers = sorted({n for run in runs for n in _list_end_layers(run)})
    outlines = dict(zip(end_layers, _cut_outlines(hollow, frame, layer_heights_mm[end_layers]), strict=True))
    other_layers = [
        n
        for run in runs
        if any((shapely.length(outlines[end]) < MIN_OUTLINE_MM).any() for end in (run[0], run[-1]))
        for n in run
        if n not in outlines
    ]
    outlines |= dict(
        zip(other_layers, _cut_outlines(hollow, frame, layer_heights_mm[other_layers]), strict=True)
    )
    return {n: _build_area(outlines[n]) for n in sorted(outlines)}


def _list_end_layers(run: list[int]) -> list[int]:
    """List the first two and the last two of some successive layers."""
    return [*run[:2], *run[-2:]]


def _lengthen_body(corners_mm: Floats, direction: Floats) -> Floats:
    """Extend a convex body with corners (n, 3) beyond its end in a direction (3,)."""
    coordinates_mm = corners_mm @ direction
    end = corners_mm[coordinates_mm > coordinates_mm.max() - LAYER_HEIGHT_MM / 2.0]
    return np.concatenate([corners_mm, end + AIR_MM * direction])


def _build_air(
    corners_mm: Floats, inward_normal: Floats, face_offset_mm: float, up_direction: Floats
) -> Solid:
    """Build a body of air in front of an upright face, so that sections are open at the tools' mouths."""
    upwards = up_direction - (up_direction @ inward_normal) * inward_normal
    upwards = upwards / np.linalg.norm(upwards)
    frame = np.stack([np.cross(upwards, inward_normal), upwards, inward_normal])
    # A leaning face moves sideways with height: the block spans all heights of the tools, at front and back.
    heights_mm = corners_mm @ up_direction
    limits_mm = np.array([heights_mm.min(), heights_mm.max()])[:, None]
    depths_mm = face_offset_mm + np.array([-AIR_MM, 0.0])
    along_mm = (limits_mm - depths_mm * float(inward_normal @ up_direction)) / float(upwards @ up_direction)
    across_mm = corners_mm @ frame[0]
    low_mm = np.array([across_mm.min(), along_mm.min()]) - AIR_MM
    high_mm = np.array([across_mm.max(), along_mm.max()]) + AIR_MM
    ring = np.array([low_mm, (high_mm[0], low_mm[1]), high_mm, (low_mm[0], high_mm[1])])
    return Solid.prism([ring], frame, face_offset_mm - AIR_MM, face_offset_mm)


def _cut_outlines(hollow: Solid, frame: Floats, heights_mm: Floats) -> list[Polygons]:
    """Cut a hollow at heights (n,); return the outlines (k,) of each section as polygons."""
    sections = [[ring for ring in rings if len(ring) > 2] for rings in hollow.cut_sections(frame, heights_mm)]
    rings = [ring for section in sections for ring in section]
    numbers = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    coordinates = np.concatenate([np.zeros((0, 2)), *rings])
    outlines = shapely.polygons(shapely.linearrings(coordinates, indices=numbers))
    ends = np.cumsum([0, *map(len, sections)]).tolist()
    return [outlines[start:end] for start, end in pairwise(ends)]


def _build_area(outlines: Polygons) -> shapely.Geometry:
    """Build the area of a layer from its outlines, without those that are too short, as the slicer does."""
    outlines = shapely.buffer(outlines[shapely.length(outlines) >= MIN_OUTLINE_MM], 0.0)
    if len(outlines) == 1:
        return outlines[0]
    area: shapely.Geometry = shapely.Polygon()
    for outline in outlines[np.argsort(-shapely.area(outlines), kind="stable")]:
        area = area.symmetric_difference(outline)
    return area
