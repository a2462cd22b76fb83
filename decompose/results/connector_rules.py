"""Rules of pins and marks, checked on the drilled parts independently of the search for places."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
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
from decompose.results.removed_material import EPS_MM3, find_other_changes, is_thick

# Maximum area in one layer, in the ceiling of a tool, that may be left without support: in a hole or groove,
# and where strokes of a mark cross. The ceiling of a tool consists of the sides that overhang it.
EPS_MM2, SPECK_MM2 = 0.005, 0.3
# Minimum wall around a tool, and between two tools. The search for places keeps a slightly thicker wall
# (`connectors.records.RIM_MM`).
RIM_MM = 1.15
FILM_MM = 0.06  # depth below a face down to which nothing is checked, because of rounding errors
# Maximum angles between a ceiling and the vertical; the slicer supports ceilings of 50 degrees or more.
MAX_HOLE_DEG, MAX_GROOVE_DEG = 40.5, 48.0
MAX_MOUTH_COS = -0.99  # maximum cosine between the normal of the mouth and the direction into the part
KEY_END_GAP_MM = 0.25  # gap at each end of a key
KEY_RIM_MM = 0.75  # minimum wall around the groove of a key
ARC_SEGMENTS = 4  # number of sides of a polygon around a circle, for each quarter of it
PARALLEL_COS = 1.0 - 1e-9  # minimum cosine between two parallel directions
IN_PLANE_SIN = 1e-6  # maximum sine of the angle between a face and a direction that lies in it
OUTSIDE_DISTANCE_MM = 2000.0  # distance that is larger than any model
MIN_OPENING_MM = 1.0  # minimum gap that a joint must show if one of its bodies is rotated by 180 degrees


@dataclass(frozen=True, slots=True)
class ConnectorFault:
    """A rule that connectors of a part break, and why; `part` is None if pins of several parts break it."""

    rule: Rule
    part: int | None
    problem: str


@dataclass(frozen=True, slots=True)
class DrilledParts:
    """Parts before and after drilling, with their joints, steps and connectors."""

    blanks: Sequence[Blank]
    drilled_solids: Sequence[Solid]
    joints: Sequence[Joint]
    steps: Sequence[AssemblyStep]
    connectors: Connectors
    used_distances_mm: Sequence[float] = ()

    def find_faults(self) -> Iterator[ConnectorFault]:
        """Check all rules, part by part, then pin by pin; yield the faults."""
        groups: dict[int, list[_ToolGroup]] = {}
        for group in self._list_groups():
            groups.setdefault(group.tools[0].part, []).append(group)
        for part, part_groups in sorted(groups.items()):
            for rule, problem in self._check_part(part, part_groups):
                yield ConnectorFault(rule, part, problem)
        for pin in self.connectors.pins:
            for rule, problem in self._check_pin(pin):
                yield ConnectorFault(rule, pin.holes[0].part, problem)
        for problem in find_wrong_fits(self.connectors.pins, self.used_distances_mm):
            yield ConnectorFault(Rule.PINS_UNAMBIGUOUS, None, problem)

    def _list_groups(self) -> Iterator[_ToolGroup]:
        """Yield the tools of each hole, groove, mark and gutter as a group."""
        for pin in self.connectors.pins:
            for hole in pin.holes:
                kind, max_overhang_deg = (
                    ("hole", MAX_HOLE_DEG) if pin.key_direction is None else ("groove", MAX_GROOVE_DEG)
                )
                yield _ToolGroup((hole,), self.joints[pin.joint], math.radians(max_overhang_deg), kind)
        for mark in self.connectors.marks:
            yield _ToolGroup(mark.grooves, self.joints[mark.joint], math.radians(MAX_GROOVE_DEG), "mark")
        for gutter in self.connectors.gutters:
            yield _ToolGroup(
                (gutter.groove,), self.joints[gutter.joint], math.radians(MAX_GROOVE_DEG), "gutter"
            )

    def _check_part(self, part: int, groups: Sequence[_ToolGroup]) -> Iterator[tuple[Rule, str]]:
        """Check a drilled part; yield each broken rule, and words that describe the problem."""
        undrilled_solid, drilled_solid = self.blanks[part].solid, self.drilled_solids[part]
        for problem in find_other_changes(
            undrilled_solid, drilled_solid, [tool for group in groups for tool in group.tools]
        ):
            yield Rule.ONLY_HOLES_REMOVED, problem
        if len(drilled_solid.list_pieces()) != 1:
            yield Rule.ONLY_HOLES_REMOVED, "it is no longer one piece"
        sleeves = Solid.union([group.build_sleeve() for group in groups if not group.has_exit])
        if sleeves.subtract(undrilled_solid).volume_mm3 > EPS_MM3 or any(
            is_thick(self._subtract_parts(group.build_sleeve())) for group in groups if group.has_exit
        ):
            yield Rule.PIN_WALLS, "the wall around a hole or mark is too thin"
        if any(not group.is_hidden(undrilled_solid) for group in groups):
            yield Rule.PIN_WALLS, "a hole or mark is not inside its joint"
        if any(
            a.solid.measure_gap_mm(b.solid, RIM_MM) < RIM_MM - FILM_MM
            for a, b in combinations(groups, 2)
            if a.is_near(b)
        ):
            yield Rule.PIN_WALLS, "two holes or marks are too close to each other"
        for group in groups:
            overhang_rad = group.compute_overhang_rad(self.blanks[part].up_direction)
            if overhang_rad > group.max_overhang_rad:
                yield (
                    Rule.SUPPORT_FREE,
                    f"a {group.kind} overhangs by {math.degrees(overhang_rad):.0f} degrees",
                )
            if group.measure_ceiling_mm2(self.blanks[part].up_direction) > group.max_ceiling_mm2:
                yield Rule.SUPPORT_FREE, f"the ceiling of a {group.kind} needs support"

    def _subtract_parts(self, solid: Solid) -> Solid:
        """Subtract all undrilled parts from a solid; the rest lies outside the model or between two parts."""
        for blank in self.blanks:
            solid = solid if solid.is_empty else solid.subtract(blank.solid)
        return solid

    def _check_pin(self, pin: Pin) -> Iterator[tuple[Rule, str]]:
        """Check that a pin can be inserted; yield each broken rule, and words that describe the problem."""
        step = self.steps[pin.step]
        moved, fixed = pin.holes
        if (
            moved.part not in step.moved_parts
            or fixed.part not in step.fixed_parts
            or not _inserts_pin(pin, step)
        ):
            yield (
                Rule.PIN_DIRECTIONS,
                f"a pin of step {pin.step + 1} is not parallel to the movement of the step",
            )
        if (
            pin.key_direction is not None
            and abs(float(pin.key_direction @ moved.inward_normal)) > IN_PLANE_SIN
        ):
            yield Rule.PINS_UNAMBIGUOUS, f"a key of step {pin.step + 1} does not lie in its joint"
        rod = _build_rod(pin)
        for hole in pin.holes:
            if rod.intersect(self.drilled_solids[hole.part]).volume_mm3 > EPS_MM3:
                yield Rule.PINS_UNAMBIGUOUS, f"a pin of step {pin.step + 1} does not go into its hole"
            if hole.exit_direction is None:
                continue
            path = _build_rod(pin, hole.exit_direction)
            body = step.moved_parts if hole is moved else step.fixed_parts
            if any(path.intersect(self.drilled_solids[part]).volume_mm3 > EPS_MM3 for part in body):
                yield Rule.PIN_DIRECTIONS, f"a key of step {pin.step + 1} does not slide into its groove"


def _inserts_pin(pin: Pin, step: AssemblyStep) -> bool:
    """Check whether a movement along the direction of a step inserts a pin into its holes.

    Exactly one groove of a sliding key has an exit. It points against the direction if the groove is in the
    moved part, and along the direction if the groove is in the fixed part.
    """
    moved, fixed = pin.holes
    if (
        float(pin.axis @ step.direction) < PARALLEL_COS
        or float(-moved.inward_normal @ fixed.inward_normal) < PARALLEL_COS
    ):
        return False
    exits = [
        None if hole.exit_direction is None else float(hole.exit_direction @ step.direction)
        for hole in pin.holes
    ]
    if not pin.slides:
        return exits == [None, None] and float(moved.inward_normal @ step.direction) >= PARALLEL_COS
    return abs(float(moved.inward_normal @ step.direction)) < IN_PLANE_SIN and (
        (exits[1] is None and exits[0] is not None and exits[0] < -PARALLEL_COS)
        or (exits[0] is None and exits[1] is not None and exits[1] > PARALLEL_COS)
    )


def _build_rod(pin: Pin, exit_direction: Floats | None = None) -> Solid:
    """Build the body of a pin, or the space that it sweeps on its way out of a groove."""
    axis = pin.rod_axis if exit_direction is None else exit_direction
    circle = shapely.Point(pin.position_mm @ choose_plane_axes(axis).T).buffer(pin.diameter_mm / 2.0)
    middle_mm = float(pin.position_mm @ axis)
    front_mm = pin.length_mm / 2.0 if exit_direction is None else OUTSIDE_DISTANCE_MM
    return _extrude_outline(circle, axis, middle_mm - pin.length_mm / 2.0, middle_mm + front_mm)


def find_wrong_fits(pins: Sequence[Pin], used_distances_mm: Sequence[float] = ()) -> list[str]:
    """Find pairs of pins that also let a body fit when it is rotated by 180 degrees, or in a wrong place.

    Parameters
    ----------
    pins
        Pins of all steps, in order; the first two pins of a step align its bodies.
    used_distances_mm
        Distances between the two pins of each pair in existing parts (`ConnectorOptions.used_distances_mm`).

    Returns
    -------
    list of str
        A phrase that describes each fault.
    """
    faults = []
    pairs = find_pairs(pins)
    for step, (deep, shallow) in pairs.items():
        open_mm = deep.length_mm - deep.depth_mm - shallow.depth_mm
        if deep.key_direction is None and shallow.key_direction is None:
            is_open = open_mm >= MIN_OPENING_MM
        else:  # a key does not fit into a hole, nor a long key into a short groove
            is_open = (deep.key_direction is None) != (
                shallow.key_direction is None
            ) or deep.length_mm > _measure_mouth_mm(shallow)
        if not is_open:
            faults.append(f"a body of step {step + 1} fits if it is rotated by 180 degrees")
        if any(
            abs(measure_distance_mm(deep, shallow) - used_distance_mm) <= 2.0 * _measure_play_mm(deep)
            for used_distance_mm in used_distances_mm
        ):
            faults.append(f"a body of step {step + 1} fits a neighbour that is printed already")
    for (step, pair), (other_step, other_pair) in combinations(pairs.items(), 2):
        play_mm = 2.0 * max(_measure_play_mm(pin) for pin in (*pair, *other_pair))
        is_alike = [pin.key_direction is None for pin in pair] == [
            pin.key_direction is None for pin in other_pair
        ]
        if is_alike and abs(measure_distance_mm(*pair) - measure_distance_mm(*other_pair)) <= play_mm:
            faults.append(f"bodies of steps {step + 1} and {other_step + 1} fit each other")
    return faults


def _measure_mouth_mm(key: Pin) -> float:
    """Measure the length of the mouths of a key's two grooves; return the longer one."""
    return float(max(np.ptp(groove.points_mm @ key.rod_axis) for groove in key.holes))


def _measure_play_mm(pin: Pin) -> float:
    """Measure the play of a pin in its wider hole, or of a key in its grooves."""
    if pin.key_direction is not None:  # the larger of the play along the key and that across it
        return max(2.0 * KEY_END_GAP_MM, math.sqrt(2.0) * pin.depth_mm - pin.diameter_mm)
    across = choose_plane_axes(pin.axis)
    hulls = [
        shapely.MultiPoint((hole.points_mm - pin.position_mm) @ across.T).convex_hull for hole in pin.holes
    ]
    inner_mm = max(shapely.Point(0.0, 0.0).distance(hull.exterior) for hull in hulls)
    return float(2.0 * inner_mm - pin.diameter_mm)


@dataclass(frozen=True, eq=False)  # without slots, because of its cached properties
class _ToolGroup:
    """Tools of one hole, groove, mark or gutter.

    Attributes
    ----------
    tools, joint
        Tools, and the joint on whose faces they are.
    max_overhang_rad
        Maximum angle between a ceiling and the vertical.
    kind
        Word for the group in messages: hole, groove, mark or gutter.
    """

    tools: tuple[Tool, ...]
    joint: Joint
    max_overhang_rad: float
    kind: str

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

    def is_near(self, other: _ToolGroup) -> bool:
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
            below = _extrude_outline(
                self._outline, first.inward_normal, first.face_offset_mm + FILM_MM, end_mm
            )
            return Solid.hull(enlarged_points_mm).intersect(below)
        end_mm = max(float((tool.points_mm @ first.inward_normal).max()) for tool in self.tools) + RIM_MM
        return _extrude_outline(self._outline, first.inward_normal, first.face_offset_mm + FILM_MM, end_mm)

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


def _extrude_outline(outline: shapely.Geometry, axis: Floats, start_mm: float, end_mm: float) -> Solid:
    """Extrude an outline along an axis (3,), between two coordinates on that axis."""
    return Solid.prism(list_rings(outline), np.vstack([choose_plane_axes(axis), axis]), start_mm, end_mm)
