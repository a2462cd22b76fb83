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
    points = curve(problem.boxes(problem.grid(model)), len(printers), executor)
    wanted = len(printers)
    if points:
        best = knee(points, clear_s, assemble_s) if within_s is None else in_time(points, within_s)
        wanted = best.printers
    result = partition.decompose(model, printers[:wanted], options, cost, executor)
    return replace(result, curve=points)
