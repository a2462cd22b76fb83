"""Choice of the number of printers for any engine, from the makespan curve of the engine `guillotine`."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from decompose.decompose import decompose_model
from decompose.detailed_models import simplify_model, simplify_problem
from decompose.engines.guillotine import (
    ASSEMBLY_S,
    CLEARING_S,
    CurvePoint,
    classify_printers,
    compute_makespan_curve,
    find_fewest_printers_in_time,
    find_least_total_time,
    make_class_tables,
)
from decompose.errors import NoFit
from decompose.geometry import Model
from decompose.options import Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem, validate_problem
from decompose.results import Decomposition

MAX_BOX_DIVISIONS = 1e8
"""Maximum product of two numbers: the boxes in the tables, and the ways to divide the printers between the
two sides of a cut. With this product, a search for one time limit of the curve takes about one second.
Classes of printers are merged until the product is small enough."""


@dataclass(frozen=True, slots=True)
class CountGoal:
    """Goal that decides how many printers are used.

    Attributes
    ----------
    clearing_s, assembly_s
        Time in seconds that a person needs for each part: to take it off the bed, and to glue it. Without a
        time limit, the sum of the makespan and these times of all parts is minimised.
    time_limit_s
        Time limit in seconds for printing all parts. The fewest printers that meet it are used. If no
        number of printers meets it, the number that finishes first is used.
    includes_gluing
        Whether the time limit also includes gluing the parts.
    """

    clearing_s: float = CLEARING_S
    assembly_s: float = ASSEMBLY_S
    time_limit_s: float | None = None
    includes_gluing: bool = False

    def choose_point(self, points: Sequence[CurvePoint]) -> CurvePoint:
        """Choose the point of a curve that suits the goal."""
        if self.time_limit_s is None:
            return find_least_total_time(points, self.clearing_s, self.assembly_s)
        return find_fewest_printers_in_time(
            points, self.time_limit_s, self.assembly_s if self.includes_gluing else 0.0
        )


def decompose_for_goal(
    model: Model,
    printers: Sequence[TargetPrinter],
    options: Options,
    cost: CostModel,
    executor: Executor | None = None,
    goal: CountGoal = CountGoal(),
) -> Decomposition:
    """Cut a model for the number of printers that suits a goal.

    The number is chosen from the makespans on the first 1, 2, ... printers. These makespans are computed on
    one grid, and take the build volumes and speeds of the printers into account. If the parts turn out to
    need more printers, all printers are used.

    Parameters
    ----------
    model, options, cost, executor
        As in `decompose.decompose_model`.
    printers
        Free printers, the best ones first.
    goal
        Goal that decides the number of printers.

    Raises
    ------
    NoFit, GeometryError
        As in `decompose.decompose_model`, if even all printers are not enough.
    """
    validate_problem(model, tuple(printers), options)
    points = build_curve(Problem(model, tuple(printers), cost, options, executor))
    printer_count = goal.choose_point(points).printer_count if points else len(printers)
    try:
        result = decompose_model(model, printers[:printer_count], options, cost, executor)
    except NoFit:
        if printer_count == len(printers):
            raise
        result = decompose_model(model, printers, options, cost, executor)
    return replace(result, curve=points)


def build_curve(problem: Problem) -> tuple[CurvePoint, ...]:
    """Compute the makespan on the first 1, 2, ... printers from the tables of a grid (`BoxTables`).

    Numbers of printers that are too small for any partition are omitted.

    If the printers differ, they are grouped into classes and the grid is coarser, because parts can be
    distributed among different printers in more ways. A class has the speed of its slowest printer, so each
    makespan is multiplied by the ratio of the printers' mean time factor to that of their classes.

    Parameters
    ----------
    problem
        Problem with all printers, the best ones first.
    """
    problem = simplify_problem(problem, simplify_model(problem.model).solid)
    printers = problem.printers
    grid_problem = problem if problem.is_uniform else replace(problem, printers=problem.distinct_printers)
    grid = grid_problem.build_grid(problem.model)
    shared_boxes = problem.price_boxes(grid)
    classes = classify_printers(printers, MAX_BOX_DIVISIONS / len(shared_boxes.seconds))
    class_indices = [
        next(i for i, printer_class in enumerate(classes) if printer in printer_class.printers)
        for printer in printers
    ]
    fleets = np.cumsum(np.eye(len(classes), dtype=np.int64)[class_indices], axis=0)
    points = compute_makespan_curve(
        make_class_tables(problem, grid, shared_boxes, classes), fleets, problem.executor
    )
    class_factors = [classes[i].time_factor for i in class_indices]
    printer_factors = [printer.time_factor for printer in printers]
    return tuple(
        replace(
            p,
            makespan_s=p.makespan_s
            * _compute_mean_factor(printer_factors[: p.printer_count])
            / _compute_mean_factor(class_factors[: p.printer_count]),
        )
        for p in points
    )


def _compute_mean_factor(factors: Sequence[float]) -> float:
    """Compute the harmonic mean of time factors: printers share work in proportion to their speeds."""
    return len(factors) / sum(1.0 / factor for factor in factors)
