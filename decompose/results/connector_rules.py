"""Rules of pins and marks, checked on the drilled parts independently of the search for places."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.assembly import AssemblyStep
from decompose.connectors import (
    Blank,
    Connectors,
    Pin,
    Tool,
    build_polygons,
    find_pairs,
    list_rings,
    measure_distance_mm,
)
from decompose.errors import Rule
from decompose.geometry import Solid, choose_plane_axes
from decompose.pieces import Joint
from decompose.results.overhangs import measure_ceiling_mm2

EPS_MM3 = 1e-3  # maximum rounding error of an operation on solids
EPS_MM2, SPECK_MM2 = 0.005, 0.3  # maximum area of a layer's ceiling in a hole, and at crossing strokes
RIM_MM = 1.15  # minimum wall around a tool, and between two tools: the rim of the search less rounding
FILM_MM = 0.06  # depth below a face that is not checked, because of rounding
HOLE_DEG, GROOVE_DEG = 40.5, 48.0  # flattest ceilings, from the vertical; supports begin at 50
MOUTH_COS = -0.99  # maximum cosine between the normal of the mouth and the direction into the part
SWELL_MM = 0.005  # growth of the tools in the check that nothing else was removed
THIN_MM = 0.05  # minimum thickness of a real difference; thinner ones are errors at nearly coincident faces
KEY_END_MM = 0.25  # gap at each end of a key
KEY_RIM_MM = 0.75  # minimum wall around the groove of a key
ARC_SEGMENTS = 4  # number of sides of a polygon around a circle, for each quarter of it
COAXIAL_COS = 1.0 - 1e-9  # minimum cosine between two parallel directions
LEVEL_SIN = 1e-6  # maximum sine of the angle between a direction and the face that it lies in
FAR_MM = 2000.0  # distance beyond all parts
OPEN_MM = 1.0  # minimum gap of a joint if one of its bodies is rotated by 180 degrees


@dataclass(frozen=True, slots=True)
class ConnectorFault:
    """A rule that connectors break, and why; `part` is None if the pins of several parts break it."""

    rule: Rule
    part: int | None
    problem: str


@dataclass(frozen=True, slots=True)
class DrilledParts:
    """Parts before and after drilling, with their joints, steps and connectors."""

    blanks: Sequence[Blank]
    drilled: Sequence[Solid]
    joints: Sequence[Joint]
    steps: Sequence[AssemblyStep]
    connectors: Connectors
    taken_mm: Sequence[float] = ()

    def find_faults(self) -> Iterator[ConnectorFault]:
        """Check all rules, part by part, then pin by pin; yield the faults."""
        groups: dict[int, list[_Group]] = {}
        for group in self._list_groups():
            groups.setdefault(group.tools[0].part, []).append(group)
        for part, own in sorted(groups.items()):
            for rule, problem in self._check_part(part, own):
                yield ConnectorFault(rule, part, problem)
        for pin in self.connectors.pins:
            for rule, problem in self._check_pin(pin):
                yield ConnectorFault(rule, pin.holes[0].part, problem)
        for problem in find_wrong_fits(self.connectors.pins, self.taken_mm):
            yield ConnectorFault(Rule.PINNED, None, problem)

    def _list_groups(self) -> Iterator[_Group]:
        """Yield the tools of each hole, mark and gutter."""
        for pin in self.connectors.pins:
            for hole in pin.holes:
                kind, limit_deg = ("hole", HOLE_DEG) if pin.along is None else ("groove", GROOVE_DEG)
                yield _Group((hole,), self.joints[pin.joint], math.radians(limit_deg), kind)
        for mark in self.connectors.marks:
            yield _Group(mark.grooves, self.joints[mark.joint], math.radians(GROOVE_DEG), "mark")
        for gutter in self.connectors.gutters:
            yield _Group((gutter.groove,), self.joints[gutter.joint], math.radians(GROOVE_DEG), "gutter")

    def _check_part(self, part: int, groups: Sequence[_Group]) -> Iterator[tuple[Rule, str]]:
        """Check a part with its tools; yield the rules that are broken, and how."""
        undrilled, drilled = self.blanks[part].solid, self.drilled[part]
        tools = [Solid.union([Solid.hull(tool.points_mm) for tool in group.tools]) for group in groups]
        removed_solid = undrilled.subtract(drilled)
        added_mm3 = drilled.volume_mm3 - undrilled.volume_mm3 + removed_solid.volume_mm3
        if added_mm3 > EPS_MM3 and _is_thick(drilled.subtract(undrilled)):
            yield Rule.DRILLED, "material was added"
        if _is_thick(
            removed_solid.subtract(Solid.union([_swell_tool(t) for group in groups for t in group.tools]))
        ):
            yield Rule.DRILLED, "more was removed than the holes and marks"
        if len(drilled.list_pieces()) != 1:
            yield Rule.DRILLED, "it is no longer one piece"
        sleeves = Solid.union([group.build_sleeve() for group in groups if not group.has_exit])
        if sleeves.subtract(undrilled).volume_mm3 > EPS_MM3 or any(
            _is_thick(self._subtract_parts(group.build_sleeve())) for group in groups if group.has_exit
        ):
            yield Rule.SKIN, "the wall around a hole or mark is too thin"
        if any(not group.is_hidden(undrilled) for group in groups):
            yield Rule.SKIN, "a hole or mark is not inside its joint"
        if any(
            a.measure_gap_mm(b, RIM_MM) < RIM_MM - FILM_MM
            for a, b in combinations(tools, 2)
            if _is_near(a, b)
        ):
            yield Rule.SKIN, "two holes or marks are too close to each other"
        for group in groups:
            steepest = group.compute_overhang_rad(self.blanks[part].up)
            if steepest > group.limit_rad:
                yield Rule.SUPPORT_FREE, f"a {group.kind} overhangs by {math.degrees(steepest):.0f} degrees"
            if group.measure_ceiling_mm2(self.blanks[part].up) > group.speck_mm2:
                yield Rule.SUPPORT_FREE, f"the ceiling of a {group.kind} closes in one step"

    def _subtract_parts(self, solid: Solid) -> Solid:
        """Subtract all undrilled parts from a solid; the remainder is outside the model, or in a gap."""
        for blank in self.blanks:
            solid = solid if solid.is_empty else solid.subtract(blank.solid)
        return solid

    def _check_pin(self, pin: Pin) -> Iterator[tuple[Rule, str]]:
        """Check that a pin can be inserted; yield the rules that are broken, and how."""
        step = self.steps[pin.step]
        moved, fixed = pin.holes
        if (
            moved.part not in step.moved_parts
            or fixed.part not in step.fixed_parts
            or not _brings_into_holes(pin, step)
        ):
            yield Rule.ORDER, f"a pin of step {pin.step + 1} is not along its direction"
        if pin.along is not None and abs(float(pin.along @ moved.into)) > LEVEL_SIN:
            yield Rule.PINNED, f"a key of step {pin.step + 1} does not lie in its joint"
        rod = _make_rod(pin)
        for hole in pin.holes:
            if rod.intersect(self.drilled[hole.part]).volume_mm3 > EPS_MM3:
                yield Rule.PINNED, f"a pin of step {pin.step + 1} does not go into its hole"
            if hole.exit is None:
                continue
            path = _make_rod(pin, hole.exit)
            body = step.moved_parts if hole is moved else step.fixed_parts
            if any(path.intersect(self.drilled[part]).volume_mm3 > EPS_MM3 for part in body):
                yield Rule.ORDER, f"a key of step {pin.step + 1} does not slide into its groove"


def _brings_into_holes(pin: Pin, step: AssemblyStep) -> bool:
    """Check whether the direction of a step brings a pin into its holes.

    A key that slides has one groove with an exit: in the moved part against the direction, or in the fixed
    part along it.
    """
    moved, fixed = pin.holes
    if float(pin.axis @ step.direction) < COAXIAL_COS or float(-moved.into @ fixed.into) < COAXIAL_COS:
        return False
    exits = [None if hole.exit is None else float(hole.exit @ step.direction) for hole in pin.holes]
    if not pin.slides:
        return exits == [None, None] and float(moved.into @ step.direction) >= COAXIAL_COS
    return abs(float(moved.into @ step.direction)) < LEVEL_SIN and (
        (exits[1] is None and exits[0] is not None and exits[0] < -COAXIAL_COS)
        or (exits[0] is None and exits[1] is not None and exits[1] > COAXIAL_COS)
    )


def _make_rod(pin: Pin, exit_direction: Floats | None = None) -> Solid:
    """Build the body of a pin, or the space that it sweeps on its way out of a groove."""
    axis = pin.rod_axis if exit_direction is None else exit_direction
    circle = shapely.Point(pin.at_mm @ choose_plane_axes(axis).T).buffer(pin.diameter_mm / 2.0)
    middle_mm = float(pin.at_mm @ axis)
    far_mm = pin.length_mm / 2.0 if exit_direction is None else FAR_MM
    return _extrude_outline(circle, axis, middle_mm - pin.length_mm / 2.0, middle_mm + far_mm)


def find_wrong_fits(pins: Sequence[Pin], taken_mm: Sequence[float] = ()) -> list[str]:
    """Find pairs of pins that let a body fit if it is rotated by 180 degrees, or in the place of another one.

    Parameters
    ----------
    pins
        Pins of all steps, in order; the first two pins of a step locate its bodies.
    taken_mm
        Distances between the pins of steps that are drilled already.

    Returns
    -------
    list of str
        A clause for each fault.
    """
    faults = []
    pairs = find_pairs(pins)
    for step, (deep, shallow) in pairs.items():
        open_mm = deep.length_mm - deep.depth_mm - shallow.depth_mm
        if deep.along is None and shallow.along is None:
            is_open = open_mm >= OPEN_MM
        else:  # a key does not fit into a hole, nor a long key into a short groove
            is_open = (deep.along is None) != (shallow.along is None) or deep.length_mm > _measure_mouth_mm(
                shallow
            )
        if not is_open:
            faults.append(f"step {step + 1} can be turned by 180 degrees")
        if any(
            abs(measure_distance_mm(deep, shallow) - taken_distance_mm) <= 2.0 * _measure_play_mm(deep)
            for taken_distance_mm in taken_mm
        ):
            faults.append(f"a body of step {step + 1} fits a neighbour that is printed already")
    for (step, pair), (other, others) in combinations(pairs.items(), 2):
        play_mm = 2.0 * max(_measure_play_mm(pin) for pin in (*pair, *others))
        is_alike = [pin.along is None for pin in pair] == [pin.along is None for pin in others]
        if is_alike and abs(measure_distance_mm(*pair) - measure_distance_mm(*others)) <= play_mm:
            faults.append(f"bodies of the steps {step + 1} and {other + 1} fit each other")
    return faults


def _measure_mouth_mm(key: Pin) -> float:
    """Measure the length of the longer mouth of a key's two grooves."""
    return float(max(np.ptp(groove.points_mm @ key.rod_axis) for groove in key.holes))


def _measure_play_mm(pin: Pin) -> float:
    """Measure how far a pin can move across its holes, by the narrowest width of the wider hole."""
    if pin.along is not None:  # across it, between the sides of a V groove; along it, by its free ends
        return max(2.0 * KEY_END_MM, math.sqrt(2.0) * pin.depth_mm - pin.diameter_mm)
    across = choose_plane_axes(pin.axis)
    hulls = [shapely.MultiPoint((hole.points_mm - pin.at_mm) @ across.T).convex_hull for hole in pin.holes]
    inner_mm = max(shapely.Point(0.0, 0.0).distance(hull.exterior) for hull in hulls)
    return float(2.0 * inner_mm - pin.diameter_mm)


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Tools of one hole or mark.

    Attributes
    ----------
    tools, joint
        Tools, and the joint on whose faces they are.
    limit_rad
        Angle of the flattest allowed ceiling from the vertical.
    kind
        Kind in messages: hole, groove, mark or gutter.
    """

    tools: tuple[Tool, ...]
    joint: Joint
    limit_rad: float
    kind: str

    @property
    def speck_mm2(self) -> float:
        """Maximum area of a layer's ceiling; where strokes cross, specks without support are allowed."""
        return SPECK_MM2 if self.kind == "mark" else EPS_MM2

    def _draw_outline(self) -> shapely.Geometry:
        """Draw the outline of the tools on their face, with the wall around them."""
        across = choose_plane_axes(self.tools[0].into)
        hulls = [shapely.MultiPoint(tool.points_mm @ across.T).convex_hull for tool in self.tools]
        around_mm = self.rim_mm / math.cos(math.pi / 4.0 / ARC_SEGMENTS)  # so that the arc is inside
        return shapely.union_all(hulls).buffer(around_mm, quad_segs=ARC_SEGMENTS)

    @property
    def rim_mm(self) -> float:
        """Minimum wall around the tools."""
        return KEY_RIM_MM if self.kind == "groove" else RIM_MM

    def build_sleeve(self) -> Solid:
        """Build the tools with the wall around them, from just below the face."""
        first = self.tools[0]
        if self.kind == "groove":
            swollen = (first.points_mm[:, None] + self.rim_mm * _SPHERE).reshape(-1, 3)
            end_mm = float((swollen @ first.into).max())
            below = _extrude_outline(self._draw_outline(), first.into, first.face_mm + FILM_MM, end_mm)
            return Solid.hull(swollen).intersect(below)
        reach_mm = max(float((tool.points_mm @ first.into).max()) for tool in self.tools)
        return _extrude_outline(self._draw_outline(), first.into, first.face_mm + FILM_MM, reach_mm + RIM_MM)

    @property
    def has_exit(self) -> bool:
        """Check whether it is a groove that leaves its part through a second face."""
        return self.tools[0].exit is not None

    def is_hidden(self, undrilled: Solid) -> bool:
        """Check whether the mouths, with the rim that is inside the part, lie in a face of the joint."""
        into = self.tools[0].into
        across = choose_plane_axes(into)
        outline = self._draw_outline()
        if self.has_exit:
            wall = self.build_sleeve().intersect(undrilled)
            outline = build_polygons(wall.project(np.vstack([across, into])))
        for face in self.joint.faces:
            along = float(face.normal @ into)
            if abs(along) < COAXIAL_COS or abs(face.offset_mm * along - self.tools[0].face_mm) > 1e-6:
                continue
            placed = shapely.transform(
                face.outline,
                lambda flat, face=face: (flat @ face.axes + face.offset_mm * face.normal) @ across.T,
            )
            if placed.buffer(FILM_MM).contains(outline):
                return True
        return False

    def measure_ceiling_mm2(self, up: Floats) -> float:
        """Measure the area of a layer over the tools that needs support."""
        first = self.tools[0]
        tools = [tool.points_mm for tool in self.tools]
        return measure_ceiling_mm2(tools, first.into, first.face_mm, up, first.exit)

    def compute_overhang_rad(self, up: Floats) -> float:
        """Compute the angle of the flattest ceiling from the vertical, from the triangles of the tools."""
        steepest = -1.0
        for tool in self.tools:
            vertices, faces = Solid.hull(tool.points_mm).arrays()
            a, b, c = (vertices[faces[:, k]] for k in range(3))
            normals = np.cross(b - a, c - a)
            sizes = np.linalg.norm(normals, axis=1)
            normals = normals[sizes > 1e-6] / sizes[sizes > 1e-6, None]
            is_open = normals @ tool.into <= MOUTH_COS
            if tool.exit is not None:
                is_open |= normals @ tool.exit > COAXIAL_COS
            sides = normals[~is_open]
            steepest = max(steepest, float((sides @ up).max()))
        return math.asin(min(1.0, steepest))


_CORNERS = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
_SPHERE = _CORNERS[_CORNERS.any(axis=1)] / np.linalg.norm(_CORNERS[_CORNERS.any(axis=1)], axis=1)[:, None]
"""Points (26, 3) on the unit sphere."""


def _swell_tool(tool: Tool) -> Solid:
    """Build a slightly larger tool, because operations on solids fail where faces coincide."""
    offsets = tool.points_mm - tool.points_mm.mean(axis=0)
    return Solid.hull(tool.points_mm + SWELL_MM * offsets / np.linalg.norm(offsets, axis=1)[:, None])


def _is_thick(solid: Solid) -> bool:
    """Check whether a difference of two solids consists of more than films."""
    return solid.volume_mm3 > EPS_MM3 and any(
        piece.volume_mm3 > max(EPS_MM3, THIN_MM * piece.area_mm2 / 2.0) for piece in solid.list_pieces()
    )


def _is_near(a: Solid, b: Solid) -> bool:
    """Check whether the bounding boxes of two solids are closer than the minimum wall."""
    (a_low, a_high), (b_low, b_high) = a.bounds_mm, b.bounds_mm
    return bool((np.maximum(a_low, b_low) - np.minimum(a_high, b_high)).max() < RIM_MM)


def _extrude_outline(outline: shapely.Geometry, axis: Floats, from_mm: float, to_mm: float) -> Solid:
    """Extrude an outline across an axis (3,) between two coordinates along it."""
    return Solid.prism(list_rings(outline), np.vstack([choose_plane_axes(axis), axis]), from_mm, to_mm)
