"""Rounds of `best`: their invariants, tested with fake engines of random makespans and efforts."""

from __future__ import annotations

import random
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decompose.best import PlannedAttempt, SearchState, find_best_result, make_attempt, plan_next_round
from decompose.best.rounds import OTHER_YAWS_DEG, compute_remaining_s
from decompose.decompose import decompose_model
from decompose.errors import NoFit
from decompose.geometry import Model, Solid
from decompose.options import BestOptions, Engine, Options
from decompose.pieces import Fault
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem, Work
from decompose.problem.effort import WORK_NS
from decompose.results import Attempt, Decomposition

BLOCK = Model(Solid.box((0, 0, 0), (300, 90, 80)), (), 1.0)
PRINTERS = tuple(TargetPrinter(str(i), ((200.0, 200.0, 200.0),)) for i in range(20))
Shuffle = Callable[[list[int]], list[int]]


@pytest.fixture(scope="module")
def result(cost: CostModel) -> Decomposition:
    """Make a result; its parts do not matter here."""
    result = decompose_model(BLOCK, PRINTERS[:2], Options(Engine.GUILLOTINE, 3, prove=False), cost)
    return replace(result, sum_s=0.0)


@dataclass(frozen=True)
class TableEngines:
    """Fake engines whose makespan, effort and failure depend on the grid, the angle and the best makespan."""

    result: Decomposition
    seed: int

    def __call__(self, problem: Problem) -> Decomposition:
        options = problem.options
        key = (self.seed, options.engine, options.granularity, problem.frame.tolist(), problem.best_known_s)
        rng = random.Random(zlib.crc32(repr(key).encode()))
        effort_s = min(rng.choice([0.5, 1.0, 3.0]), problem.effort.budget_s)
        problem.effort.record(Work.SUM, int(effort_s * 1e9 / WORK_NS[Work.SUM]))
        if rng.random() < 0.2:
            raise NoFit("no partition")
        faults = (Fault(0, "is a sliver"),) if rng.random() < 0.1 else ()
        makespan_s = rng.choice([1000.0, 995.0, 985.0, 900.0])
        return replace(self.result, engine=options.engine, makespan_s=makespan_s, faults=faults)


def make_problem(cost: CostModel, budget_s: float) -> Problem:
    return Problem(BLOCK, PRINTERS, cost, Options(best=BestOptions(budget_s)))


def run_rounds(problem: Problem, engines: TableEngines, shuffle: Shuffle) -> list[SearchState]:
    """Run a search in which each round's attempts end in a given order; return the state after each round."""
    states = [SearchState()]
    while planned_attempts := plan_next_round(problem, states[-1]):
        outcomes = {
            number: make_attempt(problem, engines, planned_attempts[number], states[-1].best_known_s)
            for number in shuffle(list(range(len(planned_attempts))))
        }
        states.append(states[-1].add_round([outcomes[number] for number in range(len(planned_attempts))]))
    return states


def drop_times(attempts: tuple[Attempt, ...]) -> list[Attempt]:
    return [replace(attempt, compute_s=0.0) for attempt in attempts]


seeds = st.integers(0, 10_000)
budgets_s = st.sampled_from([1.0, 3.0, 6.0, 10.0, 20.0, 60.0])


@settings(max_examples=60, deadline=None)
@given(seed=seeds, budget_s=budgets_s, rng=st.randoms(use_true_random=False))
def test_order_in_which_attempts_of_a_round_end_changes_nothing(
    cost: CostModel, result: Decomposition, seed: int, budget_s: float, rng: random.Random
) -> None:
    problem, engines = make_problem(cost, budget_s), TableEngines(result, seed)
    state = run_rounds(problem, engines, lambda numbers: rng.sample(numbers, len(numbers)))[-1]
    if state.best_result is None:
        with pytest.raises(NoFit):
            find_best_result(problem, engines)
        return
    serial_result = find_best_result(problem, engines)
    assert (serial_result.makespan_s, serial_result.yaw_deg) == (
        state.best_result.makespan_s,
        state.best_result.yaw_deg,
    )
    started_attempts = serial_result.attempts[: len(state.attempts)]
    assert drop_times(started_attempts) == drop_times(state.attempts)
    assert all("not started" in attempt.reason for attempt in serial_result.attempts[len(started_attempts) :])


@settings(max_examples=60, deadline=None)
@given(seed=seeds, budget_s=budgets_s)
def test_rounds_stay_within_the_budget_and_repeat_no_attempt(
    cost: CostModel, result: Decomposition, seed: int, budget_s: float
) -> None:
    problem = make_problem(cost, budget_s)
    states = run_rounds(problem, TableEngines(result, seed), lambda numbers: numbers)
    for state in states[1:]:
        planned_attempts = plan_next_round(problem, state)
        efforts_s = {planned_attempt.budget_s for planned_attempt in planned_attempts}
        assert len(efforts_s) <= 1
        is_repeated = (
            planned_attempts and planned_attempts[0].granularity == "auto" and len(state.attempts) == 1
        )
        if not is_repeated:  # after a grid that was too coarse, the budget starts again
            assert (
                sum(planned_attempt.budget_s for planned_attempt in planned_attempts)
                <= compute_remaining_s(problem, state) + 1e-9
            )
        if len(planned_attempts) > 1:
            assert efforts_s.pop() >= state.attempts[0].effort_s
    attempts = [(a.engine, a.granularity, a.yaw_deg) for a in states[-1].attempts]
    assert len(set(attempts)) == len(attempts)


def test_round_is_as_large_as_the_budget_allows(cost: CostModel, result: Decomposition) -> None:
    """Use a first attempt of 10 s, and a result that other grids cannot improve."""
    best_result = replace(result, makespan_s=1000.0, sum_s=20_000.0)
    state = SearchState((Attempt(Engine.GUILLOTINE, "auto", 0.0, 1000.0, effort_s=10.0),), best_result)

    def plan_round(budget_s: float) -> tuple[PlannedAttempt, ...]:
        return plan_next_round(make_problem(cost, budget_s), state)

    assert plan_round(19.0) == ()
    assert plan_round(20.0) == (PlannedAttempt(Engine.GUILLOTINE, "auto", OTHER_YAWS_DEG[0], 10.0),)
    assert [(planned_attempt.yaw_deg, planned_attempt.budget_s) for planned_attempt in plan_round(35.0)] == [
        (45.0, 12.5),
        (15.0, 12.5),
    ]
    assert [(t.yaw_deg, t.budget_s) for t in plan_round(110.0)] == [
        (yaw_deg, 20.0) for yaw_deg in OTHER_YAWS_DEG
    ]
