"""Rounds of the engine `best`: the next attempts and their budgets, as pure functions.

The attempts of a round depend only on earlier rounds, not on each other, so they can run in parallel, in any
order, with the same result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from decompose.best.attempt import Outcome, PlannedAttempt, rotate_about_z
from decompose.errors import DecomposeError
from decompose.grid import choose_cell_counts, count_cuts
from decompose.options import Engine
from decompose.problem import MAX_GRANULARITY, WORK_NS, Problem, Work, choose_granularity
from decompose.results import Attempt, Decomposition

# If the tables of the first grid, the searches in them and its bound would need more than this share of the
# budget, a coarser grid is used.
GRID_SHARE = 0.5
USUAL_SEARCH_COUNT = 30  # usual number of searches on a grid, each for another time limit
OTHER_GRID_RATIOS = (1.1, 0.95, 0.9)  # ratios of the granularities of other grids to that of the first grid
# Rotations of the model about z; after a quarter turn the grid is the same.
OTHER_YAWS_DEG = (45.0, 15.0, 75.0, 30.0, 60.0)
# Minimum gain from a rotation, as a share of the makespan: cuts along the model's sides are easier to glue.
MIN_ROTATION_GAIN = 0.01
MIN_GAIN = 0.03  # minimum possible gain, as a share of the makespan, for which another grid is tried
SPENT_REASON = "not started: the budget was spent"


@dataclass(frozen=True, slots=True, eq=False)
class SearchState:
    """Attempts of the rounds so far, and the best of their results.

    Attributes
    ----------
    attempts
        Records of the attempts.
    best_result
        Best result; None if there is none.
    failure
        Error of the first attempt that failed; None if none failed.
    """

    attempts: tuple[Attempt, ...] = ()
    best_result: Decomposition | None = None
    failure: DecomposeError | None = None

    @property
    def has_sound_result(self) -> bool:
        """True if there is a best result, and its parts have no faults."""
        return self.best_result is not None and not self.best_result.faults

    @property
    def best_known_s(self) -> float:
        """Makespan that another attempt has to beat; inf without a sound result."""
        return (
            self.best_result.makespan_s
            if self.best_result is not None and self.has_sound_result
            else math.inf
        )

    @property
    def yaw_deg(self) -> float:
        """Angle by which the model of the best result is rotated about z."""
        return 0.0 if self.best_result is None else self.best_result.yaw_deg

    def add_round(self, outcomes: Sequence[Outcome]) -> SearchState:
        """Return the state after a round, from the outcomes of its attempts in their planned order."""
        state = self
        for outcome in outcomes:
            result = outcome.result
            state = SearchState(
                (*state.attempts, outcome.attempt),
                result if result is not None and state.is_beaten_by(result) else state.best_result,
                state.failure or outcome.error,
            )
        return state

    def is_beaten_by(self, result: Decomposition) -> bool:
        """Check whether a result is better than the best one so far."""
        if self.best_result is None:
            return True
        if result.yaw_deg and not self.yaw_deg:
            result = replace(result, makespan_s=result.makespan_s / (1.0 - MIN_ROTATION_GAIN))
        return _make_sort_key(result) < _make_sort_key(self.best_result)


def plan_next_round(problem: Problem, state: SearchState) -> tuple[PlannedAttempt, ...]:
    """Plan the attempts that follow those of a state; none at the end of the search.

    The usual grid is that of the requested granularity. The first grid is tried alone; it is coarser than the
    usual one if the budget is small. If it then gives no sound result, the usual grid follows with the whole
    budget, then the engine `parallelobox`, because any result is better than none. The next rounds try other
    grids, then rotations of the model about z, then other grids at the best angle. The attempts of a round
    have equal shares of the remaining budget. A round has only so many attempts that each can spend as much
    effort as the first attempt, but at least one as long as there is no result. The other attempts form the
    next round, with the rest of the budget.

    Parameters
    ----------
    problem
        Problem with the options of the engine `best`.
    state
        Attempts and best result so far.
    """
    budget_s, usual_granularity = problem.options.best.budget_s, problem.options.granularity
    first_granularity = choose_first_granularity(problem)
    if not state.attempts:
        return (PlannedAttempt(Engine.GUILLOTINE, first_granularity, budget_s=budget_s),)
    if not state.has_sound_result and first_granularity != usual_granularity and len(state.attempts) == 1:
        return (PlannedAttempt(Engine.GUILLOTINE, usual_granularity, budget_s=budget_s),)
    planned_attempts = next(iter(_list_open_rounds(problem, state)), ())
    remaining_s, first_s = compute_remaining_s(problem, state), state.attempts[0].effort_s
    if not planned_attempts or remaining_s <= 0.0:
        return ()
    # An attempt with less effort than the first one is cut short, and hardly ever wins.
    count = len(planned_attempts) if first_s <= 0.0 else int(remaining_s / first_s)
    if state.best_result is None:
        count = max(1, count)
    return tuple(
        replace(planned_attempt, budget_s=remaining_s / min(count, len(planned_attempts)))
        for planned_attempt in planned_attempts[:count]
    )


def list_open_attempts(problem: Problem, state: SearchState, reason: str = SPENT_REASON) -> list[Attempt]:
    """List the attempts that a search has not started, as records with a reason.

    Parameters
    ----------
    problem, state
        As in `plan_next_round`.
    reason
        Reason why the attempts have not been started.
    """
    return [
        Attempt(
            planned_attempt.engine,
            planned_attempt.granularity,
            planned_attempt.yaw_deg,
            finished=False,
            reason=reason,
        )
        for planned_attempts in _list_open_rounds(problem, state)
        for planned_attempt in planned_attempts
    ]


def compute_remaining_s(problem: Problem, state: SearchState) -> float:
    """Compute the remaining budget in seconds of effort.

    Parameters
    ----------
    problem, state
        As in `plan_next_round`.
    """
    counted_attempts = state.attempts[1:] if _has_restarted_on_usual_grid(problem, state) else state.attempts
    return problem.options.best.budget_s - sum(attempt.effort_s for attempt in counted_attempts)


def _has_restarted_on_usual_grid(problem: Problem, state: SearchState) -> bool:
    """Check whether the usual grid was tried after a coarser one, with the whole budget again."""
    usual_granularity = problem.options.granularity
    granularities = [attempt.granularity for attempt in state.attempts[:2] if not attempt.yaw_deg]
    return (
        len(granularities) == 2
        and granularities[0] != usual_granularity == granularities[1]
        and state.attempts[1].engine is Engine.GUILLOTINE
    )


def _list_open_rounds(problem: Problem, state: SearchState) -> list[tuple[PlannedAttempt, ...]]:
    """List the rounds that may follow the first grid, without the attempts that have already been made.

    The budget is not considered.
    """
    usual_granularity = problem.options.granularity
    rounds: list[tuple[PlannedAttempt, ...]] = []
    if not state.has_sound_result:
        rounds.append((PlannedAttempt(Engine.PARALLELOBOX, usual_granularity),))
    if usual_granularity == "auto" and len(problem.printers) > 1:
        granularity = (
            usual_granularity
            if _has_restarted_on_usual_grid(problem, state)
            else state.attempts[0].granularity
        )
        is_rotated = any(attempt.yaw_deg for attempt in state.attempts)
        if not is_rotated:
            rounds.append(_list_other_grids(problem, state, granularity))
        rounds.append(
            tuple(PlannedAttempt(Engine.GUILLOTINE, granularity, yaw_deg) for yaw_deg in OTHER_YAWS_DEG)
        )
        if state.yaw_deg:
            rounds.append(_list_other_grids(problem, state, granularity))
    made_attempts = {(attempt.engine, attempt.granularity, attempt.yaw_deg) for attempt in state.attempts}
    open_rounds = [
        tuple(
            planned_attempt
            for planned_attempt in planned_attempts
            if (planned_attempt.engine, planned_attempt.granularity, planned_attempt.yaw_deg)
            not in made_attempts
        )
        for planned_attempts in rounds
    ]
    return [planned_attempts for planned_attempts in open_rounds if planned_attempts]


def _list_other_grids(
    problem: Problem, state: SearchState, granularity: str | int
) -> tuple[PlannedAttempt, ...]:
    """List attempts on similar grids at the best angle; none if the possible gain is low.

    Each shape of a grid is tried only once.
    """
    if state.best_result is not None and state.best_result.compute_possible_gain(problem.printers) < MIN_GAIN:
        return ()
    rotated_problem = rotate_about_z(problem, state.yaw_deg)
    rotated_problem = replace(rotated_problem, options=replace(problem.options, granularity=granularity))
    extents_mm = rotated_problem.model.extents_mm
    first_granularity = rotated_problem.choose_granularity(rotated_problem.model)
    shapes = {choose_cell_counts(extents_mm, first_granularity)}
    planned_attempts = []
    for ratio in OTHER_GRID_RATIOS:
        other_granularity = min(MAX_GRANULARITY, round(ratio * first_granularity))
        shape = choose_cell_counts(extents_mm, other_granularity)
        if shape not in shapes:
            shapes.add(shape)
            planned_attempts.append(PlannedAttempt(Engine.GUILLOTINE, other_granularity, state.yaw_deg))
    return tuple(planned_attempts)


def choose_first_granularity(problem: Problem) -> str | int:
    """Choose the granularity of the first grid: the requested one, or ``auto``, or a coarser one.

    A coarser grid than ``auto`` is used if the budget is small. It stays fine enough for parts that are as
    large as the printers' build volumes.
    """
    options, extents_mm = problem.options, problem.model.extents_mm
    if options.granularity != "auto":
        return options.granularity
    granularity = auto_granularity = problem.choose_granularity(problem.model)
    min_granularity = choose_granularity("auto", 1, max(extents_mm) / min(problem.max_part_sides_mm))
    while granularity > min_granularity and _estimate_grid_s(choose_cell_counts(extents_mm, granularity)) > (
        GRID_SHARE * options.best.budget_s
    ):
        granularity -= 1
    return "auto" if granularity == auto_granularity else granularity


def _estimate_grid_s(shape: tuple[int, int, int]) -> float:
    """Estimate the effort in s for a grid: its tables, the searches in them, and its bound."""
    box_count = math.prod(n * (n + 1) // 2 for n in shape)
    box_ns = WORK_NS[Work.BOX_PRICED] + WORK_NS[Work.BOX_PROVEN]
    return (box_count * box_ns + USUAL_SEARCH_COUNT * count_cuts(shape) * WORK_NS[Work.SUM]) / 1e9


def _make_sort_key(result: Decomposition) -> tuple[bool, float, int]:
    """Make the sort key of a result; lower is better."""
    return bool(result.faults), result.makespan_s, len(result.parts)
