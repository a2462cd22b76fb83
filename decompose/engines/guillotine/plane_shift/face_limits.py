"""Limits on the moves of faces at which the print time of a part jumps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.engines.guillotine.plane_shift.box_part import BoxPart, find_longest_time_s
from decompose.engines.guillotine.plane_shift.part_cutter import PartCutter
from decompose.problem import Problem

Face = tuple[int, ...]  # face of a box: its side, 0 or 1, and its axis

SAFE_SHARES = (0.5, 0.25, 0.1)  # shares of a move that are tried if a face cannot make all of it


class FaceStop(NamedTuple):
    """Stop of a face of a box: its coordinate may not be less (`is_upper` false) or greater than a limit."""

    box: int
    face: Face
    limit_mm: float
    is_upper: bool


class MoveRules(NamedTuple):
    """Rules for the moves of planes.

    Attributes
    ----------
    min_gain_s_per_mm
        Minimum gain of makespan for each mm by which a group of faces moves.
    stops
        Positions that faces of the boxes may not pass.
    """

    min_gain_s_per_mm: float = 0.05  # so that no face moves without a gain
    stops: Sequence[FaceStop] = ()


ANY_MOVES = MoveRules()


class FaceLimits:
    """Limits on the positions of groups of faces, found by moving single faces of parts.

    Parameters
    ----------
    problem, cutter
        Problem, and the cutter of its parts.
    groups
        (n, 2, 3) from `group_faces`.

    Attributes
    ----------
    limits_mm
        (groups, 2) least and greatest coordinate of each group. Beyond them, a part would be split into other
        pieces, no longer fit in its pose, or take too long.
    """

    def __init__(self, problem: Problem, cutter: PartCutter, groups: Ints) -> None:
        self._problem = problem
        self._cutter = cutter
        self._groups = groups
        self.limits_mm = np.full((int(groups.max(initial=-1)) + 1, 2), (-math.inf, math.inf))

    def limit_faces(
        self,
        parts: Sequence[BoxPart],
        new_parts: Sequence[BoxPart],
        numbers: Sequence[int],
        common_share: float,
    ) -> bool:
        """Limit the moves of faces that make parts too slow.

        A part also counts as too slow if it is split into other pieces, or no longer fits in its pose. When
        supports begin to touch a cut face, or the brim becomes too narrow, another pose becomes the best
        one, and it may be much slower. When a face begins to overhang too far, the part gets a support.

        Parameters
        ----------
        parts, new_parts
            Parts before and after the moves.
        numbers
            Numbers of the parts that are too slow.
        common_share
            Share of its move that each face of a part may make if no single face is the cause.

        Returns
        -------
        bool
            Whether the limits have changed, so that the next step differs from this one.
        """
        old_limits_mm = self.limits_mm.copy()
        max_s = find_longest_time_s(parts)
        for i in numbers:
            move_mm = new_parts[i].box_mm - parts[i].box_mm
            faces = [face for face in np.ndindex(2, 3) if move_mm[face] != 0.0]
            safe_shares = self._find_safe_shares(i, parts[i], faces, move_mm, max_s)
            for face, share in (safe_shares or dict.fromkeys(faces, common_share)).items():
                limit_mm, is_up = parts[i].box_mm[face] + share * move_mm[face], move_mm[face] > 0.0
                self.stop_face(FaceStop(i, face, limit_mm, is_up))
        return bool((self.limits_mm != old_limits_mm).any())

    def stop_face(self, stop: FaceStop) -> None:
        """Limit the position of the group of a face; a face that belongs to no group cannot move anyway."""
        group = self._groups[(stop.box, *stop.face)]
        if group >= 0:
            limits_mm, side = self.limits_mm[group], int(stop.is_upper)
            limits_mm[side] = (min if stop.is_upper else max)(limits_mm[side], stop.limit_mm)

    def _find_safe_shares(
        self, i: int, part: BoxPart, faces: Sequence[Face], move_mm: Floats, max_s: float
    ) -> dict[Face, float]:
        """Find the share of its move that each slow face can make while all other faces stay.

        A face is slow if its move alone makes the part too slow. The share is the largest of `SAFE_SHARES`
        for which the face is no longer slow; 0 if there is none.
        """
        slow_faces = self._find_slow_faces(i, part, faces, move_mm, max_s)
        safe_shares = dict.fromkeys(slow_faces, 0.0)
        for share in SAFE_SHARES:
            faces_before = slow_faces
            slow_faces = self._find_slow_faces(i, part, slow_faces, share * move_mm, max_s)
            safe_shares |= dict.fromkeys((face for face in faces_before if face not in slow_faces), share)
        return safe_shares

    def _find_slow_faces(
        self, i: int, part: BoxPart, faces: Sequence[Face], move_mm: Floats, max_s: float
    ) -> list[Face]:
        """Find the faces whose moves, each made alone, make a part too slow.

        The part is too slow if it takes `max_s` or longer, is split into other pieces, or no longer fits in
        its pose.
        """
        self._cutter.record_effort([i] * len(faces))
        boxes_mm = [part.box_mm.copy() for _ in faces]
        for box_mm, face in zip(boxes_mm, faces, strict=True):
            box_mm[face] += move_mm[face]
        arguments = [i] * len(faces), [part] * len(faces), boxes_mm
        cut_parts = self._problem.map(self._cutter.cut_in_old_poses, *arguments)
        slow_faces = []
        for face, (new_part, poses) in zip(faces, cut_parts, strict=True):
            known_poses = [pose for pose in poses if pose is not None]
            if len(known_poses) < len(part.pieces) or new_part.with_poses(known_poses).seconds >= max_s:
                slow_faces.append(face)
        return slow_faces
