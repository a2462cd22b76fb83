"""Order of assembly: a tree of steps, each of which joins two bodies along one direction.

The search begins with the complete assembly and takes it apart: a set of parts is split into two that can be
moved apart along an axis, and each of which is held together by glue, until single parts are left. The steps
of the assembly are these splits in reverse order.
A partition into boxes of one frame can always be split so; for others, a set that cannot is a fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.sparse.csgraph import connected_components

from decompose.arrays import Bools, Floats, Ints
from decompose.assembly.blocking import find_axes, find_blocking
from decompose.assembly.resting import Weight, find_rest
from decompose.assembly.schedule import Work, compute_critical_path_s, order_steps
from decompose.assembly.shadow import TOUCH_MM
from decompose.options import MIN_GLUE_MM2
from decompose.pieces import CutSolid, Joint

MIN_CLOSING_SHARE = 0.999  # a step slides if a smaller share of its glue closes along its normal
ALONG_COS = 0.999  # minimum cosine between a normal and a direction along it


@dataclass(frozen=True, slots=True, eq=False)
class AssemblyStep:
    """Joining of two bodies. Parts and joints are given by their numbers.

    Attributes
    ----------
    moved_parts, fixed_parts
        Parts of the body that is moved, and of the one that it is joined to.
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
        One more than the highest level of the steps that make the two bodies: the glue of all steps of a
        level can dry at the same time.
    work_s, starts_s
        A person's time for the step, and its start after that of the first step, with one person at work.
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
    starts_s: float = 0.0

    @property
    def work(self) -> Work:
        """Return the quantities on which the step's time depends."""
        bodies = frozenset(self.moved_parts), frozenset(self.fixed_parts)
        return Work(bodies, len(self.joints), self.glue_mm2, bool(self.rests_on))


@dataclass(frozen=True, slots=True)
class Assembly:
    """Steps in the order of work, each after those that make its bodies.

    Attributes
    ----------
    locked
        Sets of parts that cannot be joined by straight moves of two bodies.
    """

    steps: tuple[AssemblyStep, ...] = ()
    locked: tuple[tuple[int, ...], ...] = ()

    @property
    def levels(self) -> int:
        """Number of steps on the longest chain of steps that depend on each other's glue."""
        return max((step.level for step in self.steps), default=0)

    @property
    def total_s(self) -> float:
        """Time of one person from the first step to the end of the last one, with waits for glue."""
        return max((step.starts_s + step.work_s for step in self.steps), default=0.0)

    @property
    def critical_s(self) -> float:
        """Minimum time with enough people: the longest chain of work and drying."""
        return compute_critical_path_s([step.work for step in self.steps])

    @property
    def part_order(self) -> tuple[int, ...]:
        """Parts in the order in which the steps use them; those without a step are left out."""
        return tuple(
            dict.fromkeys(part for step in self.steps for part in (*step.fixed_parts, *step.moved_parts))
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Split:
    """Two sets (n,) of which the first moves along `direction`."""

    moved: Bools
    fixed: Bools
    direction: Floats


def plan_assembly(
    pieces: Sequence[CutSolid], joints: Sequence[Joint], min_glue_mm2: float = MIN_GLUE_MM2
) -> Assembly:
    """Plan the order in which parts are joined.

    Parameters
    ----------
    pieces
        Parts in one frame, cut at planes.
    joints
        Joints of `pieces.find_joints`, in the same frame.
    min_glue_mm2
        Minimum area of a joint that counts as holding.

    Returns
    -------
    Assembly
        Without steps for a single part.
    """
    if len(pieces) < 2:
        return Assembly()
    plan = _Plan(pieces, joints, min_glue_mm2)
    plan.split(np.ones(len(pieces), dtype=np.bool_), outermost=True)
    works = [step.work for step in plan.steps]
    steps = (
        replace(plan.steps[number], work_s=works[number].seconds, starts_s=starts_s)
        for number, starts_s in order_steps(works)
    )
    return Assembly(tuple(steps), tuple(plan.locked))


class _Plan:
    """Search for splits, and the steps found so far."""

    def __init__(self, pieces: Sequence[CutSolid], joints: Sequence[Joint], min_glue_mm2: float) -> None:
        count = len(pieces)
        axes = find_axes(pieces, joints)
        self.steps: list[AssemblyStep] = []
        self.locked: list[tuple[int, ...]] = []
        self._joints = joints
        self._weights = [Weight.from_solid(piece.solid) for piece in pieces]
        self._directions = np.concatenate([axes, -axes])
        self._blocking = find_blocking([piece.solid for piece in pieces], axes)
        heights = [weight.points @ self._directions.T for weight in self._weights]
        self._low_mm = np.array([height.min(axis=0) for height in heights]).T  # (directions, parts)
        self._high_mm = np.array([height.max(axis=0) for height in heights]).T
        self._volumes_mm3 = np.array([weight.volume_mm3 for weight in self._weights])
        self._glue_mm2 = np.zeros((count, count))
        self._has_glue = np.zeros((count, count), dtype=np.bool_)
        self._closing_mm2 = np.zeros((len(self._directions), count, count))
        for joint in joints:
            self._glue_mm2[joint.a, joint.b] = self._glue_mm2[joint.b, joint.a] = joint.area_mm2
            self._has_glue[joint.a, joint.b] = self._has_glue[joint.b, joint.a] = joint.holds(min_glue_mm2)
            for face in joint.faces:
                along = np.abs(self._directions @ face.normal) > ALONG_COS
                self._closing_mm2[along, joint.a, joint.b] += face.area_mm2
                self._closing_mm2[along, joint.b, joint.a] += face.area_mm2

    def split(self, parts: Bools, *, outermost: bool) -> int:
        """Split a set of parts (n,) into single parts, and append the steps; return the level of the last
        one.

        `outermost`: nothing is glued around the set, so that loose bodies in it need no step.
        """
        if parts.sum() < 2:
            return 0
        split = self._find_split(parts)
        if split is None:
            self.locked.append(_list_numbers(parts))
            return 0
        is_across = np.outer(split.moved, split.fixed)
        loose = not (self._glue_mm2 * is_across).any()
        sides = sorted((split.moved, split.fixed), key=lambda side: int(side.sum()))
        level = 1 + max(self.split(side, outermost=outermost and loose) for side in sides)
        if not (loose and outermost):
            self.steps.append(self._build_step(split, level))
        return level

    def _build_step(self, split: _Split, level: int) -> AssemblyStep:
        """Choose the body that is moved: the lighter one, unless only it stands with its joint upwards."""
        moved, fixed, direction = split.moved, split.fixed, split.direction
        resting_parts = find_rest(self._weights, _list_numbers(fixed), direction)
        other_resting_parts = find_rest(self._weights, _list_numbers(moved), -direction)
        lighter = float(self._volumes_mm3[moved].sum()) > float(self._volumes_mm3[fixed].sum())
        if bool(other_resting_parts) > bool(resting_parts) or (
            lighter and bool(other_resting_parts) == bool(resting_parts)
        ):
            moved, fixed, direction, resting_parts = fixed, moved, -direction, other_resting_parts
        number = int(np.argmax(self._directions @ split.direction))
        across = np.outer(moved, fixed)
        glue_mm2 = float((self._glue_mm2 * across).sum())
        return AssemblyStep(
            moved_parts=_list_numbers(moved),
            fixed_parts=_list_numbers(fixed),
            direction=direction,
            joints=tuple(
                k
                for k, joint in enumerate(self._joints)
                if across[joint.a, joint.b] or across[joint.b, joint.a]
            ),
            glue_mm2=glue_mm2,
            slides=float((self._closing_mm2[number] * across).sum()) < MIN_CLOSING_SHARE * glue_mm2,
            rests_on=resting_parts,
            level=level,
        )

    def _find_split(self, parts: Bools) -> _Split | None:
        """Find the best split of a set (n,) into two that can be moved apart, in as few bodies as can be."""
        numbers = np.flatnonzero(parts)
        candidates = list(
            chain.from_iterable(self._find_candidates(d, numbers) for d in range(len(self._directions)))
        )
        if not candidates:
            return None
        glue_mm2 = self._glue_mm2[np.ix_(numbers, numbers)]
        has_glue = self._has_glue[np.ix_(numbers, numbers)]
        bodies = _count_bodies(has_glue, np.ones(len(numbers), dtype=np.bool_))

        def compute_merit(candidate: tuple[int, Bools]) -> tuple[bool, int, float]:
            direction, mask = candidate
            closing = self._closing_mm2[direction][np.ix_(numbers, numbers)]
            across_mm2 = float(glue_mm2[mask][:, ~mask].sum())
            closes = float(closing[mask][:, ~mask].sum()) >= MIN_CLOSING_SHARE * across_mm2
            return closes, min(int(mask.sum()), int((~mask).sum())), across_mm2

        best: tuple[int, tuple[int, Bools]] | None = None
        for direction, moved in sorted(candidates, key=compute_merit, reverse=True):
            added_bodies = _count_bodies(has_glue, moved) + _count_bodies(has_glue, ~moved) - bodies
            if best is None or added_bodies < best[0]:
                best = added_bodies, (direction, moved)
            # The split of one body adds a body; loose bodies are separated without one.
            if added_bodies <= (0 if bodies > 1 else 1):
                break
        assert best is not None
        direction, moved = best[1]
        selected = np.zeros(len(parts), dtype=np.bool_)
        selected[numbers[moved]] = True
        return _Split(selected, parts & ~selected, self._directions[direction])

    def _find_candidates(self, direction: int, numbers: Ints) -> list[tuple[int, Bools]]:
        """Find sets of parts that can be moved along a direction, as masks over `numbers`.

        The candidates are each part with all parts that block it, and the bodies beyond a plane that cuts no
        part, if no other body blocks them.
        """
        blocked_by = self._blocking[direction][np.ix_(numbers, numbers)].T | np.eye(
            len(numbers), dtype=np.bool_
        )
        reach = _close_transitively(blocked_by)
        sets = [*reach, *self._list_beyond_planes(direction, numbers)]
        has_glue = self._has_glue[np.ix_(numbers, numbers)]
        for candidate in list(sets):
            count, label = connected_components(has_glue[candidate][:, candidate], directed=False)
            inside = np.flatnonzero(candidate)
            for body in range(count if count > 1 else 0):
                mask = np.zeros(len(numbers), dtype=np.bool_)
                mask[inside[label == body]] = True
                if (reach[mask].any(axis=0) <= mask).all():
                    sets.append(mask)
        distinct = {mask.tobytes(): mask for mask in sets if 0 < mask.sum() < len(numbers)}
        return [(direction, mask) for mask in distinct.values()]

    def _list_beyond_planes(self, direction: int, numbers: Ints) -> list[Bools]:
        low, high = self._low_mm[direction, numbers], self._high_mm[direction, numbers]
        planes = np.unique(np.round(low, 3))
        sides = [low >= at_mm - TOUCH_MM for at_mm in planes]
        return [
            side
            for at_mm, side in zip(planes, sides, strict=True)
            if not side.all() and (high[~side] <= at_mm + TOUCH_MM).all()
        ]


def _close_transitively(relation: Bools) -> Bools:
    """Compute the transitive closure of a reflexive relation (n, n)."""
    reach = relation
    while True:
        longer: Bools = (reach.astype(np.float32) @ reach.astype(np.float32)) > 0.0
        if (longer == reach).all():
            return longer
        reach = longer


def _count_bodies(has_glue: Bools, parts: Bools) -> int:
    """Count the bodies that joints (n, n) hold together among some of the parts (n,)."""
    count, _ = connected_components(has_glue[parts][:, parts], directed=False)
    return int(count)


def _list_numbers(parts: Bools) -> tuple[int, ...]:
    return tuple(int(number) for number in np.flatnonzero(parts))
