"""Order of assembly: a tree of steps, each of which joins two bodies along one direction.

A body is a single part, or several parts that are already glued. The search begins with the complete assembly
and takes it apart: a set of parts is split into two sets that can be moved apart along an axis, until only
single parts remain. If possible, each of the two sets is held together by glue. The steps of the assembly are
these splits in reverse order.
A partition into boxes of one frame can always be split in this way. In other partitions, there may be sets
that cannot be split; they are reported as `Assembly.locked_sets`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from decompose.arrays import Bools, Floats
from decompose.assembly.blocking import find_axes, find_blocking
from decompose.assembly.resting import MassProperties, find_resting_parts
from decompose.assembly.schedule import StepWork, compute_critical_path_s, order_steps
from decompose.assembly.splits import Glue, Split, SplitSearch
from decompose.options import MIN_GLUE_MM2
from decompose.pieces import CutSolid, Joint


@dataclass(frozen=True, slots=True, eq=False)
class AssemblyStep:
    """A step that joins two bodies; parts and joints are given by their numbers.

    Attributes
    ----------
    moved_parts, fixed_parts
        Parts of the body that is moved, and of the body to which it is joined.
    direction
        (3,) unit vector in the model's frame, opposite to the movement of the moved body.
    joints
        Joints that are glued; empty if a loose body is only inserted.
    glue_mm2
        Area of these joints.
    slides
        Whether some of the glued faces slide over each other while the joint closes.
    rests_on
        Parts on which the fixed body stands while `direction` points up; empty if it must be held.
    level
        One more than the highest level of the steps that make the two bodies. The glue of all steps of a
        level can dry at the same time.
    work_s, start_s
        Time that a person needs for the step, and the time from the start of the first step to the start of
        this one if one person does all the work.
    """

    moved_parts: tuple[int, ...]
    fixed_parts: tuple[int, ...]
    direction: Floats
    joints: tuple[int, ...]
    glue_mm2: float
    slides: bool
    rests_on: tuple[int, ...]
    level: int
    work_s: float = 0.0
    start_s: float = 0.0

    @property
    def work(self) -> StepWork:
        """Quantities that determine the work time of the step."""
        bodies = frozenset(self.moved_parts), frozenset(self.fixed_parts)
        return StepWork(bodies, len(self.joints), self.glue_mm2, bool(self.rests_on))


@dataclass(frozen=True, slots=True)
class Assembly:
    """Order of assembly.

    Attributes
    ----------
    steps
        Steps in the order of work, each after the steps that make its bodies.
    locked_sets
        Sets of parts that cannot be taken apart by straight movements, so that no step joins them.
    """

    steps: tuple[AssemblyStep, ...] = ()
    locked_sets: tuple[tuple[int, ...], ...] = ()

    @property
    def level_count(self) -> int:
        """Number of steps on the longest chain in which each step waits for the glue of the one before."""
        return max((step.level for step in self.steps), default=0)

    @property
    def total_s(self) -> float:
        """Time until the end of the last step if one person does all the work, with waits for glue to dry."""
        return max((step.start_s + step.work_s for step in self.steps), default=0.0)

    @property
    def critical_path_s(self) -> float:
        """Minimum time with enough people: the longest chain of work and drying."""
        return compute_critical_path_s([step.work for step in self.steps])

    @property
    def part_order(self) -> tuple[int, ...]:
        """Parts in the order in which the steps use them; parts without a step are left out."""
        return tuple(
            dict.fromkeys(part for step in self.steps for part in (*step.fixed_parts, *step.moved_parts))
        )


def plan_assembly(
    pieces: Sequence[CutSolid], joints: Sequence[Joint], min_glue_mm2: float = MIN_GLUE_MM2
) -> Assembly:
    """Plan the order in which parts are joined.

    Parameters
    ----------
    pieces
        Parts in one frame, cut at planes.
    joints
        Joints from `pieces.find_joints`, in the same frame.
    min_glue_mm2
        Minimum area of a joint whose glue counts as holding.

    Returns
    -------
    Assembly
        Steps of the assembly; none for a single part.
    """
    if len(pieces) < 2:
        return Assembly()
    planner = _AssemblyPlanner(pieces, joints, min_glue_mm2)
    planner.split_parts(np.ones(len(pieces), dtype=np.bool_), is_unattached=True)
    step_works = [step.work for step in planner.steps]
    steps = (
        replace(planner.steps[number], work_s=step_works[number].work_s, start_s=start_s)
        for number, start_s in order_steps(step_works)
    )
    return Assembly(tuple(steps), tuple(planner.locked_sets))


class _AssemblyPlanner:
    """Planner that takes the parts apart, with the steps that it has found so far."""

    def __init__(self, pieces: Sequence[CutSolid], joints: Sequence[Joint], min_glue_mm2: float) -> None:
        count = len(pieces)
        axes = find_axes(pieces, joints)
        self.steps: list[AssemblyStep] = []
        self.locked_sets: list[tuple[int, ...]] = []
        self._joints = joints
        self._mass_properties = [MassProperties.from_solid(piece.solid) for piece in pieces]
        self._volumes_mm3 = np.array([properties.volume_mm3 for properties in self._mass_properties])
        heights_mm = [properties.points_mm @ axes.T for properties in self._mass_properties]
        low_mm, high_mm = (
            np.array([bound(height_mm, axis=0) for height_mm in heights_mm]).T for bound in (np.min, np.max)
        )
        self._search = SplitSearch(
            Glue.from_joints(count, joints, axes, min_glue_mm2),
            np.concatenate([axes, -axes]),
            find_blocking([piece.solid for piece in pieces], axes),
            np.concatenate([low_mm, -high_mm]),
            np.concatenate([high_mm, -low_mm]),
        )

    def split_parts(self, parts: Bools, *, is_unattached: bool) -> int:
        """Split a set of parts into single parts, append the steps, and return the level of the last step.

        Parameters
        ----------
        parts
            (n,) bool, true for the parts of the set.
        is_unattached
            Whether no part outside the set is glued to it; if so, loose bodies in the set need no step.
        """
        if parts.sum() < 2:
            return 0
        split = self._search.find_split(parts)
        if split is None:
            self.locked_sets.append(_list_numbers(parts))
            return 0
        is_loose = not self._search.glue.measure_glued_area_mm2(split)
        sides = sorted((split.is_moved, split.is_fixed), key=lambda side: int(side.sum()))
        level = 1 + max(self.split_parts(side, is_unattached=is_unattached and is_loose) for side in sides)
        if not (is_loose and is_unattached):
            self.steps.append(self._build_step(split, level))
        return level

    def _build_step(self, split: Split, level: int) -> AssemblyStep:
        """Build the step of a split.

        The lighter body is moved, unless it is the only one of the two that stands on the table with the
        joint facing up.
        """
        moved, fixed = split.is_moved, split.is_fixed
        direction = self._search.directions[split.direction_number]
        resting_parts = find_resting_parts(self._mass_properties, _list_numbers(fixed), direction)
        other_resting_parts = find_resting_parts(self._mass_properties, _list_numbers(moved), -direction)
        is_fixed_lighter = float(self._volumes_mm3[moved].sum()) > float(self._volumes_mm3[fixed].sum())
        if bool(other_resting_parts) > bool(resting_parts) or (
            is_fixed_lighter and bool(other_resting_parts) == bool(resting_parts)
        ):
            moved, fixed, direction, resting_parts = fixed, moved, -direction, other_resting_parts
        crosses_split = np.outer(moved, fixed)
        return AssemblyStep(
            moved_parts=_list_numbers(moved),
            fixed_parts=_list_numbers(fixed),
            direction=direction,
            joints=tuple(
                k
                for k, joint in enumerate(self._joints)
                if crosses_split[joint.a, joint.b] or crosses_split[joint.b, joint.a]
            ),
            glue_mm2=self._search.glue.measure_glued_area_mm2(split),
            slides=not self._search.glue.is_closing(split),
            rests_on=resting_parts,
            level=level,
        )


def _list_numbers(parts: Bools) -> tuple[int, ...]:
    """List the numbers of the parts in a set (n,)."""
    return tuple(int(number) for number in np.flatnonzero(parts))
