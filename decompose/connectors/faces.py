"""Areas for tools on the faces of joints, where a tool stays inside both parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.connectors.records import RIM_MM, Tool
from decompose.geometry import Solid
from decompose.options import PIN_FIT_MM
from decompose.pieces import Joint, JointFace, list_polygons

SLAB_DEPTH_MM = 8.0  # depth to which the gaps below a face are found and cached; few tools reach deeper
SKIN_DEPTH_MM = 0.05  # depth at which the search for gaps begins: rounding leaves films at the face itself
LEVEL_SIN = 0.5  # minimum sine of the angle between a level face and the vertical of the pose


@dataclass(frozen=True, slots=True, eq=False)
class Blank:
    """A part without holes.

    Attributes
    ----------
    name
        Short name that is written on the part.
    solid
        Solid in the frame of the joints, in mm.
    up_direction
        (3,) unit vector upwards from the bed in the part's pose, in the same frame.
    pin_fit_mm
        Clearance of its holes: width across the flats minus the diameter of the pin.
    """

    name: str
    solid: Solid
    up_direction: Floats
    pin_fit_mm: float = PIN_FIT_MM


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One part at a face of a joint.

    Attributes
    ----------
    part
        Number of the part.
    joint
        Number of the joint.
    face
        The face.
    sign
        1 if the part lies on the side of the face's normal, else -1.
    """

    part: int
    joint: int
    face: JointFace
    sign: float

    @property
    def inward_normal(self) -> Floats:
        """Unit vector (3,) from the face into the part."""
        return self.sign * self.face.normal

    def flatten(self, points_mm: Floats) -> Floats:
        """Compute the coordinates (..., 2) in mm of points (..., 3) in the plane of the face."""
        return points_mm @ self.face.axes.T

    def lift(self, coordinates_mm: Floats) -> Floats:
        """Compute the points (..., 3) in mm on the face with coordinates (..., 2)."""
        return coordinates_mm @ self.face.axes + self.face.offset_mm * self.face.normal


def find_sides(blanks: Sequence[Blank], number: int, joint: Joint) -> list[tuple[Side, Side]]:
    """Find both sides of each face of a joint; leave out a face if a part lies on both sides of its plane.

    Parameters
    ----------
    blanks
        All parts.
    number, joint
        Number of the joint, and the joint.
    """
    sides = []
    for face in joint.faces:
        signs = []
        for part in (joint.a, joint.b):
            offsets_mm = blanks[part].solid.arrays()[0] @ face.normal - face.offset_mm
            high_mm, low_mm = float(offsets_mm.max()), float(offsets_mm.min())
            signs.append(1.0 if low_mm > -SKIN_DEPTH_MM else -1.0 if high_mm < SKIN_DEPTH_MM else 0.0)
        if signs[0] * signs[1] < 0.0:
            sides.append((Side(joint.a, number, face, signs[0]), Side(joint.b, number, face, signs[1])))
    return sides


@dataclass(slots=True)
class Workpieces:
    """Parts, with the tools placed so far, and the remaining areas for other tools."""

    blanks: Sequence[Blank]
    tools: list[Tool] = field(default_factory=list)
    _gaps: dict[tuple[int, int], Solid] = field(default_factory=dict)
    _solid_areas: dict[tuple[int, float, int], shapely.Geometry] = field(default_factory=dict)

    def is_level(self, side: Side) -> bool:
        """Check whether a face lies level in its pose: a groove in it prints as a ring, which is slow."""
        return abs(float(side.inward_normal @ self.blanks[side.part].up_direction)) > LEVEL_SIN

    def find_tool_area(self, side: Side, depth_mm: float) -> shapely.Geometry:
        """Find the area of a face below which a part is solid to a depth plus a rim, and free of other tools.

        Parameters
        ----------
        side, depth_mm
            Side of the face, and depth of the tool.

        Returns
        -------
        shapely.Geometry
            Area in the coordinates of the face. Tools have to keep `RIM_MM` from its border.
        """
        return self.find_solid_area(side, depth_mm + RIM_MM)

    def find_solid_area(self, side: Side, depth_mm: float, wall_mm: float = RIM_MM) -> shapely.Geometry:
        """Find the area of a face below which a part is solid to a depth, and free of other tools.

        Parameters
        ----------
        side, depth_mm
            Side of the face, and the depth including all rims.
        wall_mm
            Distance that the tool will keep from the border of the area; from other tools it keeps `RIM_MM`.
        """
        area = self._find_solid_area(side, depth_mm)
        for tool in self.tools:
            if tool.part != side.part:
                continue
            heights_mm = tool.points_mm @ side.inward_normal - side.sign * side.face.offset_mm
            if heights_mm.min() < depth_mm + RIM_MM - wall_mm and heights_mm.max() > -RIM_MM:
                outline = shapely.MultiPoint(side.flatten(tool.points_mm)).convex_hull
                area = area - (outline.buffer(RIM_MM - wall_mm) if wall_mm < RIM_MM else outline)
        return area

    def _find_solid_area(self, side: Side, depth_mm: float) -> shapely.Geometry:
        """Find the area of a face below which a part without tools is solid to a depth; cached."""
        key = (side.part, round(depth_mm, 3), id(side.face))
        if key not in self._solid_areas:
            outline = side.face.outline
            gaps = self._find_gaps(side, depth_mm)
            frame = np.vstack([side.face.axes, side.face.normal])
            self._solid_areas[key] = (
                outline if gaps.is_empty else outline - build_polygons(gaps.project(frame))
            )
        return self._solid_areas[key]

    def _find_gaps(self, side: Side, depth_mm: float) -> Solid:
        """Find the gaps below a face, down to a depth: the space that is not solid.

        The part may have many triangles, so it is cut only once for each face; afterwards its gaps are cut.
        """
        solid = self.blanks[side.part].solid
        if depth_mm > SLAB_DEPTH_MM:
            return _build_slab(side, depth_mm).subtract(solid)
        key = (side.part, id(side.face))
        if key not in self._gaps:
            self._gaps[key] = _build_slab(side, SLAB_DEPTH_MM).subtract(solid)
        return self._gaps[key].keep_below(side.inward_normal, side.sign * side.face.offset_mm + depth_mm)


def _build_slab(side: Side, depth_mm: float) -> Solid:
    """Build the slab below a face, down to a depth."""
    frame = np.vstack([side.face.axes, side.face.normal])
    ends = side.face.offset_mm + side.sign * np.array([SKIN_DEPTH_MM, depth_mm])
    return Solid.prism(list_rings(side.face.outline), frame, float(ends.min()), float(ends.max()))


def erode_area(area: shapely.Geometry, shape: shapely.Polygon) -> shapely.Geometry:
    """Erode an area by a convex shape: find the positions of the shape's origin at which it stays inside.

    Parameters
    ----------
    area
        Area in a plane.
    shape
        Convex shape, in the same unit.

    Returns
    -------
    shapely.Geometry
        Positions of the shape's origin.
    """
    edges = [
        np.stack([ring[:-1], ring[1:]], axis=1)
        for polygon in list_polygons(area)
        for ring in map(shapely.get_coordinates, (polygon.exterior, *polygon.interiors))
    ]
    if area.is_empty:
        return shapely.Polygon()
    sweep = np.concatenate(edges)[:, :, None] - shapely.get_coordinates(shape)[:-1]
    hulls = shapely.convex_hull(shapely.multipoints(list(sweep.reshape(len(sweep), -1, 2))))
    return area - shapely.union_all(hulls)


def list_rings(outline: shapely.Geometry) -> list[Floats]:
    """List the rings (n, 2) of all polygons of a geometry."""
    return [
        np.asarray(ring.coords)[:-1]
        for polygon in list_polygons(outline)
        for ring in (polygon.exterior, *polygon.interiors)
    ]


def build_polygons(rings: Sequence[Floats]) -> shapely.Geometry:
    """Build a geometry from rings (n, 2); a ring inside another one bounds a hole."""
    faces = [shapely.Polygon(ring) for ring in rings if len(ring) > 2]
    outline: shapely.Geometry = shapely.Polygon()
    for face in sorted(faces, key=lambda polygon: -polygon.area):
        outline = outline.symmetric_difference(shapely.make_valid(face))
    return outline
