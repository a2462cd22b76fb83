"""One attempt of the engine `best`: an engine on a grid, with the model rotated about z."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

from scipy.spatial.transform import Rotation

from decompose.errors import DecomposeError, GeometryError, ModelNotSolid, NoFit
from decompose.options import Engine
from decompose.problem import Effort, Problem
from decompose.results import Attempt, Decomposition

EngineRunner = Callable[[Problem], Decomposition]
"""Function that returns the checked result of the engine that a problem's options name."""


@dataclass(frozen=True, slots=True)
class PlannedAttempt:
    """Engine, grid, angle and budget of an attempt that is to be made.

    Attributes
    ----------
    engine, granularity
        Engine, and the granularity of its grid.
    yaw_deg
        Angle by which the model is rotated about z.
    budget_s
        Budget of the attempt (see `problem.Effort`).
    """

    engine: Engine
    granularity: str | int
    yaw_deg: float = 0.0
    budget_s: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Outcome of an attempt: its record, and its result or the error that prevented a result."""

    attempt: Attempt
    result: Decomposition | None = None
    error: DecomposeError | None = None


def make_attempt(
    problem: Problem,
    run_engine: EngineRunner,
    planned_attempt: PlannedAttempt,
    best_known_s: float,
    on_spent: Callable[[float], None] | None = None,
) -> Outcome:
    """Make one attempt.

    Parameters
    ----------
    problem, run_engine
        As in `find_best_result`.
    planned_attempt
        Engine, grid, angle and budget.
    best_known_s
        Makespan to beat.
    on_spent
        Function that is called with the spent effort in seconds (see `problem.Effort`).
    """
    effort = Effort(planned_attempt.budget_s, on_spent=on_spent)
    options = replace(problem.options, engine=planned_attempt.engine, granularity=planned_attempt.granularity)
    attempt_problem = replace(
        rotate_about_z(problem, planned_attempt.yaw_deg),
        options=options,
        effort=effort,
        best_known_s=best_known_s,
        is_thorough=True,
    )
    start_s, makespan_s, reason = perf_counter(), None, ""
    result: Decomposition | None = None
    failure: DecomposeError | None = None
    try:
        result = replace(run_engine(attempt_problem), yaw_deg=planned_attempt.yaw_deg)
        makespan_s = result.makespan_s
    except (NoFit, GeometryError, ModelNotSolid) as error:
        failure = error
        is_out_of_budget = effort.is_cut_short and isinstance(error, NoFit)
        reason = "nothing was found before the budget was spent" if is_out_of_budget else str(error)
    attempt = Attempt(
        planned_attempt.engine,
        planned_attempt.granularity,
        planned_attempt.yaw_deg,
        makespan_s,
        perf_counter() - start_s,
        effort.spent_s,
        not effort.is_cut_short,
        reason,
    )
    return Outcome(attempt, result, failure)


def rotate_about_z(problem: Problem, yaw_deg: float) -> Problem:
    """Rotate a problem's model about z.

    Parameters
    ----------
    problem
        Problem with the model.
    yaw_deg
        Angle, counterclockwise as seen from above.
    """
    return problem.rotate(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix())
