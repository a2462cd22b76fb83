"""Effort: results depend only on input, seed and effort, not on the speed of the machine or its threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import asdict, replace
from itertools import count
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from decompose import decompose as decompose_module
from decompose.best import attempt
from decompose.engines import ENGINES
from decompose.errors import NoFit
from decompose.geometry import Model, Solid
from decompose.grid import count_cuts
from decompose.options import BestOptions, Engine, Options, ParalleloboxOptions
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Effort, Problem, Work
from decompose.problem.effort import WORK_NS
from decompose.results import Decomposition

COARSE_OPTIONS = Options(
    granularity=5, parallelobox=ParalleloboxOptions(tries=1), prove=False, fit_first_layer=False
)


class ReversedExecutor(Executor):
    """Executor that runs its calls in reverse order in one thread."""

    def map(self, fn: Callable[..., Any], *iterables: Iterable[Any], **_: Any) -> Iterator[Any]:
        outcomes = [(i, fn(*args)) for i, args in reversed(list(enumerate(zip(*iterables, strict=False))))]
        return iter([answer for _, answer in sorted(outcomes, key=lambda each: each[0])])

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def list_figures(result: Decomposition) -> list[Any]:
    """List the figures of a result without its durations."""
    attempts = [asdict(attempt) | {"compute_s": None} for attempt in result.attempts]
    parts = [(p.id, p.printer, p.price_s, p.to_model.tolist(), p.solid.arrays()) for p in result.parts]
    return [attempts, result.engine, result.makespan_s, result.lower_bound_s, result.cells, parts]


def are_equal(a: list[Any], b: list[Any]) -> bool:
    return all(
        x[:4] == y[:4] and all(np.array_equal(*pair) for pair in zip(x[4], y[4], strict=True))
        for x, y in zip(a[-1], b[-1], strict=True)
    ) and (a[:-1] == b[:-1])


BudgetRunner = Callable[..., Decomposition]


PRINTERS = tuple(TargetPrinter(str(i), ((200.0, 200.0, 200.0),)) for i in range(4))


@pytest.fixture(scope="module")
def model() -> Model:
    """Make a rotated block with a step."""
    block = Solid.union([Solid.box((0, 0, 0), (150, 80, 40)), Solid.box((20, 10, 30), (90, 60, 110))])
    rotation = trimesh.transformations.rotation_matrix(0.4, (0.2, 0.1, 1.0))[:3, :3]
    return Model(block.rotate(rotation), (), 1.0)


@pytest.fixture(scope="module")
def budget_runner(cost: CostModel, model: Model) -> BudgetRunner:
    """Return a function that cuts the block for four printers within a budget."""

    def decompose(budget_s: float, executor: Executor | None = None) -> Decomposition:
        return decompose_module.decompose_model(
            model, PRINTERS, replace(COARSE_OPTIONS, best=BestOptions(budget_s)), cost, executor
        )

    return decompose


@pytest.fixture(scope="module")
def unlimited_result(budget_runner: BudgetRunner) -> Decomposition:
    return budget_runner(1e9)


def compute_effort_s(result: Decomposition) -> float:
    return sum(item.effort_s for item in result.attempts)


@pytest.mark.parametrize("share", [0.1, 0.6, 0.9])
def test_result_is_independent_of_clock_and_threads(
    share: float,
    budget_runner: BudgetRunner,
    unlimited_result: Decomposition,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    results = []
    for step_s, executor in ((1e-9, None), (1e6, ReversedExecutor()), (1.0, ThreadPoolExecutor(4))):
        ticks = count(0.0, step_s)
        for module in (attempt, decompose_module):
            monkeypatch.setattr(module, "perf_counter", lambda ticks=ticks: next(ticks))
        results.append(list_figures(budget_runner(share * compute_effort_s(unlimited_result), executor)))
    assert are_equal(results[0], results[1])
    assert are_equal(results[0], results[2])


def test_search_within_a_budget_ends_with_the_best_result_so_far(
    budget_runner: BudgetRunner, unlimited_result: Decomposition
) -> None:
    result = budget_runner(0.0)
    assert result.attempts[0].makespan_s == result.makespan_s
    assert not result.attempts[0].finished
    assert all(
        item.finished and item.makespan_s and item.effort_s > 0.0 for item in unlimited_result.attempts
    )
    assert are_equal(
        list_figures(budget_runner(1.5 * compute_effort_s(unlimited_result))), list_figures(unlimited_result)
    )
    assert unlimited_result.makespan_s <= result.makespan_s


def test_draws_beyond_the_budget_do_not_start(cost: CostModel, model: Model) -> None:
    options = replace(COARSE_OPTIONS, engine=Engine.PARALLELOBOX)
    unlimited_effort, limited_effort = Effort(), Effort(1e-4)
    ENGINES[Engine.PARALLELOBOX](Problem(model, PRINTERS, cost, options, effort=unlimited_effort))
    with pytest.raises(NoFit):
        ENGINES[Engine.PARALLELOBOX](Problem(model, PRINTERS, cost, options, effort=limited_effort))
    assert limited_effort.is_cut_short
    assert not unlimited_effort.is_cut_short
    assert limited_effort.spent_s < unlimited_effort.spent_s


@given(budget_s=st.floats(0.0, 10.0), reserved_s=st.floats(0.0, 5.0), units=st.integers(0, 10**8))
def test_affordable_work_stays_within_the_budget(budget_s: float, reserved_s: float, units: int) -> None:
    effort = Effort(budget_s, reserved_s=reserved_s)
    is_affordable = effort.can_afford(Work.CELL_GROWN, units)
    assert effort.is_cut_short == (not is_affordable)
    effort.record(Work.CELL_GROWN, units)
    assert is_affordable == (effort.spent_s + reserved_s <= budget_s)


@given(work=st.lists(st.tuples(st.sampled_from(Work), st.integers(0, 10**9))), budget_s=st.floats(0.0, 100.0))
def test_sum_of_work_is_independent_of_order(work: list[tuple[Work, int]], budget_s: float) -> None:
    forward_effort, backward_effort = Effort(budget_s), Effort(budget_s)
    for item, other_item in zip(work, reversed(work), strict=True):
        forward_effort.record(*item)
        backward_effort.record(*other_item)
    assert forward_effort.spent_s == backward_effort.spent_s
    assert forward_effort.spent_s == pytest.approx(sum(WORK_NS[kind] * units for kind, units in work) / 1e9)
    assert (
        forward_effort.is_spent()
        == backward_effort.is_spent()
        == forward_effort.is_cut_short
        == (forward_effort.spent_s >= budget_s)
    )


@given(shape=st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 4)))
def test_search_computes_one_sum_per_cut_of_each_box(shape: tuple[int, int, int]) -> None:
    spans = [[b - a for a in range(n) for b in range(a + 1, n + 1)] for n in shape]
    assert count_cuts(shape) == sum(x + y + z - 3 for x in spans[0] for y in spans[1] for z in spans[2])


@pytest.mark.parametrize("size_mm", [(260.0, 90.0, 80.0), (220.0, 210.0, 30.0)])
def test_first_grid_with_its_bound_stays_within_a_small_budget(
    size_mm: tuple[float, float, float], cost: CostModel
) -> None:
    """Run search, plane shift and bound on a rotated block with a bore."""
    x, y, z = size_mm
    bore = Solid.box((0.3 * x, 0.2 * y, -1.0), (0.6 * x, 0.7 * y, z + 1.0))
    rotation = trimesh.transformations.rotation_matrix(0.3, (0.2, 0.1, 1.0))[:3, :3]
    model = Model(Solid.box((0, 0, 0), size_mm).subtract(bore).rotate(rotation), (), 1.0)
    result = decompose_module.decompose_model(model, PRINTERS, Options(best=BestOptions(3.0)), cost)
    assert result.lower_bound_s <= result.grid_makespan_s
    assert compute_effort_s(result) <= 1.25 * 3.0
