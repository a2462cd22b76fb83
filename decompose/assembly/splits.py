"""Search for the split of a set of parts into two sets that can be moved apart.

When two bodies are joined along a direction, glued faces that are perpendicular to it close: they meet only
at the end of the movement. Other glued faces, oblique or parallel to it, slide over each other. Only faces
that close can have pins in holes, and only on these faces does the glue stay in place.

A split whose faces all close is never worse than another one. After such a split, each half can be taken
apart by the same movements as the whole set, and no additional faces slide. So the choice matters only if
every split slides. In that case, the splits with the smallest sliding area are compared by the total sliding
area of all steps that take the set apart into single parts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice

import numpy as np
from scipy.sparse.csgraph import connected_components

from decompose.arrays import Bools, Floats, Ints
from decompose.assembly.shadow import MAX_TOUCH_OVERLAP_MM
from decompose.pieces import Joint

MIN_CLOSING_SHARE = 0.999  # a step slides if a smaller share of its glued area closes (see below)
# Minimum absolute cosine between a step and the normal of a face that closes: it is perpendicular to the
# movement, so both parts meet there only at the end.
MIN_ALIGNED_COS = 0.999
MAX_COMPARED_SPLITS = 8  # maximum number of sliding splits that are compared by taking the set apart
# Maximum number of sets that are taken apart for this comparison; beyond it, splits are compared only by
# their own sliding area.
MAX_EXAMINED_SETS = 400


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Two sets of parts as masks (n,), and the number of the direction along which the first set moves."""

    is_moved: Bools
    is_fixed: Bools
    direction_number: int

    @property
    def smaller_count(self) -> int:
        """Number of parts in the smaller set."""
        return int(min(self.is_moved.sum(), self.is_fixed.sum()))


@dataclass(frozen=True, slots=True, eq=False)
class Glue:
    """Glue between n parts.

    Attributes
    ----------
    area_mm2, holds
        (n, n) float64 areas of the joints, and (n, n) bool, true for joints that hold.
    closing_mm2
        (d, n, n) float64 area of the faces that close along each of d directions.
    """

    area_mm2: Floats
    holds: Bools
    closing_mm2: Floats

    @classmethod
    def from_joints(cls, count: int, joints: Sequence[Joint], axes: Floats, min_glue_mm2: float) -> Glue:
        """Compute the glue between parts from their joints; directions are the axes, then their opposites.

        Parameters
        ----------
        count
            Number of parts.
        joints
            Joints of the parts.
        axes
            (k, 3) unit vectors.
        min_glue_mm2
            Minimum area of a joint whose glue counts as holding.
        """
        area_mm2 = np.zeros((count, count))
        holds = np.zeros((count, count), dtype=np.bool_)
        closing_mm2 = np.zeros((len(axes), count, count))
        for joint in joints:
            both_orders = [joint.a, joint.b], [joint.b, joint.a]
            area_mm2[both_orders] = joint.area_mm2
            holds[both_orders] = joint.holds(min_glue_mm2)
            for face in joint.faces:
                closing_axes = np.flatnonzero(np.abs(axes @ face.normal) > MIN_ALIGNED_COS)
                for one, other in zip(*both_orders, strict=True):
                    closing_mm2[closing_axes, one, other] += face.area_mm2
        return cls(area_mm2, holds, np.concatenate([closing_mm2, closing_mm2]))

    def measure_glued_area_mm2(self, split: Split) -> float:
        """Measure the area of the glue between the two sets of a split."""
        return float(self.area_mm2[split.is_moved][:, split.is_fixed].sum())

    def measure_sliding_area_mm2(self, split: Split) -> float:
        """Measure the glued area of a split without the faces that are perpendicular to its direction."""
        closing_mm2 = float(self.closing_mm2[split.direction_number][split.is_moved][:, split.is_fixed].sum())
        return max(0.0, self.measure_glued_area_mm2(split) - closing_mm2)

    def is_closing(self, split: Split) -> bool:
        """Check whether nearly all of the glued area of a split is perpendicular to its direction."""
        max_sliding_mm2 = (1.0 - MIN_CLOSING_SHARE) * self.measure_glued_area_mm2(split)
        return self.measure_sliding_area_mm2(split) <= max_sliding_mm2

    def count_bodies(self, parts: Bools) -> int:
        """Count the bodies that glue holds together in a set of parts (n,)."""
        return int(connected_components(self.holds[parts][:, parts], directed=False)[0])

    def count_added_bodies(self, split: Split) -> int:
        """Compute by how much the number of bodies grows when a set is split."""
        sides = self.count_bodies(split.is_moved) + self.count_bodies(split.is_fixed)
        return sides - self.count_bodies(split.is_moved | split.is_fixed)


@dataclass(frozen=True, slots=True, eq=False)
class SplitSearch:
    """Search for splits of sets of parts.

    Attributes
    ----------
    glue
        Glue between the n parts.
    directions
        (d, 3) unit vectors along which bodies may move.
    blocking
        (d, n, n) bool from `blocking.find_blocking`.
    low_mm, high_mm
        (d, n) float64 bounds of the parts along the directions.
    """

    glue: Glue
    directions: Floats
    blocking: Bools
    low_mm: Floats
    high_mm: Floats
    _sliding_mm2: dict[bytes, float] = field(default_factory=dict)

    def find_split(self, parts: Bools) -> Split | None:
        """Find the best split of a set (n,) into two that can be moved apart; None if there is none.

        The split leaves as few bodies as possible. Among splits that close, those with halves of equal size
        are preferred, because the glue of both halves dries at the same time.
        """
        return self._choose_split(
            parts, MAX_COMPARED_SPLITS if len(self._sliding_mm2) < MAX_EXAMINED_SETS else 1
        )

    def _choose_split(self, parts: Bools, max_compared_splits: int) -> Split | None:
        """Choose the best split of a set (n,); compare at most `max_compared_splits` sliding splits."""
        splits = self._list_splits(parts)
        if not splits:
            return None
        splits.sort(key=lambda split: (-split.smaller_count, -self.glue.measure_glued_area_mm2(split)))
        # The split of one body adds a body; a split between loose bodies adds none.
        max_added_bodies = int(self.glue.count_bodies(parts) == 1)
        for split in filter(self.glue.is_closing, splits):
            if self.glue.count_added_bodies(split) <= max_added_bodies:
                return split
        sliding_splits = sorted(splits, key=self.glue.measure_sliding_area_mm2)
        candidates = (
            split for split in sliding_splits if self.glue.count_added_bodies(split) <= max_added_bodies
        )
        compared_splits = list(islice(candidates, max_compared_splits))
        if not compared_splits:
            return min(splits, key=self.glue.count_added_bodies)
        return (
            compared_splits[0]
            if len(compared_splits) == 1
            else min(compared_splits, key=self._measure_total_sliding_mm2)
        )

    def _measure_total_sliding_mm2(self, split: Split) -> float:
        """Measure the sliding area of a split and of the best splits of both halves, down to single parts."""
        sliding_mm2 = self.glue.measure_sliding_area_mm2(split)
        for parts in (split.is_moved, split.is_fixed):
            key = parts.tobytes()
            if key not in self._sliding_mm2:
                next_split = self._choose_split(parts, 1) if parts.sum() > 1 else None
                self._sliding_mm2[key] = (
                    0.0 if next_split is None else self._measure_total_sliding_mm2(next_split)
                )
            sliding_mm2 += self._sliding_mm2[key]
        return sliding_mm2

    def _list_splits(self, parts: Bools) -> list[Split]:
        """List the splits of a set (n,) into two that can be moved apart."""
        numbers = np.flatnonzero(parts)
        splits = []
        for direction_number in range(len(self.directions)):
            for mask in self._list_movable_sets(direction_number, numbers):
                is_moved = np.zeros(len(parts), dtype=np.bool_)
                is_moved[numbers[mask]] = True
                splits.append(Split(is_moved, parts & ~is_moved, direction_number))
        return splits

    def _list_movable_sets(self, direction_number: int, numbers: Ints) -> Iterator[Bools]:
        """List the sets of parts that can be moved along a direction, as masks over `numbers`.

        There are three kinds of sets: a part with all parts that block it, directly or through others; the
        parts beyond a plane that is perpendicular to the direction and cuts no part; and single bodies of
        those sets that no part outside the body blocks.
        """
        blocked_by = self.blocking[direction_number][np.ix_(numbers, numbers)].T | np.eye(
            len(numbers), dtype=np.bool_
        )
        blockers = _compute_closure(blocked_by)
        sets = [*blockers, *self._list_sets_beyond_planes(direction_number, numbers)]
        sets += chain.from_iterable([self._list_bodies(mask, numbers, blockers) for mask in sets])
        distinct = {mask.tobytes(): mask for mask in sets if 0 < mask.sum() < len(numbers)}
        yield from distinct.values()

    def _list_bodies(self, mask: Bools, numbers: Ints, blockers: Bools) -> list[Bools]:
        """List the bodies of a set that no part outside them blocks; none if the set is a single body."""
        members = numbers[mask]
        count, label = connected_components(self.glue.holds[np.ix_(members, members)], directed=False)
        bodies = []
        for body in range(count if count > 1 else 0):
            is_inside = np.zeros(len(numbers), dtype=np.bool_)
            is_inside[np.flatnonzero(mask)[label == body]] = True
            if (blockers[is_inside].any(axis=0) <= is_inside).all():
                bodies.append(is_inside)
        return bodies

    def _list_sets_beyond_planes(self, direction_number: int, numbers: Ints) -> list[Bools]:
        """List the sets of parts beyond planes that cut no part, as masks over `numbers`."""
        low_mm, high_mm = self.low_mm[direction_number, numbers], self.high_mm[direction_number, numbers]
        planes_mm = np.unique(np.round(low_mm, 3))
        sides = [low_mm >= plane_mm - MAX_TOUCH_OVERLAP_MM for plane_mm in planes_mm]
        return [
            side
            for plane_mm, side in zip(planes_mm, sides, strict=True)
            if not side.all() and (high_mm[~side] <= plane_mm + MAX_TOUCH_OVERLAP_MM).all()
        ]


def _compute_closure(relation: Bools) -> Bools:
    """Compute the transitive closure of a reflexive relation (n, n)."""
    closure = relation
    while True:
        longer: Bools = (closure.astype(np.float32) @ closure.astype(np.float32)) > 0.0
        if (longer == closure).all():
            return longer
        closure = longer
