"""The engine `best`: others in a fixed order, then the guillotine engine on more grids, within a budget."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from time import perf_counter

from decompose.effort import Effort
from decompose.errors import DecomposeError, GeometryError, NoFit
from decompose.grid import cell_counts
from decompose.problem import FINEST, Problem
from decompose.report import Attempt, Decomposition, Engine

TRIED_BY_BEST = (Engine.GUILLOTINE, Engine.PARALLELOBOX)
OTHER_GRIDS = (1.1, 0.95, 0.9)  # cells a side for each one of the first grid: what fits a grid is partly luck
NEAR = 0.03  # share of the makespan that has to be left to gain, so that another grid is worth its work


def best_of(problem: Problem, by_engine: Callable[[Problem], Decomposition]) -> Decomposition:
    """The best result, as far as the budget goes; the first engine is always begun.

    Parameters
    ----------
    by_engine
        The result of the engine that the problem's options name.

    Raises
    ------
    NoFit, GeometryError
        Of the first engine, where none has a result.
    """
    options = problem.options
    best: Decomposition | None = None
    attempts: list[Attempt] = []
    failure: DecomposeError | None = None
    left_s = options.budget_s
    for engine, cells in _tried(problem):
        if best is not None and cells != options.granularity and best.to_gain(problem.printers) < NEAR:
            break
        if attempts and left_s <= 0.0:
            attempts.append(Attempt(engine, cells, finished=False, reason="not begun: the budget was spent"))
            continue
        began_s, effort, makespan_s, reason = perf_counter(), Effort(left_s), None, ""
        of_one = replace(options, engine=engine, granularity=cells)
        to_beat_s = math.inf if best is None or best.faults else best.makespan_s
        try:
            found = by_engine(replace(problem, options=of_one, effort=effort, to_beat_s=to_beat_s))
            makespan_s = found.makespan_s
            best = found if best is None else min(best, found, key=_rank)
        except (NoFit, GeometryError) as error:
            failure = failure or error
            late = effort.cut_short and isinstance(error, NoFit)
            reason = "nothing was found before the budget was spent" if late else str(error)
        took_s = perf_counter() - began_s
        attempts.append(
            Attempt(engine, cells, makespan_s, took_s, effort.seconds, not effort.cut_short, reason)
        )
        left_s -= effort.seconds
    if best is None:
        assert failure is not None  # the first engine is always tried
        raise failure
    return replace(best, options=options, attempts=tuple(attempts))


def _tried(problem: Problem) -> Iterator[tuple[Engine, str | int]]:
    """Engines, each with its granularity; where nobody asked for one, other grids after them, none twice."""
    options, extents_mm = problem.options, problem.model.extents_mm
    yield from ((engine, options.granularity) for engine in TRIED_BY_BEST)
    if options.granularity != "auto" or len(problem.printers) == 1:
        return
    first = problem.granularity(problem.model)
    shapes = {cell_counts(extents_mm, first)}
    for share in OTHER_GRIDS:
        cells = min(FINEST, round(share * first))
        shape = cell_counts(extents_mm, cells)
        if shape not in shapes:
            shapes.add(shape)
            yield Engine.GUILLOTINE, cells


def _rank(result: Decomposition) -> tuple[bool, float, int]:
    """Less is better."""
    return bool(result.faults), result.makespan_s, len(result.parts)
