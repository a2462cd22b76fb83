"""Decomposition of a model into checked parts for some printers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.best import find_best
from decompose.bound import bound_any_boxes_s
from decompose.engines import ENGINES, apply_paper_settings
from decompose.geometry import Model, Solid
from decompose.options import Engine, Interior, Options
from decompose.print_time import POSE_ROTATIONS, CostModel, find_best_pose, measure_pose
from decompose.printers import PrinterRoom
from decompose.problem import Problem, validate_problem
from decompose.results import Decomposition, finish_result

PRICED_FACES = 300_000  # maximum number of faces of a priced whole model; twice as many change it by 0.5 %
PRICE_TOLERANCES_MM = (0.02, 0.05)


def decompose_model(
    model: Model,
    printers: Sequence[PrinterRoom],
    options: Options,
    cost: CostModel,
    executor: Executor | None = None,
) -> Decomposition:
    """Cut a model into parts that finish together.

    Parameters
    ----------
    model
        Model of `decompose.geometry.load_model`.
    printers
        Free printers, each for one part at most; a printer that may print in several rounds appears once for
        each. The engine `guillotine` cuts a part for the room and the speed of its own printer; the parts of
        other engines fit all printers.
    options
        Engine, grid and limits.
    cost
        Print time of a part.
    executor
        Threads for work that may run in parallel; None to run it serially.

    Raises
    ------
    NoFit
        There are more parts than printers; the error has the number of printers that would be enough.
    GeometryError
        The result breaks a geometry rule.
    """
    began_s = perf_counter()
    validate_problem(model, tuple(printers), options)
    vertices, faces = simplify_for_price(model.solid).arrays()
    problem = Problem(model, tuple(printers), cost, options, executor)
    serial = problem.start(partial(estimate_serial_s, vertices, faces, cost, options.fit_first_layer))
    serial_wall_s = perf_counter() - began_s
    run_with_serial = partial(run_engine, serial=serial)
    partition = (
        find_best(problem, run_with_serial) if options.engine is Engine.BEST else run_with_serial(problem)
    )
    partition = _add_bound(problem, partition)
    stages = partition.compute_s | {"serial": serial_wall_s, "total": perf_counter() - began_s}
    return replace(partition, compute_s=stages)


def run_engine(problem: Problem, serial: Callable[[], tuple[float, float]]) -> Decomposition:
    """Run the engine that the options name, and check its result.

    Parameters
    ----------
    problem
        Problem with the options.
    serial
        Function that returns the result of `estimate_serial_s`.
    """
    watch = _StageTimes()
    if problem.options.faithful and problem.options.engine is Engine.PARALLELOBOX:
        problem = replace(problem, options=apply_paper_settings(problem.options))
    problem = replace(problem, on_stage=watch.record_stage)
    partition = ENGINES[problem.options.engine](problem)
    watch.record_stage("engine")
    return replace(finish_result(problem, partition, serial()), compute_s=watch.list_stage_times())


def _add_bound(problem: Problem, result: Decomposition) -> Decomposition:
    """Add the bound for boxes on any grid to a result of the engine `guillotine`, if bounds are requested.

    A model with very many faces is simplified, as for its price.
    """
    if result.cutting is None or not problem.options.prove:
        return result
    solid = simplify_for_price(problem.model.solid.rotate(result.cutting.frame))
    vertices, faces = solid.arrays()
    keeps_interior = problem.options.interior is Interior.KEEP
    bound_s = bound_any_boxes_s(
        vertices[faces],
        problem.printers,
        problem.cost,
        math.inf if keeps_interior else problem.options.min_wall_mm,
        min(result.makespan_s, result.lower_bound_s),
    )
    return replace(result, any_boxes_bound_s=bound_s)


def simplify_for_price(solid: Solid) -> Solid:
    """Simplify a solid with millions of faces, whose price hardly changes; return any other unchanged."""
    simplified = solid
    for tolerance_mm in PRICE_TOLERANCES_MM:
        if simplified.faces <= PRICED_FACES:
            break
        simplified = solid.simplify(tolerance_mm)
    return simplified


def estimate_serial_s(
    vertices: Floats, faces: Ints, cost: CostModel, fit_first_layer: bool
) -> tuple[float, float]:
    """Price a whole model on a printer without limits.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh, outward.
    cost
        Print time of a part.
    fit_first_layer
        Whether the brim and the first layer's expansion are chosen too.

    Returns
    -------
    tuple
        Seconds in its best pose, and in the pose of the file.
    """
    uncut = np.zeros(len(faces), dtype=np.bool_)
    best = find_best_pose(vertices, faces, uncut, (), cost, fit_first_layer)
    as_is = measure_pose(vertices, faces, uncut, POSE_ROTATIONS[4], cost, fit_first_layer)
    assert best is not None  # no model is too large for a printer without limits
    return best.price_s, as_is.price_s


class _StageTimes:
    """Wall time by stage."""

    def __init__(self) -> None:
        self._start_s = self._stage_start_s = perf_counter()
        self._stage_times_s: dict[str, float] = {}

    def record_stage(self, stage: str) -> None:
        """Record the time since the end of the last stage."""
        now_s = perf_counter()
        self._stage_times_s[stage] = now_s - self._stage_start_s
        self._stage_start_s = now_s

    def list_stage_times(self) -> dict[str, float]:
        """List the seconds of each stage, and of all together."""
        return {**self._stage_times_s, "total": self._stage_start_s - self._start_s}
