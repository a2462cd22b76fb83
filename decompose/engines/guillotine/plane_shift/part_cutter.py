"""Parts that are cut again as the faces of their boxes move, and priced in their old or best poses."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from decompose.arrays import Bools, Floats
from decompose.engines.guillotine.plane_shift.box_part import BoxPart
from decompose.engines.guillotine.plane_shift.plane_moves import find_clear_position_mm
from decompose.grid import FlatFaces, NeededCells
from decompose.pieces import copy_printers, cut_box, find_face_planes
from decompose.print_time import PartMesh, Pose, measure_face_slopes
from decompose.problem import Problem, Work, measure_similar_pose


class PartCutter:
    """Cutter that cuts the parts of a partition again when their boxes change.

    Each part is given by its number.

    Parameters
    ----------
    problem
        Problem with the model.
    start_parts
        Parts before any move.
    reach_mm
        (3,) maximum move of a face along each axis.
    cells
        Cells that parts have to cover.
    flat_faces
        Flat faces of the model along each axis, from which the sides of parts keep their distance.
    """

    def __init__(
        self,
        problem: Problem,
        start_parts: Sequence[BoxPart],
        reach_mm: Floats,
        cells: NeededCells,
        flat_faces: Sequence[FlatFaces],
    ) -> None:
        self._problem = problem
        self._cells, self._flat_faces = cells, flat_faces
        self._start_parts = start_parts
        # Solid in the reach of each part, which is faster to cut than the whole model.
        self._nearby_solids = [
            problem.model.solid.clip(part.box_mm[0] - reach_mm, part.box_mm[1] + reach_mm)
            for part in start_parts
        ]

    def record_effort(self, parts: Sequence[int]) -> None:
        """Record the work of cutting parts, which are given by number, and of pricing them in their poses."""
        self._problem.effort.record(Work.PIECE_MEASURED, len(parts))
        self._problem.effort.record(Work.FACE_MEASURED, sum(self._nearby_solids[i].face_count for i in parts))

    def record_slopes(self, parts: Sequence[BoxPart]) -> None:
        """Record the work of measuring the slopes of parts, as if those of all their pieces were measured."""
        faces = sum(piece.solid.face_count for part in parts for piece in part.pieces)
        self._problem.effort.record(Work.FACE_SLOPED, faces)

    def cut_part(self, i: int, box_mm: Floats) -> BoxPart:
        """Cut a part with another box; the pieces keep their printers if there are as many as before."""
        start_pieces = self._start_parts[i].pieces
        pieces = cut_box(self._nearby_solids[i], *self._choose_cut_box_mm(i, box_mm))
        if len(pieces) == len(start_pieces):
            pieces = copy_printers(pieces, start_pieces)
        return BoxPart(box_mm, tuple(pieces), (), math.inf)

    def _choose_cut_box_mm(self, i: int, box_mm: Floats) -> Floats:
        """Choose the box (2, 3) in mm out of which a part is cut, in a larger box.

        Sides at which the start part ended inside its box stay in place as long as the needed cells do not
        extend beyond them, so that the time of the part does not jump.
        """
        start_part = self._start_parts[i]
        is_inside = start_part.cut_box_mm != start_part.box_mm
        if not is_inside.any():
            return box_mm
        needed_mm = self._cells.find_needed_bounds_mm(box_mm)
        low_mm = np.maximum(box_mm[0], np.minimum(start_part.cut_box_mm[0], needed_mm[0]))
        high_mm = np.minimum(box_mm[1], np.maximum(start_part.cut_box_mm[1], needed_mm[1]))
        cut_box_mm = np.where(is_inside, [low_mm, high_mm], box_mm)
        for side, axis in np.argwhere(cut_box_mm != box_mm).tolist():
            cut_box_mm[side, axis] = find_clear_position_mm(
                self._flat_faces[axis], box_mm[side, axis], cut_box_mm[side, axis]
            )
        return cut_box_mm

    def pose_parts(self, parts: list[BoxPart], previous_parts: Sequence[BoxPart] = ()) -> list[BoxPart]:
        """Find the best poses of parts; parts that have not moved since `previous_parts` keep their poses."""
        posed_parts = {
            i: part for i, part in enumerate(previous_parts) if (part.box_mm == parts[i].box_mm).all()
        }
        moved_numbers = [i for i in range(len(parts)) if i not in posed_parts]
        poses = iter(self._problem.find_poses([piece for i in moved_numbers for piece in parts[i].pieces]))
        for i in moved_numbers:
            posed_parts[i] = parts[i].with_poses([next(poses) for _ in parts[i].pieces])
        return [posed_parts[i] for i in range(len(parts))]

    def cut_moved_parts(self, parts: list[BoxPart], boxes_mm: Floats) -> list[BoxPart]:
        """Cut the parts whose boxes have moved, and find new poses where the old ones do not fit."""
        moved_numbers = [i for i, part in enumerate(parts) if (boxes_mm[i] != part.box_mm).any()]
        self.record_effort(moved_numbers)
        arguments = moved_numbers, [parts[i] for i in moved_numbers], boxes_mm[moved_numbers]
        recut_parts = list(self._problem.map(self.cut_in_old_poses, *arguments))
        unposed_pieces = [
            piece
            for part, poses in recut_parts
            for piece, pose in zip(part.pieces, poses, strict=False)
            if pose is None
        ]
        new_poses = iter(self._problem.find_poses(unposed_pieces))
        new_parts = list(parts)
        for i, (part, poses) in zip(moved_numbers, recut_parts, strict=True):
            all_poses = [next(new_poses) if pose is None else pose for pose in poses]
            new_parts[i] = part.with_poses(all_poses) if all_poses else part
        return new_parts

    def cut_in_old_poses(self, i: int, part: BoxPart, box_mm: Floats) -> tuple[BoxPart, list[Pose | None]]:
        """Cut a part again, with its pieces in their old poses; return the part and the poses.

        A pose is None if it is no longer good (`measure_similar_pose`). The list of poses is empty if the
        number of pieces changes, or if a piece becomes a sliver.
        """
        new_part = self.cut_part(i, box_mm)
        if not new_part.has_similar_pieces(part):
            return new_part, []
        poses = [
            measure_similar_pose(self._problem, piece, old_pose)
            for piece, old_pose in zip(new_part.pieces, part.poses, strict=True)
        ]
        return new_part, poses

    def measure_slopes(self, part: BoxPart, is_fixed: Bools) -> Floats:
        """Measure the change (2, 3) of a part's time, in s for each mm by which one face moves up its axis.

        Parameters
        ----------
        part
            Part in its poses, whose slowest piece counts.
        is_fixed
            (2, 3) bool, true for faces that cannot move, whose slopes stay 0.
        """
        piece, pose = max(
            zip(part.pieces, part.poses, strict=True), key=lambda pair: pair[1].price_s * pair[0].time_factor
        )
        vertices, faces = piece.solid.arrays()
        face_planes = find_face_planes(vertices, faces, piece.planes)
        mesh = PartMesh(vertices, faces, face_planes >= 0)
        # The planes are those of `list_box_planes`: the lower sides of the box, and then the upper ones.
        slopes_s_per_mm = measure_face_slopes(
            mesh, pose.to_model[:3, :3].T, face_planes, np.vstack([-np.eye(3), np.eye(3)]), self._problem.cost
        ).reshape(2, 3) * [[-piece.time_factor], [piece.time_factor]]
        # A part that ends inside its box does not change as the box does.
        return np.where(is_fixed | (part.cut_box_mm != part.box_mm), 0.0, slopes_s_per_mm)
