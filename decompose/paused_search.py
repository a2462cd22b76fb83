"""Paused search of the engine `best`: the attempts of its next round, and its continuation.

With `BestOptions.pauses`, `decompose_model` may return the best result so far of such a search; its
`Decomposition.open_printers` are then not empty. The attempts of a round may run anywhere, in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

from decompose.best import (
    Outcome,
    PlannedAttempt,
    SearchState,
    continue_rounds,
    end_rounds,
    make_attempt,
    plan_next_round,
    report_progress,
)
from decompose.decompose import run_engine
from decompose.detailed_models import simplify_model
from decompose.geometry import Model
from decompose.print_time import CostModel
from decompose.problem import Problem
from decompose.results import Attempt, Decomposition


@dataclass(frozen=True, slots=True, eq=False)
class PausedSearch:
    """Search that has paused before a round of several attempts.

    Attributes
    ----------
    best_result
        Best result so far, with the records of all attempts.
    model, cost, executor
        As in `decompose.decompose_model`.
    """

    best_result: Decomposition
    model: Model
    cost: CostModel
    executor: Executor | None = None

    @property
    def spent_share(self) -> float:
        """Share of the budget that the attempts so far have spent."""
        remaining_s = sum(planned_attempt.budget_s for planned_attempt in self.plan_round())
        return 1.0 - remaining_s / self.best_result.options.best.budget_s

    def plan_round(self) -> tuple[PlannedAttempt, ...]:
        """Plan the attempts of the next round."""
        return plan_next_round(self._problem, self._state)

    def make_attempt(self, number: int) -> Outcome:
        """Make one attempt of the next round; drop its result if it is not better than the best one so far.

        The attempt reports the share of the whole budget that it spends; see `decompose.best.progress`.
        """
        budget_s = self.best_result.options.best.budget_s
        outcome = make_attempt(
            self._problem,
            self._run_engine,
            self.plan_round()[number],
            self._state.best_known_s,
            lambda spent_s: report_progress(min(1.0, spent_s / budget_s)),
        )
        is_better = outcome.result is not None and self._state.is_beaten_by(outcome.result)
        return replace(outcome, result=outcome.result if is_better else None, error=None)

    def make_failed_outcome(self, number: int, reason: str) -> Outcome:
        """Build the outcome of an attempt that could not be run; its share of the budget counts as spent.

        Parameters
        ----------
        number
            Number of the attempt in the round.
        reason
            Reason why the attempt could not be run.
        """
        planned_attempt = self.plan_round()[number]
        attempt = Attempt(
            planned_attempt.engine,
            planned_attempt.granularity,
            planned_attempt.yaw_deg,
            effort_s=planned_attempt.budget_s,
            finished=False,
            reason=reason,
        )
        return Outcome(attempt)

    def resume(self, outcomes: Sequence[Outcome], end_reason: str | None = None) -> Decomposition:
        """Continue the search with the outcomes of the round; the search may pause again.

        Parameters
        ----------
        outcomes
            Outcomes of all attempts, in the order of the round.
        end_reason
            Reason to start no other attempt, and to end with the best result; None to continue.
        """
        state = self._state.add_round(outcomes)
        if end_reason is None:
            result = continue_rounds(self._problem, self._run_engine, state)
        else:
            result = end_rounds(self._problem, state, end_reason)
        later_attempts = result.attempts[len(self.best_result.attempts) :]
        total_s = self.best_result.compute_s["total"] + sum(attempt.compute_s for attempt in later_attempts)
        compute_s = result.compute_s | {"serial": self.best_result.compute_s["serial"], "total": total_s}
        return replace(result, curve=self.best_result.curve, compute_s=compute_s)

    @property
    def _problem(self) -> Problem:
        """Problem with the options of the engine `best`."""
        best_result = self.best_result
        return Problem(self.model, best_result.open_printers, self.cost, best_result.options, self.executor)

    @property
    def _state(self) -> SearchState:
        """Attempts and best result so far."""
        return SearchState(self.best_result.attempts, self.best_result)

    @property
    def _run_engine(self) -> Callable[[Problem], Decomposition]:
        """Function that runs the engine of a problem."""
        serial_times_s = (self.best_result.serial_s, self.best_result.serial_as_is_s)
        return lambda problem: run_engine(problem, lambda: serial_times_s, simplify_model(self.model).solid)
