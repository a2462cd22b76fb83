"""As many of the printers as are worth it: the number from the curve of the exact engine, the cut by any."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

from decompose import partition
from decompose.cost import CostModel, PrinterRoom
from decompose.curve import ASSEMBLE_S, CLEAR_S, curve, in_time, knee
from decompose.mesh import Model
from decompose.problem import Problem, checked
from decompose.report import Decomposition, Options


def decompose(
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
    """Cut a model for the first of the printers, so many that printing and handling take least together.

    The number is chosen as if all had the room that they share, and their mean speed; where that room takes
    too many parts, all printers are taken.

    Parameters
    ----------
    printers
        Those that are free, the best ones first; see `partition.decompose`.
    clear_s, assemble_s
        What a person is busy with each part: to make its bed clear, and to put it to the others.
    within_s
        Where the parts have to be printed within that: as few of them as are, or the soonest.

    Raises
    ------
    NoFit, GeometryError
        As `partition.decompose`, where all of the printers are not enough.
    """
    checked(model, tuple(printers), options)
    problem = Problem(model, tuple(printers), cost, options, executor)
    points = [
        replace(point, makespan_s=point.makespan_s * _mean_factor(printers[: point.printers]))
        for point in curve(problem.boxes(problem.grid(model)), len(printers), executor)
    ]
    wanted = len(printers)
    if points:
        best = knee(points, clear_s, assemble_s) if within_s is None else in_time(points, within_s)
        wanted = best.printers
    result = partition.decompose(model, printers[:wanted], options, cost, executor)
    return replace(result, curve=tuple(points))


def _mean_factor(printers: Sequence[PrinterRoom]) -> float:
    """Of what these printers can do together: parts that end together are as long as each is quick."""
    return len(printers) / sum(1.0 / printer.time_factor for printer in printers)
