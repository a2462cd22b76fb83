"""Moves of the cut planes based on sliced times: the print times that the slicer computes for the parts.

Prices of parts have errors of one or two per cent, and a job waits for the part that is underestimated most.
The error hardly changes when the faces of a part move by a few millimetres. So each part keeps its ratio of
sliced time to price, and the planes are moved again, with each price multiplied by this ratio.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import product
from time import perf_counter
from typing import NamedTuple

import numpy as np

from decompose.arrays import Floats
from decompose.detailed_models import cut_detailed_pieces, simplify_model, simplify_problem
from decompose.engines.guillotine import FaceStop, MoveRules, shift_box_planes
from decompose.errors import DecomposeError
from decompose.geometry import Model
from decompose.options import Engine
from decompose.pieces import Piece, assign_printers, cut_box, sort_pieces
from decompose.print_time import CostModel
from decompose.problem import Effort, GridFigures, Partition, Problem
from decompose.results import Cutting, Decomposition, apply_time_ratios, finish_result

MAX_ROUNDS = 6  # maximum number of times that callers move the planes of a decomposition
MIN_GAIN = 0.005  # minimum expected gain, as a share of the makespan, for which all parts are sliced again
# Minimum gains for each mm by which planes move, as shares of the makespan, for each part; the next one is
# used if no move gains as much. With each move, the sliced time of a part may jump, so planes that contribute
# little stay as long as others gain more. The more parts there are, the more of them may jump.
MIN_GAINS_PER_MM = (3e-6, 0.0)
STOP_SHARE = 0.5  # share of a move after which the faces of a part are stopped that was too slow after it


@dataclass(frozen=True, slots=True, eq=False)
class SlicedCuts:
    """Cuts of a decomposition whose parts were sliced.

    Attributes
    ----------
    decomposition
        Decomposition; its parts, joints and faults may be left out (`Decomposition.without_parts`).
    times_s
        Sliced time of each part in seconds.
    makespan_s
        Sliced makespan in seconds; it may include other times, such as that of heating up.
    """

    decomposition: Decomposition
    times_s: Sequence[float]
    makespan_s: float


def rebalance_planes(
    model: Model, rounds: Sequence[SlicedCuts], cost: CostModel, executor: Executor | None = None
) -> Decomposition | None:
    """Move the cut planes so that the part with the longest sliced time ends sooner.

    Where the time of a part jumps as one of its faces moves, the sliced times after the move may differ from
    the expected ones, and may even be longer. After such a move, the planes first move on from there, so that
    the other parts relieve this one. If this gains nothing, they move again from where they were best, and
    the faces of all parts that were too slow since then stop half-way.

    Parameters
    ----------
    model
        Model that was decomposed.
    rounds
        Decomposition of the model, and the results of this function for it so far.
    cost
        Cost model of that decomposition.
    executor
        Threads for work that may run in parallel; None to run it serially.

    Returns
    -------
    Decomposition | None
        Decomposition into the same number of parts, with the times of the cost model. None if the gain over
        the best decomposition would be too small to slice the parts again, if the parts were not cut by the
        engine `guillotine`, or if a very detailed model has other pieces in the new boxes than its copy.

    Raises
    ------
    NoFit, GeometryError
        The new parts do not fit the printers, or the result breaks a geometry rule, and no other move gains
        enough.
    """
    best_number = min(range(len(rounds)), key=lambda number: rounds[number].makespan_s)
    best, failed_rounds = rounds[best_number], rounds[best_number + 1 :]
    starts = [(best, failed_rounds)]
    if len(failed_rounds) == 1:
        starts.insert(0, (failed_rounds[0], ()))
    last_error: DecomposeError | None = None
    for min_gain_per_mm, (start, failed_moves) in product(MIN_GAINS_PER_MM, starts):
        goal = _Goal(best.makespan_s / start.makespan_s, min_gain_per_mm, failed_moves)
        try:
            result = _move_planes(model, start, cost, executor, goal)
        except DecomposeError as error:
            last_error = error
            continue
        if result is not None:
            return result
    if last_error is not None:
        raise last_error
    return None


class _Goal(NamedTuple):
    """Goal of a move of the planes, and its limits.

    Attributes
    ----------
    best_ratio
        Least sliced makespan so far, divided by that of the decomposition from which the planes move.
    min_gain_per_mm
        Minimum gain for each mm by which planes move, as a share of the makespan, for each part.
    failed_moves
        Decompositions after other moves from there, which did not end sooner.
    """

    best_ratio: float
    min_gain_per_mm: float
    failed_moves: Sequence[SlicedCuts]


def _move_planes(
    model: Model, start: SlicedCuts, cost: CostModel, executor: Executor | None, goal: _Goal
) -> Decomposition | None:
    """Move the planes of a decomposition; None if the gain would be too small.

    Parameters
    ----------
    model, cost, executor
        As in `rebalance_planes`.
    start
        Decomposition from which the planes move.
    goal
        Goal of the move.
    """
    if (cutting := start.decomposition.cutting) is None:
        return None
    previous_result, start_s = start.decomposition, perf_counter()
    options = replace(previous_result.options, engine=Engine.GUILLOTINE, granularity=cutting.granularity)
    effort = Effort(previous_result.options.best.budget_s)
    aligned_problem = Problem(model, cutting.printers, cost, options, executor, effort, is_thorough=True)
    problem = aligned_problem.rotate(cutting.frame)
    search_problem = simplify_problem(problem, simplify_model(model).solid)
    box_pieces = _cut_previous_boxes(search_problem, cutting, start.times_s)
    shifted_pieces = None if box_pieces is None else _shift_planes(search_problem, box_pieces, start, goal)
    if shifted_pieces is None:
        return None
    grid = GridFigures(previous_result.grid_makespan_s, previous_result.lower_bound_s, previous_result.cells)
    partition = Partition(tuple(shifted_pieces), search_problem.model, np.eye(3), grid)
    if search_problem is not problem:
        detailed_partition = cut_detailed_pieces(problem, search_problem, partition)
        if detailed_partition is None:
            return None
        partition = detailed_partition
    result = finish_result(problem, partition, (previous_result.serial_s, previous_result.serial_as_is_s))
    return _copy_history(previous_result, result, perf_counter() - start_s)


def _shift_planes(
    problem: Problem, box_pieces: list[list[Piece]], start: SlicedCuts, goal: _Goal
) -> list[Piece] | None:
    """Move the planes of boxes, given the pieces in each box; None if the gain is too small."""
    old_s = _compute_makespan_s(problem, [piece for pieces in box_pieces for piece in pieces])
    if not math.isfinite(old_s):
        return None
    boxes_mm = np.array([pieces[0].boxes_mm[0] for pieces in box_pieces])
    max_s = (1.0 - MIN_GAIN) * goal.best_ratio * old_s
    stops = tuple(_list_stops(boxes_mm, start, goal.failed_moves, max_s))
    min_gain_s_per_mm = goal.min_gain_per_mm * len(box_pieces) * old_s
    rules = MoveRules(max(min_gain_s_per_mm, MoveRules().min_gain_s_per_mm), stops)
    grid = problem.build_grid(problem.model)
    shifted_pieces = shift_box_planes(problem, grid, boxes_mm, box_pieces, rules=rules)
    return shifted_pieces if _compute_makespan_s(problem, shifted_pieces) <= max_s else None


def _list_stops(
    boxes_mm: Floats, start: SlicedCuts, failed_moves: Sequence[SlicedCuts], max_s: float
) -> Iterator[FaceStop]:
    """Yield the stops of faces half-way to where a part took longer than before, and than `max_s`.

    Which face of the part made its time jump is not known, so all of its faces that moved are stopped.

    Parameters
    ----------
    boxes_mm
        (n, 2, 3) corners of the boxes before the moves.
    start, failed_moves
        Cuts before and after the moves.
    max_s
        Sliced time in seconds.
    """
    old_times_s = _find_box_times_s(boxes_mm, start)
    for moved_cuts in failed_moves:
        assert moved_cuts.decomposition.cutting is not None  # it comes from `_move_planes`
        moved_boxes_mm = moved_cuts.decomposition.cutting.boxes_mm
        distances_mm = np.abs(boxes_mm[:, None] - moved_boxes_mm[None]).sum(axis=(2, 3))
        moved_boxes_mm = moved_boxes_mm[distances_mm.argmin(axis=1)]
        times_s = _find_box_times_s(moved_boxes_mm, moved_cuts)
        for box in np.flatnonzero((times_s > old_times_s) & (times_s > max_s)).tolist():
            moves_mm = moved_boxes_mm[box] - boxes_mm[box]
            for face in zip(*np.nonzero(moves_mm), strict=True):
                limit_mm = float(boxes_mm[box][face] + STOP_SHARE * moves_mm[face])
                yield FaceStop(box, face, limit_mm, bool(moves_mm[face] > 0.0))


def _find_box_times_s(boxes_mm: Floats, cuts: SlicedCuts) -> Floats:
    """Find the time (n,) in seconds of the slowest part in each box (n, 2, 3), on its printer."""
    cutting = cuts.decomposition.cutting
    assert cutting is not None  # planes are moved only with a cutting
    # Printers that are alike are assigned at the end.
    factors = [(printer or cutting.printers[0]).time_factor for printer in cutting.cut_for]
    times_s = np.array(cuts.times_s) * factors
    is_inside = (boxes_mm[:, None] == cutting.boxes_mm[None]).all(axis=(2, 3))
    return np.asarray(np.where(is_inside, times_s, 0.0).max(axis=1))


def _copy_history(previous_result: Decomposition, result: Decomposition, elapsed_s: float) -> Decomposition:
    """Copy the records of a decomposition, such as its attempts, to the result that improves it."""
    return replace(
        result,
        engine=previous_result.engine,
        options=previous_result.options,
        yaw_deg=previous_result.yaw_deg,
        attempts=previous_result.attempts,
        curve=previous_result.curve,
        any_boxes_bound_s=previous_result.any_boxes_bound_s,
        compute_s=previous_result.compute_s
        | {"rebalance": elapsed_s, "total": previous_result.compute_s["total"] + elapsed_s},
    )


def _cut_previous_boxes(
    problem: Problem, cutting: Cutting, sliced_times_s: Sequence[float]
) -> list[list[Piece]] | None:
    """Cut the boxes of a decomposition again; each piece gets the ratio of its sliced time to its price.

    Parameters
    ----------
    problem
        Problem whose model is in the frame of the cuts.
    cutting
        Boxes and printers of the parts.
    sliced_times_s
        Sliced times in the order of the parts.

    Returns
    -------
    list or None
        Pieces in each box; None if they differ from the parts.
    """
    if len(sliced_times_s) != len(cutting.cut_for):
        return None
    # The prices are those of the sliced poses, which may be steadier than the fastest ones.
    prices_s = dict(enumerate(cutting.prices_s))
    parts_by_box: dict[bytes, list[int]] = {}
    for i, box in enumerate(cutting.boxes_mm):
        parts_by_box.setdefault(box.tobytes(), []).append(i)
    box_pieces = []
    for parts in parts_by_box.values():
        pieces = cut_box(problem.model.solid, *cutting.boxes_mm[parts[0]])
        if len(pieces) != len(parts):
            return None
        numbers = [parts[sort_pieces(pieces).index(piece)] for piece in pieces]
        pieces = [
            replace(piece, printer=cutting.cut_for[number])
            for piece, number in zip(pieces, numbers, strict=True)
        ]
        poses = [pose for pose in problem.find_poses(pieces) if pose is not None]
        if len(poses) != len(pieces):
            return None
        box_pieces.append(
            [
                replace(piece, time_ratio=sliced_times_s[number] / (prices_s.get(number) or pose.price_s))
                for piece, number, pose in zip(pieces, numbers, poses, strict=True)
            ]
        )
    return box_pieces


def _compute_makespan_s(problem: Problem, pieces: Sequence[Piece]) -> float:
    """Compute the expected makespan in sliced time; inf if the pieces do not fit the printers."""
    poses = [pose for pose in problem.find_poses(pieces) if pose is not None]
    if len(poses) != len(pieces):
        return math.inf
    scaled_poses = apply_time_ratios(pieces, poses)
    assigned_printers = assign_printers(scaled_poses, problem.printers)
    if assigned_printers is None:
        return math.inf
    return max(
        pose.price_s * printer.time_factor
        for pose, printer in zip(scaled_poses, assigned_printers, strict=True)
    )
