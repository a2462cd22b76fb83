"""Areas on the faces of joints in which a hole or groove can open and stay inside its part."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.connectors.records import RIM_MM, Tool
from decompose.geometry import Solid, choose_plane_axes, compute_cross_product
from decompose.options import PIN_FIT_MM
from decompose.pieces import Joint, JointFace, list_polygons

# Depth below a face down to which the gaps, the space outside the part, are cached; few tools are deeper.
SLAB_DEPTH_MM = 8.0
# Depth at which the search for gaps begins: at the face itself, rounding errors leave thin films.
FILM_DEPTH_MM = 0.05
# Minimum sine of the angle between the vertical and a face that counts as level: more than 30 degrees.
LEVEL_SIN = 0.5

_SideKey = tuple[int, int]  # number of a part, and identity of one of its faces


@dataclass(frozen=True, slots=True, eq=False)
class Blank:
    """A part before its holes are cut.

    Attributes
    ----------
    name
        Short name of the part, which is engraved on its faces.
    solid
        Solid in the frame of the joints, in mm.
    up_direction
        (3,) unit vector upwards from the bed in the part's pose, in the same frame.
    pin_fit_mm
        Clearance of pins in the part's holes: width of a hole across flats minus the diameter of the pin.
    right_direction
        (3,) unit vector along the X axis of the bed in the part's pose; None if any direction will do.
    """

    name: str
    solid: Solid
    up_direction: Floats
    pin_fit_mm: float = PIN_FIT_MM
    right_direction: Floats | None = None

    def project_onto_bed(self, points_mm: Floats) -> Floats:
        """Compute the bed coordinates (n, 2) in mm of points (n, 3), relative to an arbitrary origin."""
        if self.right_direction is None:
            return points_mm @ choose_plane_axes(self.up_direction).T
        forwards = compute_cross_product(self.up_direction, self.right_direction)
        return points_mm @ np.stack([self.right_direction, forwards]).T


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """A face of a joint as seen from one of its two parts.

    Attributes
    ----------
    part
        Number of the part.
    joint
        Number of the joint.
    face
        Face of the joint.
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

    def project_onto_face(self, points_mm: Floats) -> Floats:
        """Compute the coordinates (..., 2) in mm, in the plane of the face, of points (..., 3)."""
        return points_mm @ self.face.axes.T

    def compute_points_mm(self, coordinates_mm: Floats) -> Floats:
        """Compute the points (..., 3) of the face that have these coordinates (..., 2) in its plane."""
        return coordinates_mm @ self.face.axes + self.face.offset_mm * self.face.normal


def find_sides(blanks: Sequence[Blank], number: int, joint: Joint) -> list[tuple[Side, Side]]:
    """Find both sides of each face of a joint; leave out faces whose plane passes through one of the parts.

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
            signs.append(1.0 if low_mm > -FILM_DEPTH_MM else -1.0 if high_mm < FILM_DEPTH_MM else 0.0)
        if signs[0] * signs[1] < 0.0:
            sides.append((Side(joint.a, number, face, signs[0]), Side(joint.b, number, face, signs[1])))
    return sides


@dataclass(frozen=True, slots=True, eq=False)
class _Footprint:
    """Least and greatest depth of a tool below a face, and its outlines on the face.

    The key of an outline is the distance in mm by which it is widened.
    """

    min_depth_mm: float
    max_depth_mm: float
    outlines: dict[float, shapely.Geometry]

    def widen_outline(self, distance_mm: float) -> shapely.Geometry:
        """Widen the outline by a distance on all sides; cached."""
        if distance_mm not in self.outlines:
            self.outlines[distance_mm] = self.outlines[0.0].buffer(distance_mm)
        return self.outlines[distance_mm]


@dataclass(slots=True)
class Workpieces:
    """Parts, with the tools placed so far, and the remaining areas for other tools.

    Each face is queried about a hundred times, so areas are cached; a query subtracts only the tools that
    were placed since the previous query.
    """

    blanks: Sequence[Blank]
    _tools: list[list[Tool]] = field(init=False)
    _change_counts: list[int] = field(init=False)
    _footprints: dict[_SideKey, list[_Footprint]] = field(default_factory=dict)
    _gaps: dict[_SideKey, Solid] = field(default_factory=dict)
    _solid_areas: dict[tuple[_SideKey, float], shapely.Geometry] = field(default_factory=dict)
    _free_areas: dict[tuple[_SideKey, float, float], tuple[int, shapely.Geometry]] = field(
        default_factory=dict
    )

    def __post_init__(self) -> None:
        self._tools = [[] for _ in self.blanks]
        self._change_counts = [0] * len(self.blanks)

    def add_tools(self, tools: Iterable[Tool]) -> None:
        """Add tools to their parts; later tools have to avoid them."""
        for tool in tools:
            self._tools[tool.part].append(tool)
            self._change_counts[tool.part] += 1

    def remove_tools(self, tools: Iterable[Tool]) -> None:
        """Remove tools from their parts."""
        for tool in tools:
            self._tools[tool.part].remove(tool)
            self._change_counts[tool.part] += 1
            self._footprints = {key: f for key, f in self._footprints.items() if key[0] != tool.part}
            self._free_areas = {key: a for key, a in self._free_areas.items() if key[0][0] != tool.part}

    def count_changes(self, part: int) -> int:
        """Count the changes of a part's tools: an area is valid as long as this count is the same."""
        return self._change_counts[part]

    def is_level(self, side: Side | Tool) -> bool:
        """Check whether a face counts as level in its part's pose; grooves in such a face print slowly."""
        return abs(float(side.inward_normal @ self.blanks[side.part].up_direction)) > LEVEL_SIN

    def find_tool_area(self, side: Side, depth_mm: float) -> shapely.Geometry:
        """Find the area of a face below which there is enough solid material for a tool, and no other tool.

        Parameters
        ----------
        side, depth_mm
            Side of the face, and depth of the tool; the material has to be deeper by `RIM_MM`.

        Returns
        -------
        shapely.Geometry
            Area in the coordinates of the face. A tool has to keep a distance of `RIM_MM` from its border.
        """
        return self.find_solid_area(side, depth_mm + RIM_MM)

    def find_solid_area(self, side: Side, depth_mm: float, rim_mm: float = RIM_MM) -> shapely.Geometry:
        """Find the area of a face below which there is solid material down to a depth, and no other tool.

        Parameters
        ----------
        side, depth_mm
            Side of the face, and depth of the tool plus the rim below it.
        rim_mm
            Distance that the tool will keep from the border of the area. In any case, its distance from other
            tools will be `RIM_MM` or more.
        """
        key = (_get_key(side), round(depth_mm, 3), rim_mm)
        count, area = self._free_areas.get(key) or (0, self._find_solid_area(side, depth_mm))
        footprints = self._list_footprints(side)
        for footprint in footprints[count:]:
            if footprint.min_depth_mm < depth_mm + RIM_MM - rim_mm and footprint.max_depth_mm > -RIM_MM:
                area = area - footprint.widen_outline(max(0.0, RIM_MM - rim_mm))
        self._free_areas[key] = len(footprints), area
        return area

    def _list_footprints(self, side: Side) -> list[_Footprint]:
        """List the footprints of all tools of a part on one of its faces."""
        footprints = self._footprints.setdefault(_get_key(side), [])
        for tool in self._tools[side.part][len(footprints) :]:
            depths_mm = tool.points_mm @ side.inward_normal - side.sign * side.face.offset_mm
            outline = shapely.MultiPoint(side.project_onto_face(tool.points_mm)).convex_hull
            footprints.append(_Footprint(float(depths_mm.min()), float(depths_mm.max()), {0.0: outline}))
        return footprints

    def _find_solid_area(self, side: Side, depth_mm: float) -> shapely.Geometry:
        """Find the area of a face below which a part without its tools is solid down to a depth; cached."""
        key = (_get_key(side), round(depth_mm, 3))
        if key not in self._solid_areas:
            outline = side.face.outline
            gaps = self._find_gaps(side, depth_mm)
            frame = np.vstack([side.face.axes, side.face.normal])
            self._solid_areas[key] = (
                outline if gaps.is_empty else outline - build_polygons(gaps.project(frame))
            )
        return self._solid_areas[key]

    def _find_gaps(self, side: Side, depth_mm: float) -> Solid:
        """Find the gaps below a face, down to a depth: the space outside the solid.

        The part may have many triangles, so it is cut only once for each face; later queries cut the gaps
        that were found then.
        """
        solid = self.blanks[side.part].solid
        if depth_mm > SLAB_DEPTH_MM:
            return _build_slab(side, depth_mm).subtract(solid)
        key = _get_key(side)
        if key not in self._gaps:
            self._gaps[key] = _build_slab(side, SLAB_DEPTH_MM).subtract(solid)
        return self._gaps[key].keep_below(side.inward_normal, side.sign * side.face.offset_mm + depth_mm)


def _get_key(side: Side) -> _SideKey:
    """Get the key of a side, with the `id` of its face: faces exist longer than the workpieces."""
    return side.part, id(side.face)


def _build_slab(side: Side, depth_mm: float) -> Solid:
    """Build the solid with the outline of a face, between just below the face and a depth below it."""
    frame = np.vstack([side.face.axes, side.face.normal])
    ends_mm = side.face.offset_mm + side.sign * np.array([FILM_DEPTH_MM, depth_mm])
    return Solid.prism(list_rings(side.face.outline), frame, float(ends_mm.min()), float(ends_mm.max()))


def erode_area(area: shapely.Geometry, shape: shapely.Polygon) -> shapely.Geometry:
    """Erode an area by a convex shape: find the positions of its origin at which it is inside the area.

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
