"""Largest size at which a model fits the printers, found on a coarse grid and then checked."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

from decompose.decompose import decompose_model
from decompose.detailed_models import simplify_model
from decompose.engines.guillotine import Partitioner
from decompose.errors import GeometryError, ModelNotSolid, NoFit
from decompose.geometry import Model, Solid
from decompose.options import BestOptions, Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem

COARSE_GRANULARITY = 8  # granularity of the grid on which sizes are sought
MAX_HALVINGS = 8  # maximum number of times that the range of sizes is halved
# The search ends when the smallest size without a result is at most this multiple of the largest one with a
# result.
CLOSE_RATIO = 1.005
MAX_TRIALS = 4  # maximum number of decompositions at full granularity, each of a smaller model
TRIAL_SIZE_RATIO = 0.96  # ratio of the size in a trial to the size in the previous trial
TRIAL_BUDGET_S = 2.0  # budget of a trial: enough to find some result


def advise_longest_side_mm(
    model: Model,
    printers: Sequence[TargetPrinter],
    options: Options,
    cost: CostModel,
    executor: Executor | None = None,
) -> int | None:
    """Find a smaller length of the longest side, at which a model that is too large fits the printers.

    Parameters
    ----------
    model, printers, options, cost, executor
        Arguments of the decomposition that failed.

    Returns
    -------
    int | None
        Size in whole mm, close to the largest one with a result; None if there is none.
    """
    longest_side_mm = float(model.extents_mm.max())
    model = simplify_model(model)
    max_scale = _estimate_max_scale(model, printers, options, cost)
    if max_scale is None:
        return None
    coarse_options = replace(options, granularity=COARSE_GRANULARITY)
    low, high = 0.0, max_scale * 1.15  # a part may fit at an angle, which the estimate ignores
    scale = max_scale
    for _ in range(MAX_HALVINGS):
        if _has_result(model, scale, printers, coarse_options, cost, executor):
            low = scale
        else:
            high = scale
        if high <= low * CLOSE_RATIO:
            break
        scale = (low + high) / 2.0 if low else TRIAL_SIZE_RATIO * high
    side_mm = math.floor((low or max_scale) * longest_side_mm)
    for _ in range(MAX_TRIALS):
        if side_mm < 1:
            break
        if _has_result(model, side_mm / longest_side_mm, printers, options, cost, executor):
            return side_mm
        side_mm = math.floor(TRIAL_SIZE_RATIO * side_mm)
    return None


def _estimate_max_scale(
    model: Model, printers: Sequence[TargetPrinter], options: Options, cost: CostModel
) -> float | None:
    """Estimate the largest scale, at most 1, at which there are enough printers for the parts of a model.

    The number of parts is computed on a coarse grid. Instead of shrinking the grid, the build volumes are
    enlarged. Print times are ignored.
    """
    problem = Problem(model, tuple(printers), cost, replace(options, granularity=COARSE_GRANULARITY))
    grid = problem.build_grid(model)
    low, high = 0.0, 1.0
    # At this scale, the model is about as large as one part.
    scale = min(1.0, max(problem.max_part_sides_mm) / float(model.extents_mm.max()))
    for _ in range(MAX_HALVINGS):
        box_tables = problem.price_boxes(
            grid, [_scale_volume(p, 1.0 / scale) for p in problem.distinct_printers]
        )
        if Partitioner(box_tables).solve(sys.float_info.max) <= len(printers):
            low = scale
        else:
            high = scale
        if high <= low * CLOSE_RATIO:
            break
        scale = (low + high) / 2.0
    return low or None


def _scale_volume(printer: TargetPrinter, scale: float) -> TargetPrinter:
    """Scale the build volume of a printer."""
    return replace(
        printer, box_sizes_mm=tuple((scale * x, scale * y, scale * z) for x, y, z in printer.box_sizes_mm)
    )


def _has_result(
    model: Model,
    scale: float,
    printers: Sequence[TargetPrinter],
    options: Options,
    cost: CostModel,
    executor: Executor | None,
) -> bool:
    """Check by a short search whether a scaled model can be cut for these printers."""
    vertices, faces = model.solid.arrays()
    scaled_model = replace(model, solid=Solid.from_arrays(scale * vertices, faces))
    engine = Engine.BEST if options.engine is Engine.GUILLOTINE else options.engine
    trial_options = replace(options, engine=engine, prove=False, best=BestOptions(TRIAL_BUDGET_S))
    try:
        decompose_model(scaled_model, printers, trial_options, cost, executor)
    except (NoFit, GeometryError, ModelNotSolid):
        return False
    return True
