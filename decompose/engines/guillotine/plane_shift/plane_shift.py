"""Search for positions of the cut planes off the grid at which the slowest parts end sooner.

On the grid, a face can only move by a whole layer of cells, which is a large share of a part. Here all groups
of faces that can move (`plane_moves`) move at once. A linear programme finds short steps that minimise the
makespan as if every part's time were linear in the positions of its faces. The slopes, which are the changes
of a part's time for each mm by which one of its faces moves, follow from the outlines of the faces at first
(`measure_face_slopes`). The parts are then priced at the new positions, and the slopes are corrected
accordingly. Each part keeps its pose until the end where it still fits, because pricing it in a known pose is
much faster, and other poses hardly change the makespan. One such search is made even if the budget is spent,
because it gains more in the same time than most other searches.

Given a makespan to beat, a search ends before its first step if the linear programme expects to miss it by
far, and before the search for new poses if the parts miss it.

Boxes are trimmed to their needed cells first (`trimming`). In the search they are extended into the hollow
again, so that faces there can move, but parts are not cut larger than needed (`part_cutter`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from decompose.arrays import Floats
from decompose.engines.guillotine.plane_shift.box_part import (
    BoxPart,
    find_longest_time_s,
    find_spare_length_mm,
    sort_times_s,
)
from decompose.engines.guillotine.plane_shift.face_limits import ANY_MOVES, SAFE_SHARES, FaceLimits, MoveRules
from decompose.engines.guillotine.plane_shift.linear_programme import (
    ShiftLimits,
    solve_plane_shifts,
    update_slopes,
)
from decompose.engines.guillotine.plane_shift.part_cutter import PartCutter
from decompose.engines.guillotine.plane_shift.plane_moves import (
    extend_boxes,
    find_clear_position_mm,
    find_free_directions,
    find_invalid_groups,
    group_faces,
    move_groups,
    refine_needed_cells,
)
from decompose.engines.guillotine.plane_shift.trimming import trim_boxes
from decompose.grid import Box, Grid, NeededCells, find_flat_faces
from decompose.pieces import SLIVER_MM, Piece, find_faults
from decompose.printers import TargetPrinter
from decompose.problem import WORK_NS, Problem, Work

MAX_MOVE_SHARE = 0.9  # maximum total move of a plane, as a share of the shortest cell along the same axis
FIRST_STEP_SHARE = 0.5  # maximum length of the first step, as a share of a plane's maximum total move
TRIAL_MM = 0.4  # length of a trial move, which shows whether a group is free to move
MAX_ROUNDS, STEPS_PER_ROUND = 4, 8
MAX_TRIES = 4  # maximum number of times that planes are moved, if parts are too slow in their best poses
STEP_REDUCTION = 0.6  # ratio of the maximum length of the next step to that of a step without a gain
# A search ends before its first step if the makespan to beat, times this, is shorter than the one after the
# best moves, as if slopes were exact. That expected makespan may be too long by about 1 %.
HOPELESS_RATIO = 1.02
MAX_POSE_RATIO = 1.003  # poses are not sought for parts that exceed the makespan to beat by this factor
MIN_GAIN = 0.0025  # minimum expected gain of a step, as a share of the makespan
MIN_TOTAL_GAIN = 0.003  # minimum gain of a search after which another search starts from its result
PLANE_DECIMALS = 6  # decimal places of a moved plane's coordinate in mm
MIN_MOVE_MM = 0.02  # minimum move of a plane
# A part's time has jumped if it is longer than the slopes predict by more than this share of the makespan.
MAX_LINEAR_ERROR = 0.005
# Maximum number of times that planes which block each other take shorter steps, and are stopped after that,
# until the boxes remain a partition.
MAX_REDUCTIONS, MAX_STOPS = 6, 6
MAX_SOLUTIONS = 4
"""Maximum number of times that the linear programme of a step is solved. Before each further time, the planes
that flat faces have stopped are fixed."""
# Mean work of a search for a part, in prices: 4.3 prices after moves, and a search for its pose, which takes
# as long as three prices.
MEAN_PRICING_COUNT = 7.3


def shift_planes(
    problem: Problem,
    grid: Grid,
    box_pieces: Mapping[Box, Sequence[Piece]],
    cells: NeededCells | None = None,
    best_known_s: float = math.inf,
) -> list[Piece]:
    """Move the cut planes of a partition to reduce its makespan; the pieces get their best poses.

    Parameters
    ----------
    problem, grid
        Problem, and the grid over its model.
    box_pieces
        Boxes of a partition of the grid, and the pieces in each box.
    cells
        The grid's needed cells from `refine_needed_cells`, if they are known.
    best_known_s
        Makespan to beat, with the time factors of the pieces (`Piece.time_factor`). A partition that can
        hardly beat it keeps its planes.

    Returns
    -------
    list[Piece]
        As many pieces as before, none of which is slower than the slowest piece before; the same pieces if
        there is no gain. All solid that must be printed remains in a box; other solid may be left out
        (`grid.needed_cells`).
    """
    cells = refine_needed_cells(problem, grid) if cells is None else cells
    boxes_mm = np.array([grid.find_bounds_mm(box) for box in box_pieces])
    boxes_mm, pieces = trim_boxes(problem, cells, boxes_mm, list(box_pieces.values()))
    return shift_box_planes(problem, grid, boxes_mm, pieces, cells, best_known_s)


def estimate_shift_s(problem: Problem, part_count: int) -> float:
    """Estimate the effort in s, for a number of parts, of the one search that is always made."""
    faces = problem.model.solid.face_count
    measured_ns = WORK_NS[Work.PIECE_MEASURED] * part_count + WORK_NS[Work.FACE_MEASURED] * 2.0 * faces
    return (MEAN_PRICING_COUNT * measured_ns + WORK_NS[Work.FACE_GRIDDED] * faces) / 1e9


def shift_box_planes(
    problem: Problem,
    grid: Grid,
    boxes_mm: Floats,
    pieces: Sequence[Sequence[Piece]],
    cells: NeededCells | None = None,
    best_known_s: float = math.inf,
    rules: MoveRules = ANY_MOVES,
) -> list[Piece]:
    """Move the planes of boxes, on a grid or not, to reduce the makespan.

    A face that was stopped, or could not reach its best position, may be free to move after the others have
    moved. So the planes are moved again as long as the gain is large enough, and the makespan to beat is
    reached.

    Parameters
    ----------
    problem, grid
        Problem, and the grid over its model; the needed cells of the grid have to stay covered.
    boxes_mm
        (n, 2, 3) corners of disjoint boxes that cover the needed cells.
    pieces
        Pieces in each box.
    cells, best_known_s
        As in `shift_planes`.
    rules
        Rules for the moves.

    Returns
    -------
    list[Piece]
        As in `shift_planes`.
    """
    problem.effort.record(Work.FACE_GRIDDED, problem.model.solid.face_count)
    cells = refine_needed_cells(problem, grid) if cells is None else cells
    cell_mm = np.array([np.diff(planes).min() for planes in grid.planes])
    while True:
        search = _PlaneShift(problem, cells, cell_mm, boxes_mm, pieces, rules)
        start_parts = search.pose_start_parts()
        parts = search.improve_parts(start_parts, best_known_s)
        has_gain = math.isfinite(find_longest_time_s(parts)) and (
            find_longest_time_s(parts) <= (1.0 - MIN_TOTAL_GAIN) * find_longest_time_s(start_parts)
        )
        if not (has_gain and problem.is_thorough) or problem.effort.is_spent():
            return [piece for part in parts for piece in part.pieces]
        boxes_mm = np.array([part.cut_box_mm for part in parts])
        pieces = [part.pieces for part in parts]


class _PlaneShift:
    """Search for better planes that starts from one partition."""

    def __init__(
        self,
        problem: Problem,
        cells: NeededCells,
        cell_mm: Floats,
        boxes_mm: Floats,
        pieces: Sequence[Sequence[Piece]],
        rules: MoveRules = ANY_MOVES,
    ) -> None:
        self.problem = problem
        self.cells = cells
        self.min_gain_s_per_mm = rules.min_gain_s_per_mm
        self.start_boxes_mm = extend_boxes(boxes_mm)
        self.start_parts = [
            BoxPart(box, tuple(box_pieces), (), math.inf)
            for box, box_pieces in zip(self.start_boxes_mm, pieces, strict=True)
        ]
        self.groups = group_faces(self.start_boxes_mm)
        self.is_free = find_free_directions(self.start_boxes_mm, self.groups, self.cells, TRIAL_MM)
        self.axes = np.zeros(len(self.is_free), dtype=np.int64)
        self.axes[self.groups[self.groups >= 0]] = np.argwhere(self.groups >= 0)[:, 2]
        self.reach_mm = (MAX_MOVE_SHARE * cell_mm)[self.axes]
        vertices, faces = problem.model.solid.arrays()
        self.flat_faces = [find_flat_faces(vertices[faces], axis) for axis in range(3)]
        self.cutter = PartCutter(problem, self.start_parts, cell_mm, cells, self.flat_faces)
        self.face_limits = FaceLimits(problem, self.cutter, self.groups)
        for stop in rules.stops:
            # A part that ends inside its extended box does not change as the face of the box moves.
            if self.start_boxes_mm[(stop.box, *stop.face)] == boxes_mm[(stop.box, *stop.face)]:
                self.face_limits.stop_face(stop)

    def pose_start_parts(self) -> list[BoxPart]:
        """Find the best poses for the parts of the first partition."""
        return self.cutter.pose_parts(self.start_parts)

    def improve_parts(self, start_parts: list[BoxPart], best_known_s: float = math.inf) -> list[BoxPart]:
        """Improve the positions of the planes, starting from parts in their best poses.

        The parts stay as they are if they can hardly become faster than the makespan to beat. Otherwise,
        those that have moved get their best poses at the end. If they are slower in these, the faces of the
        slow parts stay.
        """
        if not (self.is_free.any() and math.isfinite(find_longest_time_s(start_parts))):
            return start_parts
        self.cutter.record_slopes(start_parts)
        slopes_s_per_mm = np.array(
            list(self.problem.map(self.cutter.measure_slopes, start_parts, self.groups < 0))
        )
        if math.isfinite(best_known_s):
            _, expected_s = self._solve_step(start_parts, slopes_s_per_mm, self.reach_mm)
            if HOPELESS_RATIO * best_known_s < expected_s < math.inf:
                return start_parts
        for try_number in range(MAX_TRIES):
            if try_number and self.problem.effort.is_spent():
                break
            parts = self._take_rounds(start_parts, slopes_s_per_mm)
            if parts is start_parts or find_longest_time_s(parts) > MAX_POSE_RATIO * best_known_s:
                break
            posed_parts = self.cutter.pose_parts(parts, start_parts)
            if sort_times_s(posed_parts) < sort_times_s(start_parts):
                return posed_parts
            limit_s = find_longest_time_s(start_parts)
            slow_numbers = [i for i, part in enumerate(posed_parts) if part.seconds >= limit_s]
            if not self.face_limits.limit_faces(start_parts, posed_parts, slow_numbers, 0.0):
                break
        return start_parts

    def _take_rounds(self, best_parts: list[BoxPart], slopes_s_per_mm: Floats) -> list[BoxPart]:
        """Take rounds of steps as long as they gain enough; each begins with long steps again."""
        for round_number in range(MAX_ROUNDS):
            if round_number and self.problem.effort.is_spent():
                break
            new_parts = self._take_steps(best_parts, slopes_s_per_mm)
            if new_parts is best_parts:
                break
            if self._has_faults(new_parts):
                self.reach_mm = self.reach_mm / 2.0
                continue
            gain = 1.0 - find_longest_time_s(new_parts) / find_longest_time_s(best_parts)
            best_parts = new_parts
            if gain < MIN_GAIN:
                break
        return best_parts

    def _has_faults(self, parts: Sequence[BoxPart]) -> bool:
        """Check whether any piece cannot be glued well."""
        return bool(
            find_faults([p for part in parts for p in part.pieces], self.problem.options.min_glue_mm2)
        )

    def _take_steps(self, parts: list[BoxPart], slopes_s_per_mm: Floats) -> list[BoxPart]:
        """Take steps in which each part keeps its pose; return the same parts if no step gains enough."""
        step_mm = FIRST_STEP_SHARE * self.reach_mm
        for _ in range(STEPS_PER_ROUND):
            boxes_mm, expected_s = self._solve_valid_step(parts, slopes_s_per_mm, step_mm)
            if expected_s > (1.0 - MIN_GAIN) * find_longest_time_s(parts):
                break
            new_parts = self.cutter.cut_moved_parts(parts, boxes_mm)
            longest_s, jumps = find_longest_time_s(parts), []
            for i, (old_part, part) in enumerate(zip(parts, new_parts, strict=True)):
                move_mm = part.box_mm - old_part.box_mm
                linear_s = old_part.seconds + float((slopes_s_per_mm[i] * move_mm).sum())
                if part.seconds >= longest_s and part.seconds - linear_s > MAX_LINEAR_ERROR * longest_s:
                    jumps.append(i)
                else:
                    update_slopes(slopes_s_per_mm[i], move_mm, part.seconds - old_part.seconds)
            if sort_times_s(new_parts) < sort_times_s(parts):
                parts = new_parts
            elif not self.face_limits.limit_faces(parts, new_parts, jumps, SAFE_SHARES[0]):
                step_mm *= STEP_REDUCTION
        return parts

    def _solve_valid_step(
        self, parts: list[BoxPart], slopes_s_per_mm: Floats, step_mm: Floats
    ) -> tuple[Floats, float]:
        """Compute the best boxes as `_solve_step` does; reduce steps until the boxes remain a partition.

        The maximum steps `step_mm` of the groups that break the partition are reduced in place. Groups that
        still break it after `MAX_REDUCTIONS` are stopped, for the next steps of the round as well.

        Returns
        -------
        tuple
            (n, 2, 3) boxes in mm and their makespan in s; inf if no step was found.
        """
        start_boxes_mm = np.array([part.box_mm for part in parts])
        for number in range(MAX_REDUCTIONS + MAX_STOPS):
            boxes_mm, expected_s = self._solve_step(parts, slopes_s_per_mm, step_mm)
            if self.cells.is_partition(boxes_mm):
                return boxes_mm, expected_s
            invalid_groups = find_invalid_groups(self.groups, start_boxes_mm, boxes_mm, self.cells)
            step_mm[invalid_groups] *= STEP_REDUCTION if number < MAX_REDUCTIONS else 0.0
        return start_boxes_mm, math.inf

    def _solve_step(
        self, parts: list[BoxPart], slopes_s_per_mm: Floats, step_mm: Floats
    ) -> tuple[Floats, float]:
        """Compute the best boxes (n, 2, 3) in mm, and their makespan in s, as if slopes were exact.

        A plane that a flat face stops before its best position is fixed at the flat face, and the step is
        solved again for the other planes.
        """
        start_boxes_mm = np.array([part.box_mm for part in parts])
        positions_mm = self._find_positions_mm(start_boxes_mm)
        shift_mm = positions_mm - self._find_positions_mm(self.start_boxes_mm)
        limits_mm = self.face_limits.limits_mm
        low_mm = np.maximum(-step_mm, np.maximum(-self.reach_mm - shift_mm, limits_mm[:, 0] - positions_mm))
        high_mm = np.minimum(step_mm, np.minimum(self.reach_mm - shift_mm, limits_mm[:, 1] - positions_mm))
        min_shift_mm = np.where(self.is_free[:, 0], np.minimum(low_mm, 0.0), 0.0)
        max_shift_mm = np.where(self.is_free[:, 1], np.maximum(high_mm, 0.0), 0.0)
        max_growth_mm = np.array([find_spare_length_mm(p.size_mm, self._list_printers(p)) for p in parts])
        max_shrinkage_mm = np.array(
            [np.maximum(0.0, np.ptp(part.cut_box_mm, axis=0) - SLIVER_MM) for part in parts]
        )
        seconds = np.array([part.seconds for part in parts])
        boxes_mm, expected_s = start_boxes_mm, math.inf
        for _ in range(MAX_SOLUTIONS):
            limits = ShiftLimits(max_growth_mm, max_shrinkage_mm, min_shift_mm, max_shift_mm)
            shifts_mm, min_s = solve_plane_shifts(
                seconds, slopes_s_per_mm, self.groups, limits, self.min_gain_s_per_mm
            )
            if not math.isfinite(min_s):  # no solution with the stopped planes: keep the previous one
                break
            expected_s = min_s
            boxes_mm = self._stop_planes(start_boxes_mm, move_groups(start_boxes_mm, self.groups, shifts_mm))
            moves_mm = self._find_positions_mm(boxes_mm) - positions_mm
            is_stopped = np.abs(moves_mm - shifts_mm) > MIN_MOVE_MM
            if not is_stopped.any():
                break
            min_shift_mm[is_stopped] = max_shift_mm[is_stopped] = moves_mm[is_stopped]
        return boxes_mm, expected_s

    def _find_positions_mm(self, boxes_mm: Floats) -> Floats:
        """Find the coordinate (groups,) of each group in mm."""
        positions_mm = np.zeros(len(self.is_free))
        positions_mm[self.groups[self.groups >= 0]] = boxes_mm[self.groups >= 0]
        return positions_mm

    def _stop_planes(self, old_boxes_mm: Floats, new_boxes_mm: Floats) -> Floats:
        """Stop planes before flat faces, and undo moves that are shorter than `MIN_MOVE_MM`."""
        old_mm, new_mm = self._find_positions_mm(old_boxes_mm), self._find_positions_mm(new_boxes_mm)
        for group in range(len(old_mm)):
            if abs(new_mm[group] - old_mm[group]) < MIN_MOVE_MM:
                new_mm[group] = old_mm[group]
            new_mm[group] = find_clear_position_mm(
                self.flat_faces[self.axes[group]], old_mm[group], new_mm[group]
            )
            if new_mm[group] != old_mm[group]:  # groups that move to one plane get the same coordinate
                new_mm[group] = round(new_mm[group], PLANE_DECIMALS)
        return np.where(self.groups >= 0, new_mm[self.groups], old_boxes_mm)

    def _list_printers(self, part: BoxPart) -> list[TargetPrinter]:
        """List the printers that the pieces of a part have to fit."""
        return [printer for piece in part.pieces for printer in self.problem.list_piece_printers(piece)]
