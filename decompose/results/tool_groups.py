"""Tools of one connector in one part, measured for the rules of connectors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.connectors import Connector, Tool, build_polygons, list_rings
from decompose.geometry import Solid, choose_plane_axes
from decompose.pieces import Joint
from decompose.results.overhangs import measure_ceiling_mm2

# Maximum area in one layer, in the ceiling of a tool, that may be left without support: in a hole or groove,
# and where strokes of a mark cross. The ceiling of a tool consists of the sides that overhang it.
EPS_MM2, SPECK_MM2 = 0.005, 0.3
# Minimum wall around a tool, and between two tools. The search for places keeps a slightly thicker wall
# (`connectors.records.RIM_MM`).
RIM_MM = 1.15
KEY_RIM_MM = 0.75  # minimum wall around the groove of a key
FILM_MM = 0.06  # depth below a face down to which nothing is checked, because of rounding errors
# Maximum angles between a ceiling and the vertical; the slicer supports ceilings of 50 degrees or more.
MAX_HOLE_RAD, MAX_GROOVE_RAD = math.radians(40.5), math.radians(48.0)
MAX_MOUTH_COS = -0.99  # maximum cosine between the normal of the mouth and the direction into the part
ARC_SEGMENTS = 4  # number of sides of a polygon around a circle, for each quarter of it
PARALLEL_COS = 1.0 - 1e-9  # minimum cosine between two parallel directions


@dataclass(frozen=True, eq=False)  # without slots, because of its cached properties
class ToolGroup:
    """Tools of one hole, groove, mark or gutter.

    Attributes
    ----------
    tools, joint
        Tools, and the joint on whose faces they are.
    kind
        Word for the group in messages: hole, groove, mark or gutter.
    connector
        Pin, mark or gutter that the tools belong to.
    """

    tools: tuple[Tool, ...]
    joint: Joint
    kind: str
    connector: Connector

    @property
    def max_overhang_rad(self) -> float:
        """Maximum angle between a ceiling and the vertical."""
        return MAX_HOLE_RAD if self.kind == "hole" else MAX_GROOVE_RAD

    @property
    def max_ceiling_mm2(self) -> float:
        """Maximum area in one layer of the ceiling that may be left without support; larger for a mark."""
        return SPECK_MM2 if self.kind == "mark" else EPS_MM2

    @cached_property
    def solid(self) -> Solid:
        """Union of the tools."""
        return Solid.union([Solid.hull(tool.points_mm) for tool in self.tools])

    @cached_property
    def bounds_mm(self) -> Floats:
        """Least and greatest coordinates (2, 3) of the tools."""
        points_mm = np.concatenate([tool.points_mm for tool in self.tools])
        return np.stack([points_mm.min(axis=0), points_mm.max(axis=0)])

    def is_near(self, other: ToolGroup) -> bool:
        """Check whether the bounding boxes of two groups are closer than the minimum wall."""
        (a_low, a_high), (b_low, b_high) = self.bounds_mm, other.bounds_mm
        return bool((np.maximum(a_low, b_low) - np.minimum(a_high, b_high)).max() < RIM_MM)

    @cached_property
    def _outline(self) -> shapely.Geometry:
        """Outline of the tools on their face, with the wall around them."""
        across = choose_plane_axes(self.tools[0].inward_normal)
        hulls = [shapely.MultiPoint(tool.points_mm @ across.T).convex_hull for tool in self.tools]
        rim_radius_mm = self.rim_mm / math.cos(math.pi / 4.0 / ARC_SEGMENTS)  # the polygon contains the arc
        return shapely.union_all(hulls).buffer(rim_radius_mm, quad_segs=ARC_SEGMENTS)

    @property
    def rim_mm(self) -> float:
        """Minimum wall around the tools."""
        return KEY_RIM_MM if self.kind == "groove" else RIM_MM

    def build_sleeve(self) -> Solid:
        """Build the union of the tools and the minimum wall around them, from just below the face."""
        first = self.tools[0]
        if self.kind == "groove":
            enlarged_points_mm = (first.points_mm[:, None] + self.rim_mm * _SPHERE_POINTS).reshape(-1, 3)
            end_mm = float((enlarged_points_mm @ first.inward_normal).max())
            below = extrude_outline(
                self._outline, first.inward_normal, first.face_offset_mm + FILM_MM, end_mm
            )
            return Solid.hull(enlarged_points_mm).intersect(below)
        end_mm = max(float((tool.points_mm @ first.inward_normal).max()) for tool in self.tools) + RIM_MM
        return extrude_outline(self._outline, first.inward_normal, first.face_offset_mm + FILM_MM, end_mm)

    @property
    def has_exit(self) -> bool:
        """True if the tools are a groove that leaves its part through a second face."""
        return self.tools[0].exit_direction is not None

    def is_hidden(self, undrilled_solid: Solid) -> bool:
        """Check whether the mouths of the tools, and the wall around them, lie within a face of the joint."""
        inward_normal = self.tools[0].inward_normal
        across = choose_plane_axes(inward_normal)
        outline = self._outline
        if self.has_exit:
            wall = self.build_sleeve().intersect(undrilled_solid)
            outline = build_polygons(wall.project(np.vstack([across, inward_normal])))
        for face in self.joint.faces:
            along = float(face.normal @ inward_normal)
            if abs(along) < PARALLEL_COS or abs(face.offset_mm * along - self.tools[0].face_offset_mm) > 1e-6:
                continue
            face_outline = shapely.transform(
                face.outline,
                lambda points_mm, face=face: (
                    (points_mm @ face.axes + face.offset_mm * face.normal) @ across.T
                ),
            )
            if face_outline.buffer(FILM_MM).contains(outline):
                return True
        return False

    def measure_ceiling_mm2(self, up_direction: Floats) -> float:
        """Measure the area that needs support in each layer above the tools, and return the largest."""
        first = self.tools[0]
        tools = [tool.points_mm for tool in self.tools]
        return measure_ceiling_mm2(
            tools, first.inward_normal, first.face_offset_mm, up_direction, first.exit_direction
        )

    def compute_overhang_rad(self, up_direction: Floats) -> float:
        """Compute, from the tools' triangles, the angle between the flattest ceiling and the vertical."""
        overhang_rad = -1.0
        for tool in self.tools:
            vertices, faces = Solid.hull(tool.points_mm).arrays()
            a, b, c = (vertices[faces[:, k]] for k in range(3))
            normals = np.cross(b - a, c - a)
            sizes = np.linalg.norm(normals, axis=1)
            normals = normals[sizes > 1e-6] / sizes[sizes > 1e-6, None]
            is_open = normals @ tool.inward_normal <= MAX_MOUTH_COS
            if tool.exit_direction is not None:
                is_open |= normals @ tool.exit_direction > PARALLEL_COS
            sides = normals[~is_open]
            overhang_rad = max(overhang_rad, float((sides @ up_direction).max()))
        return math.asin(min(1.0, overhang_rad))


_CORNERS = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
_SPHERE_POINTS = (
    _CORNERS[_CORNERS.any(axis=1)] / np.linalg.norm(_CORNERS[_CORNERS.any(axis=1)], axis=1)[:, None]
)
"""Points (26, 3) on the unit sphere."""


def extrude_outline(outline: shapely.Geometry, axis: Floats, start_mm: float, end_mm: float) -> Solid:
    """Extrude an outline along an axis (3,), between two coordinates on that axis."""
    return Solid.prism(list_rings(outline), np.vstack([choose_plane_axes(axis), axis]), start_mm, end_mm)
