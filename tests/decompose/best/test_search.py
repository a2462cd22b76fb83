"""Attempts of `best`, their order, and the choice of a result; fake engines return given results."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from decompose.best import choose_first_granularity, find_best_result, listen_to_progress, rounds
from decompose.best.rounds import OTHER_GRID_RATIOS, OTHER_YAWS_DEG
from decompose.decompose import decompose_model
from decompose.errors import DecomposeError, GeometryError, ModelNotSolid, NoFit, Rule
from decompose.geometry import Model, Solid
from decompose.grid import choose_cell_counts
from decompose.options import BestOptions, Engine, Options
from decompose.pieces import Fault
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem, Work
from decompose.problem.effort import WORK_NS
from decompose.results import Decomposition

BOUND_S = 1000.0
BLOCK = Model(Solid.box((0, 0, 0), (300, 90, 80)), (), 1.0)
PRINTERS = [TargetPrinter(str(i), ((200.0, 200.0, 200.0),)) for i in range(20)]
MakespanFunction = Callable[[Options], float]


@pytest.fixture(scope="module")
def result(cost: CostModel) -> Decomposition:
    """Make a result; its parts do not matter here."""
    result = decompose_model(BLOCK, PRINTERS[:2], Options(Engine.GUILLOTINE, 3, prove=False), cost)
    return replace(result, sum_s=0.0)


class Engines:
    """Fake engines with given makespans, infinite if there is no partition, that record their problems."""

    def __init__(
        self,
        result: Decomposition,
        compute_makespan_s: MakespanFunction,
        faulty_engines: tuple[Engine, ...] = (),
    ) -> None:
        self.result, self.compute_makespan_s, self.faulty_engines = result, compute_makespan_s, faulty_engines
        self.problems: list[Problem] = []

    def __call__(self, problem: Problem) -> Decomposition:
        self.problems.append(problem)
        problem.effort.record(Work.SUM, round(1e9 / WORK_NS[Work.SUM]))  # one second
        if math.isinf(makespan_s := self.compute_makespan_s(problem.options)):
            raise NoFit(f"nothing at {problem.options.granularity}")
        engine = problem.options.engine
        faults = (Fault(0, "is a sliver"),) if engine in self.faulty_engines else ()
        return replace(
            self.result, engine=engine, makespan_s=makespan_s, lower_bound_s=BOUND_S, faults=faults
        )

    @property
    def engine_grids(self) -> list[tuple[Engine, str | int]]:
        return [(item.options.engine, item.options.granularity) for item in self.problems]


def make_problem(cost: CostModel, printers: int = 20, **options: object) -> Problem:
    return Problem(BLOCK, tuple(PRINTERS[:printers]), cost, Options(Engine.BEST, **options))  # type: ignore[arg-type]


def list_yaws_deg(result: Decomposition) -> list[float]:
    """Return the model's rotation in each attempt."""
    return [attempt.yaw_deg for attempt in result.attempts]


def compute_far_makespan_s(options: Options) -> float:
    """Compute a makespan well above the bound, and closer to it on finer grids."""
    cells = options.granularity if isinstance(options.granularity, int) else 0
    return 1.2 * BOUND_S - cells


FIRST_ATTEMPTS = [(Engine.GUILLOTINE, "auto")]


def test_each_other_grid_is_tried_once(cost: CostModel, result: Decomposition) -> None:
    engines = Engines(result, compute_far_makespan_s)
    best_result = find_best_result(make_problem(cost), engines)
    grids = [cells for _, cells in engines.engine_grids[1:] if isinstance(cells, int)]
    rotated_attempts = [(Engine.GUILLOTINE, "auto")] * len(OTHER_YAWS_DEG)
    assert (
        engines.engine_grids
        == FIRST_ATTEMPTS + [(Engine.GUILLOTINE, cells) for cells in grids] + rotated_attempts
    )
    shapes = [choose_cell_counts(BLOCK.extents_mm, cells) for cells in grids]
    shapes.append(choose_cell_counts(BLOCK.extents_mm, make_problem(cost).choose_granularity(BLOCK)))
    assert len({*shapes}) == len(shapes) > 1
    assert len(grids) <= len(OTHER_GRID_RATIOS)
    assert best_result.makespan_s == 1.2 * BOUND_S - max(grids)
    assert [(a.engine, a.granularity) for a in best_result.attempts] == engines.engine_grids
    assert best_result.options.granularity == "auto"


def test_spent_share_of_the_budget_is_reported(cost: CostModel, result: Decomposition) -> None:
    shares: list[float] = []
    with listen_to_progress(shares.append):
        find_best_result(make_problem(cost, best=BestOptions(4.0)), Engines(result, compute_far_makespan_s))
    assert shares[:4] == pytest.approx([0.25, 0.5, 0.75, 1.0], abs=1e-3)
    assert max(shares) <= 1.0


def test_no_bound_is_proven_for_a_worse_result(cost: CostModel, result: Decomposition) -> None:
    """Expect the attempts of a round to beat the best result of the earlier rounds, not each other."""
    engines = Engines(result, compute_far_makespan_s)
    find_best_result(make_problem(cost), engines)
    makespans_s = [compute_far_makespan_s(item.options) for item in engines.problems]
    other_grids = sum(cells != "auto" for _, cells in engines.engine_grids)
    best_known_s = [item.best_known_s for item in engines.problems]
    assert best_known_s[: 1 + other_grids] == [math.inf] + [makespans_s[0]] * other_grids
    assert best_known_s[1 + other_grids :] == [min(makespans_s)] * len(OTHER_YAWS_DEG)


def test_other_grids_are_not_tried_for_small_gains(cost: CostModel, result: Decomposition) -> None:
    """Use a decomposition in which all printers are busy nearly to the end."""
    engines = Engines(replace(result, sum_s=20.0 * 1.2 * BOUND_S), lambda _: 1.2 * 1.02 * BOUND_S)
    best_result = find_best_result(make_problem(cost), engines)
    assert engines.engine_grids[:1] == FIRST_ATTEMPTS
    assert {cells for _, cells in engines.engine_grids} == {"auto"}
    assert list_yaws_deg(best_result) == [0.0, *OTHER_YAWS_DEG]


@pytest.mark.parametrize(("printers", "options"), [(20, {"granularity": 8}), (1, {})])
def test_only_the_requested_grid_is_tried(
    printers: int, options: dict[str, object], cost: CostModel, result: Decomposition
) -> None:
    engines = Engines(result, compute_far_makespan_s)
    find_best_result(make_problem(cost, printers, **options), engines)
    assert len(engines.engine_grids) == 1
    assert {cells for _, cells in engines.engine_grids} == {options.get("granularity", "auto")}


def test_other_grids_are_tried_at_the_best_angle(cost: CostModel, result: Decomposition) -> None:
    def compute_makespan_s(options: Options) -> float:
        # The second yaw is faster.
        return BOUND_S * (1.2 if len(engines.problems) == 1 + len(first_attempts) + 2 else 1.3)

    first_attempts: list[object] = []
    engines = Engines(result, lambda options: 1.3 * BOUND_S)
    find_best_result(make_problem(cost), engines)
    first_attempts += [cells for _, cells in engines.engine_grids if cells != "auto"]
    engines = Engines(result, compute_makespan_s)
    best_result = find_best_result(make_problem(cost), engines)
    yaw_deg = OTHER_YAWS_DEG[1]
    later_attempts = best_result.attempts[1 + len(first_attempts) + len(OTHER_YAWS_DEG) :]
    assert best_result.makespan_s == 1.2 * BOUND_S
    assert later_attempts
    assert {attempt.yaw_deg for attempt in later_attempts} == {yaw_deg}
    lengths_mm = [item.model.extents_mm[0] for item in engines.problems]
    assert lengths_mm[-1] == pytest.approx(lengths_mm[1 + len(first_attempts) + 1])
    assert lengths_mm[-1] == pytest.approx(300 * math.cos(math.radians(15)) + 90 * math.sin(math.radians(15)))


@pytest.mark.parametrize(("share", "is_chosen"), [(0.995, False), (0.985, True)])
def test_rotated_cuts_need_a_minimum_gain(
    share: float, is_chosen: bool, cost: CostModel, result: Decomposition
) -> None:
    busy_result = replace(result, sum_s=20.0 * 0.98 * BOUND_S)  # other grids are not tried
    engines = Engines(busy_result, lambda _: BOUND_S * (share if len(engines.problems) > 1 else 1.0))
    best_result = find_best_result(make_problem(cost), engines)
    assert best_result.makespan_s == BOUND_S * (share if is_chosen else 1.0)
    assert [a.makespan_s for a in best_result.attempts[1:]] == [share * BOUND_S] * len(OTHER_YAWS_DEG)


def test_parts_of_a_rotated_model_are_in_the_original_frame(
    cost: CostModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Use a bar that fits two printers only if it is cut across its length."""
    monkeypatch.setattr(rounds, "OTHER_YAWS_DEG", (30.0, 45.0))
    monkeypatch.setattr(rounds, "OTHER_GRID_RATIOS", ())
    rotation = Rotation.from_euler("z", 45.0, degrees=True).as_matrix()
    bar = replace(BLOCK, solid=BLOCK.solid.rotate(rotation))
    options = Options(Engine.BEST, prove=False, best=BestOptions(1000.0))
    result = decompose_model(bar, PRINTERS[:2], options, cost)
    straight_attempt = next(a for a in result.attempts if a.yaw_deg == 45.0)
    assert straight_attempt.makespan_s == result.makespan_s
    assert result.yaw_deg == 45.0
    bounds_mm = np.concatenate([part.solid.bounds_mm for part in result.parts])
    np.testing.assert_allclose([bounds_mm.min(axis=0), bounds_mm.max(axis=0)], bar.solid.bounds_mm, atol=1e-6)
    for part in result.parts:
        points, _ = part.build_printing_mesh()
        model_points = points @ part.to_model[:3, :3].T + part.to_model[:3, 3]
        vertices, _ = part.solid.arrays()
        np.testing.assert_allclose(model_points, vertices, atol=1e-4)
        cuts = [n for *n, d in part.planes.tolist() if np.abs(vertices @ n - d).min() < 1e-6]
        assert len(cuts) == 1  # one cut across the bar
        assert abs(cuts[0] @ rotation[:, 0]) == pytest.approx(1.0)


def test_another_grid_may_have_the_better_result(cost: CostModel, result: Decomposition) -> None:
    engines = Engines(result, lambda options: math.inf if options.granularity == "auto" else 1.5 * BOUND_S)
    best_result = find_best_result(make_problem(cost), engines)
    assert best_result.makespan_s == 1.5 * BOUND_S
    assert [a.makespan_s for a in best_result.attempts[:2]] == [None, None]
    failing_engines = Engines(result, lambda options: math.inf)
    with pytest.raises(NoFit, match="nothing at auto"):
        find_best_result(make_problem(cost), failing_engines)


@pytest.mark.parametrize(
    "error",
    [GeometryError(Rule.NO_OVERLAP, "p11", "shares 505 mm3"), ModelNotSolid("no solid")],
)
def test_result_is_kept_when_a_later_grid_fails(
    error: DecomposeError, cost: CostModel, result: Decomposition
) -> None:
    engines = Engines(result, lambda options: 1.5 * BOUND_S)

    def fail_after_first_attempt(problem: Problem) -> Decomposition:
        if engines.engine_grids:
            raise error
        return engines(problem)

    best_result = find_best_result(make_problem(cost), fail_after_first_attempt)
    assert best_result.makespan_s == 1.5 * BOUND_S
    assert {attempt.reason for attempt in best_result.attempts[1:]} == {str(error)}


def test_slow_printers_have_less_to_gain(cost: CostModel, result: Decomposition) -> None:
    """Use busy printers, ten of which are half as fast; with equal speeds, the gain would be a quarter."""
    printers = tuple(replace(p, time_factor=2.0 if i < 10 else 1.0) for i, p in enumerate(PRINTERS))
    engines = Engines(replace(result, sum_s=15.0 * 1.5 * BOUND_S), lambda _: 1.51 * BOUND_S)
    best_result = find_best_result(replace(make_problem(cost), printers=printers), engines)
    assert {cells for _, cells in engines.engine_grids} == {"auto"}
    assert best_result.compute_possible_gain(printers) == pytest.approx(1.0 - 1.5 / 1.51)
    assert best_result.compute_possible_gain(PRINTERS) == pytest.approx(1.0 - 0.75 * 1.5 / 1.51)


def test_result_with_faults_is_the_last_choice(cost: CostModel, result: Decomposition) -> None:
    def compute_makespan_s(options: Options) -> float:
        return BOUND_S * (1.5 if options.engine is Engine.GUILLOTINE else 1.6)

    engines = Engines(result, compute_makespan_s, faulty_engines=(Engine.GUILLOTINE,))
    best_result = find_best_result(make_problem(cost, granularity=8), engines)
    assert best_result.engine is Engine.PARALLELOBOX
    assert [item.best_known_s for item in engines.problems] == [math.inf, math.inf]


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (NoFit("one part too many"), "nothing was found before the budget was spent"),
        (GeometryError(Rule.WALL, "p01", "is too thin"), "p01: is too thin (rule wall)"),
    ],
)
def test_broken_rule_is_reported_after_the_budget_was_spent(
    error: DecomposeError, message: str, cost: CostModel, result: Decomposition
) -> None:
    engines = Engines(result, compute_far_makespan_s, faulty_engines=(Engine.GUILLOTINE,))

    def fail_after_budget(problem: Problem) -> Decomposition:
        if problem.options.engine is Engine.GUILLOTINE:
            return engines(problem)
        problem.effort.record(Work.SUM, round(1e12))
        assert problem.effort.is_spent()
        raise error

    second_attempt = find_best_result(make_problem(cost, granularity=8), fail_after_budget).attempts[1]
    assert second_attempt.reason.startswith(message)
    assert not second_attempt.finished


@pytest.mark.parametrize(("budget_s", "attempt_count"), [(1.9, 1), (2.1, 2), (2.9, 2), (3.1, 3)])
def test_no_attempt_starts_with_too_little_budget(
    budget_s: float,
    attempt_count: int,
    cost: CostModel,
    result: Decomposition,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Use attempts of 1 s; another one starts only if a second of the budget is left."""
    monkeypatch.setattr(rounds, "GRID_SHARE", math.inf)
    engines = Engines(result, compute_far_makespan_s)
    best_result = find_best_result(make_problem(cost, best=BestOptions(budget_s)), engines)
    assert len(engines.engine_grids) == attempt_count
    later_attempts = best_result.attempts[attempt_count:]
    assert later_attempts
    assert not any(a.finished for a in later_attempts)
    assert all("not started" in a.reason for a in later_attempts)


def test_parallelobox_is_tried_only_without_a_sound_result(cost: CostModel, result: Decomposition) -> None:
    engines = Engines(result, compute_far_makespan_s)
    find_best_result(make_problem(cost), engines)
    assert Engine.PARALLELOBOX not in {engine for engine, _ in engines.engine_grids}


@pytest.mark.parametrize("budget_s", [0.0, 2.0])
@pytest.mark.parametrize("is_faulty", [False, True])
def test_small_budget_refuses_no_model_that_a_finer_grid_can_cut(
    budget_s: float, is_faulty: bool, cost: CostModel, result: Decomposition
) -> None:
    """Let coarse grids and the other engine return no result, or a faulty one."""

    def run_engine(problem: Problem) -> Decomposition:
        is_coarse = problem.options.granularity != "auto" or problem.options.engine == Engine.PARALLELOBOX
        fault = (problem.options.engine,) if is_coarse and is_faulty else ()
        return Engines(result, lambda _: math.inf if is_coarse and not is_faulty else 1.2 * BOUND_S, fault)(
            problem
        )

    best_result = find_best_result(make_problem(cost, best=BestOptions(budget_s)), run_engine)
    assert not best_result.faults
    assert best_result.attempts[0].granularity != "auto"
    assert best_result.attempts[1].granularity == "auto"


def test_first_grid_is_coarser_for_a_small_budget(cost: CostModel) -> None:
    grids = [
        choose_first_granularity(make_problem(cost, best=BestOptions(budget_s)))
        for budget_s in (0.0, 2.0, 6.0)
    ]
    assert grids[0] == 15  # the same as for few printers
    assert [*grids] == sorted(grids)
    assert grids[1] < grids[2] < make_problem(cost).choose_granularity(BLOCK)
    assert choose_first_granularity(make_problem(cost)) == "auto"
    assert choose_first_granularity(make_problem(cost, granularity=30, best=BestOptions(0.0))) == 30
    small_printers = tuple(TargetPrinter(str(i), ((32.0, 32.0, 32.0),)) for i in range(20))
    assert (
        choose_first_granularity(replace(make_problem(cost, best=BestOptions(0.0)), printers=small_printers))
        == 19
    )
