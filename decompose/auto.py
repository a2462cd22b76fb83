"""Choice of the number of printers: by the curve of the guillotine engine; any engine cuts then."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from decompose.decompose import decompose_model
from decompose.engines.guillotine import (
    ASSEMBLE_S,
    CLEAR_S,
    CurvePoint,
    class_tables,
    classify_printers,
    find_fewest_in_time,
    find_knee,
    makespan_curve,
)
from decompose.errors import NoFit
from decompose.geometry import Model
from decompose.options import Options
from decompose.print_time import CostModel
from decompose.printers import PrinterRoom
from decompose.problem import Problem, validate_problem
from decompose.results import Decomposition

MAX_SUMS = 1e8  # of the curve of unequal printers, over all boxes: about a second for each limit


def decompose_auto(
    model: Model,
    printers: Sequence[PrinterRoom],
    options: Options,
    cost: CostModel,
    executor: Executor | None = None,
    *,
    clear_s: float = CLEAR_S,
    assemble_s: float = ASSEMBLE_S,
    within_s: float | None = None,
) -> Decomposition:
    """Cut a model for as many of the first printers as makes printing plus handling take least.

    The number is chosen from the curve of what the first of them reach by the tables, with the rooms and the
    speeds that they have; where they turn out too few for the true parts, all printers are taken.

    Parameters
    ----------
    printers
        Those that are free, the best ones first; see `decompose.decompose_model`.
    clear_s, assemble_s
        What a person is busy with each part: to make its bed clear, and to put it to the others.
    within_s
        Where the parts have to be printed within that: as few of them as are, or the soonest.

    Raises
    ------
    NoFit, GeometryError
        As `decompose.decompose_model`, where all of the printers are not enough.
    """
    validate_problem(model, tuple(printers), options)
    points = build_curve(Problem(model, tuple(printers), cost, options, executor))
    wanted = len(printers)
    if points:
        best = (
            find_knee(points, clear_s, assemble_s)
            if within_s is None
            else find_fewest_in_time(points, within_s)
        )
        wanted = best.printers
    try:
        result = decompose_model(model, printers[:wanted], options, cost, executor)
    except NoFit:
        if wanted == len(printers):
            raise
        result = decompose_model(model, printers, options, cost, executor)
    return replace(result, curve=points)


def build_curve(problem: Problem) -> tuple[CurvePoint, ...]:
    """Makespan of the first 1, 2, ... of a problem's printers by the tables, where they are enough.

    Unequal printers are taken in classes, on a grid as for few of them, since there are more ways to share
    parts out; within a class each number has the mean speed of its printers.
    """
    printers = problem.printers
    gridded = problem if problem.is_uniform else replace(problem, printers=problem.rooms)
    grid = gridded.build_grid(problem.model)
    shared = problem.price_boxes(grid)
    classes = classify_printers(printers, MAX_SUMS / len(shared.seconds))
    own = [next(i for i, each in enumerate(classes) if printer in each.printers) for printer in printers]
    fleets = np.cumsum(np.eye(len(classes), dtype=np.int64)[own], axis=0)
    points = makespan_curve(class_tables(problem, grid, shared, classes), fleets, problem.executor)
    taken_s = [classes[i].time_factor for i in own]
    real_s = [printer.time_factor for printer in printers]
    return tuple(
        replace(p, makespan_s=p.makespan_s * _mean(real_s[: p.printers]) / _mean(taken_s[: p.printers]))
        for p in points
    )


def _mean(factors: Sequence[float]) -> float:
    """Harmonic mean of time factors: parts that end together are as long as each printer is fast."""
    return len(factors) / sum(1.0 / factor for factor in factors)
