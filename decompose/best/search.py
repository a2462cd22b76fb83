"""Search of the engine `best`: rounds of attempts within a budget, and the best of their results."""

from __future__ import annotations

from dataclasses import replace

from decompose.best.attempt import EngineRunner, Outcome, PlannedAttempt, make_attempt
from decompose.best.progress import report_progress
from decompose.best.rounds import SPENT_REASON, SearchState, list_open_attempts, plan_next_round
from decompose.problem import Problem
from decompose.results import Decomposition


def find_best_result(problem: Problem, run_engine: EngineRunner) -> Decomposition:
    """Run rounds of attempts until the budget is spent, and return the best result.

    Parameters
    ----------
    problem
        Problem with the options of the engine `best`.
    run_engine
        Function that returns the checked result of the engine that a problem's options name.

    Raises
    ------
    NoFit, GeometryError, ModelNotSolid
        Error of the first engine, if no engine has a result.
    """
    return continue_rounds(problem, run_engine, SearchState())


def continue_rounds(problem: Problem, run_engine: EngineRunner, state: SearchState) -> Decomposition:
    """Run the rounds that follow those of a state, as `find_best_result` does.

    With `BestOptions.pauses`, the function returns early: once it has a result without faults, it returns
    that result before the next round of several attempts, which the caller can run elsewhere. The
    `open_printers` of this result are the printers for which the search continues.

    Parameters
    ----------
    problem, run_engine
        As in `find_best_result`.
    state
        Attempts and best result so far.
    """
    while planned_attempts := plan_next_round(problem, state):
        if (
            problem.options.best.pauses
            and len(planned_attempts) > 1
            and state.best_result
            and state.has_sound_result
        ):
            return replace(
                state.best_result,
                options=problem.options,
                attempts=state.attempts,
                open_printers=problem.printers,
            )
        state = state.add_round(_run_round(problem, run_engine, state, planned_attempts))
    return end_rounds(problem, state)


def _run_round(
    problem: Problem,
    run_engine: EngineRunner,
    state: SearchState,
    planned_attempts: tuple[PlannedAttempt, ...],
) -> list[Outcome]:
    """Run the attempts of a round one after the other, and report the spent share of the budget."""
    budget_s = problem.options.best.budget_s
    # The attempts of the round share the remaining budget.
    spent_s = budget_s - sum(planned_attempt.budget_s for planned_attempt in planned_attempts)

    def report_spent(attempt_s: float) -> None:
        if budget_s > 0.0:
            report_progress(min(1.0, (spent_s + attempt_s) / budget_s))

    outcomes = []
    for planned_attempt in planned_attempts:
        outcomes.append(make_attempt(problem, run_engine, planned_attempt, state.best_known_s, report_spent))
        spent_s += outcomes[-1].attempt.effort_s
    return outcomes


def end_rounds(problem: Problem, state: SearchState, reason: str = SPENT_REASON) -> Decomposition:
    """End a search: return the best result, or raise the error of the first engine if there is none.

    Parameters
    ----------
    problem
        Problem with the options of the engine `best`.
    state
        Attempts and best result.
    reason
        Reason why the other attempts have not been started.
    """
    if state.best_result is None:
        assert state.failure is not None  # the first engine is always tried
        raise state.failure
    attempts = (*state.attempts, *list_open_attempts(problem, state, reason))
    options = replace(problem.options, best=replace(problem.options.best, pauses=False))
    return replace(state.best_result, options=options, attempts=attempts, open_printers=())
