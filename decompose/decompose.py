"""Decomposition of a model into checked parts for given printers."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np

from decompose.arrays import Floats, Ints
from decompose.best import find_best_result
from decompose.bound import bound_shared_work_s, sum_least_work_s
from decompose.detailed_models import (
    BOX_ENGINES,
    cut_detailed_pieces,
    is_too_detailed,
    simplify_problem,
    simplify_solid,
)
from decompose.engines import ENGINES, apply_paper_settings
from decompose.errors import GeometryError, ModelNotSolid, NoFit
from decompose.geometry import Model, Solid
from decompose.options import Engine, Interior, Options
from decompose.pieces import find_faults
from decompose.print_time import CostModel, find_best_pose, measure_pose
from decompose.printers import TargetPrinter
from decompose.problem import Partition, Problem, validate_problem
from decompose.results import Decomposition, finish_result


def decompose_model(
    model: Model,
    printers: Sequence[TargetPrinter],
    options: Options,
    cost: CostModel,
    executor: Executor | None = None,
) -> Decomposition:
    """Cut a model into parts whose prints end at about the same time.

    Parameters
    ----------
    model
        Model from `decompose.geometry.load_model`.
    printers
        Free printers, each of which gets at most one part; a printer that may print several parts in turn
        appears once for each of them. The engine `guillotine` cuts a part for the build volume and the speed
        of its own printer; the parts of other engines fit all printers.
    options
        Engine, grid and limits.
    cost
        Cost model for print times.
    executor
        Threads for work that may run in parallel; None to run it serially.

    Raises
    ------
    NoFit
        There are more parts than printers; the error gives the number of printers that would be enough.
    GeometryError
        The result breaks a geometry rule.
    """
    start_s = perf_counter()
    validate_problem(model, tuple(printers), options)
    simple_solid = simplify_solid(model.solid)
    vertices, faces = simple_solid.arrays()
    problem = Problem(model, tuple(printers), cost, options, executor)
    get_serial_s = problem.start_work(
        partial(estimate_serial_s, vertices, faces, cost, options.fit_first_layer)
    )
    serial_wall_s = perf_counter() - start_s
    # The model is usually cut along its own axes. The least work for cuts along them is summed here, before
    # the search needs all processors.
    get_least_work_s = problem.start_work(partial(_sum_least_work_s, problem, vertices[faces]))
    engine_runner = partial(run_engine, get_serial_s=get_serial_s, simple_solid=simple_solid)
    result = (
        find_best_result(problem, engine_runner) if options.engine is Engine.BEST else engine_runner(problem)
    )
    result = _add_bound(problem, result, get_least_work_s, simple_solid)
    compute_s = result.compute_s | {"serial": serial_wall_s, "total": perf_counter() - start_s}
    return replace(result, compute_s=compute_s)


def run_engine(
    problem: Problem, get_serial_s: Callable[[], tuple[float, float]], simple_solid: Solid
) -> Decomposition:
    """Run the engine that the options name, and check its result.

    Parameters
    ----------
    problem
        Problem with the options.
    get_serial_s
        Function that returns the result of `estimate_serial_s`.
    simple_solid
        Result of `simplify_solid` for the model in the frame of the input; it is used only if the model is
        too detailed for a search.

    Raises
    ------
    NoFit, GeometryError, ModelNotSolid
        The engine finds no partition, or its result breaks a geometry rule.
    """
    stage_times = _StageTimes()
    if problem.options.faithful and problem.options.engine is Engine.PARALLELOBOX:
        problem = replace(problem, options=apply_paper_settings(problem.options))
    problem = replace(problem, on_stage=stage_times.record_stage)
    result: Decomposition | None = None
    if is_too_detailed(problem.model) and problem.options.engine in BOX_ENGINES:
        result = _search_simplified_model(problem, get_serial_s, simple_solid)
    if result is None:
        partition = ENGINES[problem.options.engine](problem)
        problem.on_stage("engine")
        result = finish_result(problem, partition, get_serial_s())
    return replace(result, compute_s=stage_times.list_stage_times())


def _search_simplified_model(
    problem: Problem, get_serial_s: Callable[[], tuple[float, float]], simple_solid: Solid
) -> Decomposition | None:
    """Search in a simplified copy of a very detailed model, and cut the parts out of the model itself.

    The result is None if the parts of the model differ too much from those of the copy. Then the model has to
    be searched itself, with the same budget again.

    Raises
    ------
    NoFit
        There is no partition of the copy, or the parts differ but there is a result of an earlier attempt.
    """
    result: Decomposition | None = None
    with contextlib.suppress(GeometryError, ModelNotSolid):
        simple_problem = simplify_problem(problem, simple_solid)
        partition = ENGINES[problem.options.engine](simple_problem)
        problem.on_stage("engine")
        result = _finish_detailed_parts(problem, simple_problem, partition, get_serial_s)
    if result is None and math.isfinite(problem.best_known_s):
        raise NoFit("the parts of the model differ from those of its simplified copy, or break a rule")
    if result is None:
        problem.effort.restart()
    return result


def _finish_detailed_parts(
    problem: Problem,
    simple_problem: Problem,
    partition: Partition,
    get_serial_s: Callable[[], tuple[float, float]],
) -> Decomposition | None:
    """Cut the parts of a partition of the simplified copy out of the model itself, and finish them.

    The result is None if the parts differ from those of the copy, fit fewer printers, or have faults that the
    parts of the copy do not have.
    """
    detailed_partition = cut_detailed_pieces(problem, simple_problem, partition)
    problem.on_stage("details")
    if detailed_partition is None:
        return None
    try:
        result = finish_result(problem, detailed_partition, get_serial_s())
    except NoFit:
        return None
    has_new_faults = result.faults and not find_faults(partition.pieces, problem.options.min_glue_mm2)
    return None if has_new_faults else result


def _add_bound(
    problem: Problem,
    result: Decomposition,
    get_least_work_s: Callable[[], float | None],
    simple_solid: Solid,
) -> Decomposition:
    """Add to a result of the engine `guillotine` the lower bound for partitions into boxes of any kind.

    The boxes may be on the grid or not. Nothing is added if no proven bound is requested. A model with very
    many faces is simplified, as for its price.

    Parameters
    ----------
    problem, result
        Problem and result.
    get_least_work_s
        Function that returns the result of `_sum_least_work_s` for the model in its own frame.
    simple_solid
        Result of `simplify_solid` for the model in its own frame.
    """
    if result.cutting is None:
        return result
    work_s = get_least_work_s()
    if not np.array_equal(result.cutting.frame, np.eye(3)):
        vertices, faces = simple_solid.rotate(result.cutting.frame).arrays()
        work_s = _sum_least_work_s(problem, vertices[faces])
    if work_s is None:
        return result
    known_s = min(result.makespan_s, result.lower_bound_s)
    bound_s = bound_shared_work_s(work_s, problem.printers, problem.cost, known_s)
    return replace(result, any_boxes_bound_s=bound_s)


def _sum_least_work_s(problem: Problem, triangles: Floats) -> float | None:
    """Compute a lower bound on the total work of any parts into which a mesh (m, 3, 3) is cut.

    The result is None if no proven bound is requested.
    """
    is_bounded = problem.options.prove and problem.options.engine in (Engine.BEST, Engine.GUILLOTINE)
    if not is_bounded:
        return None
    keeps_interior = problem.options.interior is Interior.KEEP
    wall_mm = math.inf if keeps_interior else problem.options.min_wall_mm
    return sum_least_work_s(triangles, problem.printers, problem.cost, wall_mm)


def estimate_serial_s(
    vertices: Floats, faces: Ints, cost: CostModel, fit_first_layer: bool
) -> tuple[float, float]:
    """Price a whole model on an imaginary printer that is large enough.

    Parameters
    ----------
    vertices, faces
        (n, 3) in mm and (m, 3) of a closed mesh whose faces point outward.
    cost
        Cost model for print times.
    fit_first_layer
        Whether the widths of the brim and of the first-layer expansion are also chosen.

    Returns
    -------
    tuple
        Seconds in its best pose, and in the pose of the file.
    """
    is_cut = np.zeros(len(faces), dtype=np.bool_)
    best_pose = find_best_pose(vertices, faces, is_cut, (), cost, fit_first_layer)
    file_pose = measure_pose(vertices, faces, is_cut, np.eye(3), cost, fit_first_layer)
    assert best_pose is not None  # no model is too large for a printer without limits
    return best_pose.price_s, file_pose.price_s


class _StageTimes:
    """Wall time by stage."""

    def __init__(self) -> None:
        self._start_s = self._stage_start_s = perf_counter()
        self._stage_times_s: dict[str, float] = {}

    def record_stage(self, stage: str) -> None:
        """Record a stage that has just ended, with the time since the end of the previous stage.

        The times of stages with the same name are added up.
        """
        now_s = perf_counter()
        self._stage_times_s[stage] = self._stage_times_s.get(stage, 0.0) + now_s - self._stage_start_s
        self._stage_start_s = now_s

    def list_stage_times(self) -> dict[str, float]:
        """List the seconds of each stage, and their total."""
        return {**self._stage_times_s, "total": self._stage_start_s - self._start_s}
