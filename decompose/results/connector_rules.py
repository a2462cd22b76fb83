"""Rules of pins and marks, checked on the drilled parts independently of the search for places."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely

from decompose.arrays import Floats
from decompose.assembly import AssemblyStep
from decompose.connectors import (
    Blank,
    Connector,
    Connectors,
    Pin,
    find_pairs,
    measure_pair,
)
from decompose.errors import Rule
from decompose.geometry import Solid, choose_plane_axes
from decompose.options import PairShape
from decompose.pieces import Joint
from decompose.results.removed_material import EPS_MM3, find_other_changes, is_thick
from decompose.results.tool_groups import FILM_MM, PARALLEL_COS, RIM_MM, ToolGroup, extrude_outline

KEY_END_GAP_MM = 0.25  # gap at each end of a key
IN_PLANE_SIN = 1e-6  # maximum sine of the angle between a face and a direction that lies in it
OUTSIDE_DISTANCE_MM = 2000.0  # distance that is larger than any model
MIN_OPENING_MM = 1.0  # minimum gap that a joint must show if one of its bodies is rotated by 180 degrees


@dataclass(frozen=True, slots=True)
class ConnectorFault:
    """A rule that connectors break, and why.

    Attributes
    ----------
    rule, problem
        Rule, and words that describe the problem.
    part
        Number of the part that the connectors cut; None if pins of several parts break the rule.
    connector
        Connector whose removal mends the fault; None if that is not known.
    """

    rule: Rule
    part: int | None
    problem: str
    connector: Connector | None = None


@dataclass(frozen=True, slots=True)
class DrilledParts:
    """Parts before and after drilling, with their joints, steps and connectors."""

    blanks: Sequence[Blank]
    drilled_solids: Sequence[Solid]
    joints: Sequence[Joint]
    steps: Sequence[AssemblyStep]
    connectors: Connectors
    used_shapes: Sequence[PairShape] = ()

    def find_faults(self) -> Iterator[ConnectorFault]:
        """Check all rules, part by part, then pin by pin; yield the faults."""
        groups: dict[int, list[ToolGroup]] = {}
        for group in self._list_groups():
            groups.setdefault(group.tools[0].part, []).append(group)
        for part, part_groups in sorted(groups.items()):
            yield from self._check_part(part, part_groups)
        for pin in self.connectors.pins:
            for rule, problem in self._check_pin(pin):
                yield ConnectorFault(rule, pin.holes[0].part, problem, pin)
        for problem in find_wrong_fits(self.connectors.pins, self.used_shapes):
            yield ConnectorFault(Rule.PINS_UNAMBIGUOUS, None, problem)

    def _list_groups(self) -> Iterator[ToolGroup]:
        """Yield the tools of each hole, groove, mark and gutter as a group."""
        for pin in self.connectors.pins:
            kind = "hole" if pin.key_direction is None else "groove"
            for hole in pin.holes:
                yield ToolGroup((hole,), self.joints[pin.joint], kind, pin)
        for mark in self.connectors.marks:
            yield ToolGroup(mark.grooves, self.joints[mark.joint], "mark", mark)
        for gutter in self.connectors.gutters:
            yield ToolGroup((gutter.groove,), self.joints[gutter.joint], "gutter", gutter)

    def _check_part(self, part: int, groups: Sequence[ToolGroup]) -> Iterator[ConnectorFault]:
        """Check a drilled part; yield its faults."""
        undrilled_solid, drilled_solid = self.blanks[part].solid, self.drilled_solids[part]
        for problem in find_other_changes(
            undrilled_solid, drilled_solid, [tool for group in groups for tool in group.tools]
        ):
            yield ConnectorFault(Rule.ONLY_HOLES_REMOVED, part, problem)
        if len(drilled_solid.list_pieces()) != 1:
            yield ConnectorFault(Rule.ONLY_HOLES_REMOVED, part, "it is no longer one piece")
        faulty_groups = set()
        for group in self._find_thin_walls(undrilled_solid, groups):
            faulty_groups.add(group)
            problem = f"the wall around a {group.kind} is too thin"
            yield ConnectorFault(Rule.PIN_WALLS, part, problem, group.connector)
        for group in groups:
            for rule, problem in self._check_group(part, group):
                faulty_groups.add(group)
                yield ConnectorFault(rule, part, problem, group.connector)
        for a, b in combinations(groups, 2):
            if (
                faulty_groups.isdisjoint((a, b))
                and a.is_near(b)
                and a.solid.measure_gap_mm(b.solid, RIM_MM) < RIM_MM - FILM_MM
            ):
                faulty_groups.add(b)
                problem = f"a {a.kind} and a {b.kind} are too close to each other"
                yield ConnectorFault(Rule.PIN_WALLS, part, problem, b.connector)

    def _find_thin_walls(self, undrilled_solid: Solid, groups: Sequence[ToolGroup]) -> Iterator[ToolGroup]:
        """Find the tools of a part around which the wall is too thin."""
        closed_groups = [group for group in groups if not group.has_exit]
        sleeves = [group.build_sleeve() for group in closed_groups]
        if Solid.union(sleeves).subtract(undrilled_solid).volume_mm3 > EPS_MM3:  # rare, so all together first
            outside_mm3 = [sleeve.subtract(undrilled_solid).volume_mm3 for sleeve in sleeves]
            least_mm3 = min(EPS_MM3 / len(sleeves), max(outside_mm3))
            for group, group_mm3 in zip(closed_groups, outside_mm3, strict=True):
                if group_mm3 >= least_mm3:
                    yield group
        for group in groups:
            if group.has_exit and is_thick(self._subtract_parts(group.build_sleeve())):
                yield group

    def _check_group(self, part: int, group: ToolGroup) -> Iterator[tuple[Rule, str]]:
        """Check the tools of one connector; yield each broken rule, and words that describe the problem."""
        undrilled_solid, up_direction = self.blanks[part].solid, self.blanks[part].up_direction
        if not group.is_hidden(undrilled_solid):
            yield Rule.PIN_WALLS, f"a {group.kind} is not inside its joint"
        overhang_rad = group.compute_overhang_rad(up_direction)
        if overhang_rad > group.max_overhang_rad:
            yield Rule.SUPPORT_FREE, f"a {group.kind} overhangs by {math.degrees(overhang_rad):.0f} degrees"
        if group.measure_ceiling_mm2(up_direction) > group.max_ceiling_mm2:
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
    return extrude_outline(circle, axis, middle_mm - pin.length_mm / 2.0, middle_mm + front_mm)


def find_wrong_fits(pins: Sequence[Pin], used_shapes: Sequence[PairShape] = ()) -> list[str]:
    """Find pairs of pins that also let a body fit when it is rotated by 180 degrees, or in a wrong place.

    Parameters
    ----------
    pins
        Pins of all steps, in order; the first two pins of a step align its bodies.
    used_shapes
        Shapes of the pairs in existing parts (`ConnectorOptions.used_shapes`).

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
        if any(_fits((deep, shallow), shape, 2.0 * _measure_play_mm(deep)) for shape in used_shapes):
            faults.append(f"a body of step {step + 1} fits a neighbour that is printed already")
    for (step, pair), (other_step, other_pair) in combinations(pairs.items(), 2):
        play_mm = 2.0 * max(_measure_play_mm(pin) for pin in (*pair, *other_pair))
        if _fits(pair, measure_pair(*other_pair), play_mm):
            faults.append(f"bodies of steps {step + 1} and {other_step + 1} fit each other")
    return faults


def _fits(pair: tuple[Pin, Pin], other: PairShape, play_mm: float) -> bool:
    """Check whether a pair fits the holes of another one, also if these are seen from the other side.

    A key fits a groove at an angle if its ends are beside the groove by no more than its play across.
    """
    shape = measure_pair(*pair)
    if abs(shape.distance_mm - other.distance_mm) > play_mm:
        return False
    deviations_mm = []
    for pin, angle, other_angle, length_mm in zip(
        pair, shape.angles, other.angles, other.lengths_mm, strict=True
    ):
        if (angle is None) != (other_angle is None):
            return False
        if angle is not None and other_angle is not None:
            across_mm = 2.0 * (math.sqrt(2.0) * pin.depth_mm - pin.diameter_mm)
            deviations_mm.append(
                [
                    min(pin.length_mm, length_mm) / 2.0 * abs(math.sin(angle - sign * other_angle))
                    - across_mm
                    for sign in (1.0, -1.0)
                ]
            )
    return not deviations_mm or any(max(ends_mm) <= 0.0 for ends_mm in zip(*deviations_mm, strict=True))


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
