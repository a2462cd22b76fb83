"""Moves of the cut planes based on sliced times: the print times that the slicer computes for the parts.

Prices of parts have errors of one or two per cent, and a job waits for the part that is underestimated most.
The error hardly changes when the faces of a part move by a few millimetres. So each part keeps its ratio of
sliced time to price, and the planes are moved again, with each price multiplied by this ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from time import perf_counter

import numpy as np

from decompose.detailed_models import cut_detailed_pieces, simplify_model, simplify_problem
from decompose.engines.guillotine import shift_box_planes
from decompose.geometry import Model
from decompose.options import Engine
from decompose.pieces import Piece, assign_printers, cut_box, sort_pieces
from decompose.print_time import CostModel
from decompose.problem import Effort, GridFigures, Partition, Problem
from decompose.results import Cutting, Decomposition, apply_time_ratios, finish_result

MIN_GAIN = 0.005  # minimum expected gain, as a share of the makespan, for which all parts are sliced again


def rebalance_planes(
    model: Model,
    previous_result: Decomposition,
    sliced_times_s: Sequence[float],
    cost: CostModel,
    executor: Executor | None = None,
    best_ratio: float = 1.0,
) -> Decomposition | None:
    """Move the cut planes so that the part with the longest sliced time ends sooner.

    Where the time of a part jumps as one of its faces moves, the sliced times after the move may differ from
    the expected ones, and may even be longer. The next move, which starts from these sliced times, takes the
    jump into account.

    Parameters
    ----------
    model
        Model that was decomposed.
    previous_result
        Decomposition of the model; its parts, joints and faults may be left out
        (`Decomposition.without_parts`).
    sliced_times_s
        Sliced time of each part in seconds.
    cost
        Cost model of that decomposition.
    executor
        Threads for work that may run in parallel; None to run it serially.
    best_ratio
        Least sliced makespan of any decomposition so far, divided by the sliced makespan of
        `previous_result`. Only the ratio is used, because the caller's makespans may include other times,
        such as that of heating up.

    Returns
    -------
    Decomposition | None
        Decomposition into the same number of parts, with the times of the cost model. None if the gain over
        the best decomposition would be too small to slice the parts again, if the parts were not cut by the
        engine `guillotine`, or if a very detailed model has other pieces in the new boxes than its copy.

    Raises
    ------
    NoFit, GeometryError
        The new parts do not fit the printers, or the result breaks a geometry rule.
    """
    if (cutting := previous_result.cutting) is None:
        return None
    start_s = perf_counter()
    options = replace(previous_result.options, engine=Engine.GUILLOTINE, granularity=cutting.granularity)
    effort = Effort(previous_result.options.best.budget_s)
    aligned_problem = Problem(model, cutting.printers, cost, options, executor, effort, is_thorough=True)
    problem = aligned_problem.rotate(cutting.frame)
    search_problem = simplify_problem(problem, simplify_model(model).solid)
    box_pieces = _cut_previous_boxes(search_problem, cutting, sliced_times_s)
    shifted_pieces = None if box_pieces is None else _shift_planes(search_problem, box_pieces, best_ratio)
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


def _shift_planes(problem: Problem, box_pieces: list[list[Piece]], best_ratio: float) -> list[Piece] | None:
    """Move the planes of boxes, given the pieces in each box; None if the gain is too small."""
    boxes_mm = np.array([pieces[0].boxes_mm[0] for pieces in box_pieces])
    shifted_pieces = shift_box_planes(problem, problem.build_grid(problem.model), boxes_mm, box_pieces)
    old_s = _compute_makespan_s(problem, [piece for pieces in box_pieces for piece in pieces])
    max_s = (1.0 - MIN_GAIN) * best_ratio * old_s
    return shifted_pieces if _compute_makespan_s(problem, shifted_pieces) <= max_s else None


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
