"""Searches that pause before a round of attempts; where and when attempts run does not change the result."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from decompose.best import listen_to_progress
from decompose.decompose import decompose_model
from decompose.geometry import Model, Solid
from decompose.options import BestOptions, ConnectorOptions, Options
from decompose.paused_search import PausedSearch
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.results import Decomposition

L_SHAPE = Model(
    Solid.union([Solid.box((0, 0, 0), (150, 40, 30)), Solid.box((0, 0, 0), (40, 110, 60))]), (), 1.0
)
PRINTERS = [TargetPrinter(name, ((120.0, 120.0, 120.0),)) for name in "abcd"]
BEST_OPTIONS = BestOptions(3.6)  # one round of four attempts; a fifth one is not started


@pytest.fixture(scope="module")
def unpaused_result(cost: CostModel) -> Decomposition:
    """Search without a pause."""
    return decompose_model(L_SHAPE, PRINTERS, Options(best=BEST_OPTIONS, prove=False), cost)


@pytest.fixture(scope="module")
def paused_search(cost: CostModel) -> PausedSearch:
    """Search until the first round of several attempts."""
    options = Options(best=replace(BEST_OPTIONS, pauses=True), prove=False)
    best_result = decompose_model(L_SHAPE, PRINTERS, options, cost)
    return PausedSearch(best_result, L_SHAPE, cost)


def drop_times(result: Decomposition) -> list[object]:
    return [replace(attempt, compute_s=0.0) for attempt in result.attempts]


def test_attempts_in_any_order_give_the_result_of_one_process(
    unpaused_result: Decomposition, paused_search: PausedSearch
) -> None:
    """Make the attempts of each round in reverse order, each as if in a separate process."""
    search, rounds = paused_search, 0
    while search.best_result.open_printers:
        numbers = range(len(search.plan_round()))
        assert len(numbers) > 1
        outcomes = {number: pickle.dumps(search.make_attempt(number)) for number in reversed(numbers)}
        best_result = search.resume([pickle.loads(outcomes[number]) for number in numbers])
        search, rounds = replace(search, best_result=pickle.loads(pickle.dumps(best_result))), rounds + 1
    assert rounds == 1
    assert search.best_result.yaw_deg
    result = search.best_result
    assert drop_times(result) == drop_times(unpaused_result)
    assert (result.makespan_s, result.sum_s, result.yaw_deg) == (
        unpaused_result.makespan_s,
        unpaused_result.sum_s,
        unpaused_result.yaw_deg,
    )
    assert result.options == unpaused_result.options
    for part, other_part in zip(result.parts, unpaused_result.parts, strict=True):
        assert (part.id, part.printer, part.price_s) == (
            other_part.id,
            other_part.printer,
            other_part.price_s,
        )
        np.testing.assert_array_equal(part.solid.bounds_mm, other_part.solid.bounds_mm)
        np.testing.assert_array_equal(part.to_model, other_part.to_model)


def test_search_pauses_once_it_has_a_result(paused_search: PausedSearch) -> None:
    best_result = paused_search.best_result
    assert best_result.open_printers == tuple(PRINTERS)
    assert len(best_result.attempts) == 1
    assert paused_search.spent_share == pytest.approx(
        best_result.attempts[0].effort_s / BEST_OPTIONS.budget_s
    )


def test_attempts_price_pins_and_marks(paused_search: PausedSearch) -> None:
    options = replace(
        paused_search.best_result.options, connectors=ConnectorOptions(2.85, marks=True), prove=False
    )
    # Every result is better than such a best one, and so is not dropped.
    best_result = replace(paused_search.best_result, options=options, makespan_s=1e9)
    result = replace(paused_search, best_result=best_result).make_attempt(0).result
    assert result is not None and all(part.connectors_s > 0.0 for part in result.parts)


def test_failed_attempt_keeps_the_best_result(paused_search: PausedSearch) -> None:
    count = len(paused_search.plan_round())
    outcomes = [
        paused_search.make_failed_outcome(number, "its worker had no memory") for number in range(count)
    ]
    search = replace(paused_search, best_result=paused_search.resume(outcomes))
    attempts = search.best_result.attempts[1 : 1 + count]
    assert {attempt.reason for attempt in attempts} == {"its worker had no memory"}
    assert not any(attempt.finished for attempt in attempts)
    assert search.best_result.makespan_s == paused_search.best_result.makespan_s
    assert sum(attempt.effort_s for attempt in search.best_result.attempts) <= BEST_OPTIONS.budget_s * (
        1.0 + 1e-9
    )


def test_a_single_attempt_after_the_round_is_made_without_a_pause(paused_search: PausedSearch) -> None:
    outcomes = [paused_search.make_attempt(number) for number in range(len(paused_search.plan_round()))]
    quick_outcomes = [
        replace(outcome, attempt=replace(outcome.attempt, effort_s=0.5)) for outcome in outcomes
    ]
    result = paused_search.resume(quick_outcomes)
    assert not result.open_printers
    assert len(result.attempts) == 1 + len(outcomes) + 1
    last_attempt = result.attempts[-1]
    assert last_attempt.effort_s > 0.0
    assert last_attempt.yaw_deg not in [attempt.yaw_deg for attempt in result.attempts[:-1]]
    assert result.makespan_s == min(attempt.makespan_s for attempt in result.attempts if attempt.makespan_s)


def test_search_ends_early_with_the_best_result_of_the_round(paused_search: PausedSearch) -> None:
    outcomes = [paused_search.make_attempt(number) for number in range(len(paused_search.plan_round()))]
    ended_search, best_result = (
        paused_search.resume(outcomes, "not started: out of memory"),
        paused_search.best_result,
    )
    assert not ended_search.open_printers and not ended_search.options.best.pauses
    results = [outcome.result.makespan_s for outcome in outcomes if outcome.result is not None]
    assert results and ended_search.makespan_s == min(results) < best_result.makespan_s
    later_attempts = ended_search.attempts[1 + len(outcomes) :]
    assert later_attempts
    assert {(attempt.reason, attempt.finished) for attempt in later_attempts} == {
        ("not started: out of memory", False)
    }


def test_attempt_reports_its_own_share_of_the_budget(paused_search: PausedSearch) -> None:
    shares: list[float] = []
    with listen_to_progress(shares.append):
        outcome = paused_search.make_attempt(0)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(outcome.attempt.effort_s / BEST_OPTIONS.budget_s)
