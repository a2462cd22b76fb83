"""Engine `best`: the guillotine engine on several grids, within a budget.

The result depends on the number of cells and on the angle of the model in the grid: grids with more or fewer
cells are tried, then the model turned about z, then the other grids at the best angle. Where the first grid,
coarser for a small budget, has no sound result, the usual one follows, then Parallelobox.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from time import perf_counter

from scipy.spatial.transform import Rotation

from decompose.errors import DecomposeError, GeometryError, ModelNotSolid, NoFit
from decompose.grid import count_cells, count_cuts
from decompose.options import Engine
from decompose.problem import MAX_CELLS, WORK_NS, Effort, Problem, Work, choose_granularity
from decompose.progress import report_progress
from decompose.results import Attempt, Decomposition

GRID_SHARE = 0.5  # share of the budget for the tables of the first grid, its solves and its bound
USUAL_SOLVES = 30  # usual number of solves on a grid, each for another limit
START_SHARE = 0.5  # share of the first attempt's effort that must be left to start another attempt
OTHER_GRIDS = (1.1, 0.95, 0.9)  # ratios of the number of cells along a side to that of the first grid
# Rotations of the model about z; after a quarter turn the grid is the same.
OTHER_YAWS_DEG = (45.0, 15.0, 75.0, 30.0, 60.0)
# Minimum gain of a rotation, as a share of the makespan: cuts along a model's own sides are easier to glue.
MIN_TURNING_GAIN = 0.01
MIN_GAIN = 0.03  # minimum possible gain, as a share of the makespan, for which another grid is tried


def find_best(problem: Problem, by_engine: Callable[[Problem], Decomposition]) -> Decomposition:
    """Run the engines and grids in their order until the budget is spent, and return the best result.

    Parameters
    ----------
    problem
        Problem with the options of the engine `best`.
    by_engine
        Returns the checked result of the engine that a problem's options name.

    Raises
    ------
    NoFit, GeometryError, ModelNotSolid
        Error of the first engine, if no engine has a result.
    """
    options = problem.options
    trials = _Trials(problem, by_engine, options.best.budget_s)
    first = choose_first_grid(problem)
    trials.try_engine(Engine.GUILLOTINE, first)
    if not trials.has_sound_result and first != options.granularity:
        first = options.granularity  # with a small budget the model still has to be cut
        trials.remaining_s = options.best.budget_s
        trials.try_engine(Engine.GUILLOTINE, first, is_required=True)
    if not trials.has_sound_result:
        trials.try_engine(Engine.PARALLELOBOX, options.granularity)
    if options.granularity == "auto" and len(problem.printers) > 1:
        trials.try_other_grids(first)
        for yaw_deg in OTHER_YAWS_DEG:
            trials.try_engine(Engine.GUILLOTINE, first, yaw_deg)
        if trials.yaw_deg:
            trials.try_other_grids(first)
    return trials.result()


def choose_first_grid(problem: Problem) -> str | int:
    """Choose the first granularity: the requested one, or a coarser one than ``auto`` for a small budget.

    The grid is not made coarser than parts of the size of the printers' rooms need.
    """
    options, extents_mm = problem.options, problem.model.extents_mm
    if options.granularity != "auto":
        return options.granularity
    cells = finest = problem.granularity(problem.model)
    min_cells = choose_granularity("auto", 1, max(extents_mm) / min(problem.room_mm))
    while cells > min_cells and _estimate_grid_s(count_cells(extents_mm, cells)) > (
        GRID_SHARE * options.best.budget_s
    ):
        cells -= 1
    return "auto" if cells == finest else cells


def _estimate_grid_s(shape: tuple[int, int, int]) -> float:
    """Estimate the effort in s for a grid of cells: its tables, their solves, and the bound by them."""
    boxes = math.prod(n * (n + 1) // 2 for n in shape)
    box_ns = WORK_NS[Work.BOX_PRICED] + WORK_NS[Work.BOX_PROVEN]
    return (boxes * box_ns + USUAL_SOLVES * count_cuts(shape) * WORK_NS[Work.SUM]) / 1e9


@dataclass(slots=True)
class _Trials:
    """Attempts so far and the best of them, with the model turned by `yaw_deg`."""

    problem: Problem
    by_engine: Callable[[Problem], Decomposition]
    remaining_s: float
    best: Decomposition | None = None
    yaw_deg: float = 0.0
    attempts: list[Attempt] = field(default_factory=list)
    failure: DecomposeError | None = None

    @property
    def has_sound_result(self) -> bool:
        """Check that an attempt has parts without faults."""
        return self.best is not None and not self.best.faults

    def result(self) -> Decomposition:
        """Return the best result; raises the error of the first engine if there is none."""
        if self.best is None:
            assert self.failure is not None  # the first engine is always tried
            raise self.failure
        options = self.problem.options
        return replace(self.best, options=options, yaw_deg=self.yaw_deg, attempts=tuple(self.attempts))

    def try_engine(
        self, engine: Engine, cells: str | int, yaw_deg: float = 0.0, is_required: bool = False
    ) -> None:
        """Add an engine's attempt, unless too little of the budget is left; the first is made in any case."""
        is_required = is_required or not self.attempts
        least_s = START_SHARE * self.attempts[0].effort_s if self.attempts else -math.inf
        if not is_required and (self.remaining_s <= 0.0 or (self.best and self.remaining_s < least_s)):
            result_text = "not begun: the budget was spent"
            self.attempts.append(Attempt(engine, cells, yaw_deg, finished=False, reason=result_text))
            return
        effort = Effort(self.remaining_s, on_spent=self._report_spent)
        started_s, makespan_s, reason = perf_counter(), None, ""
        best_known_s = math.inf if self.best is None or self.best.faults else self.best.makespan_s
        options = replace(self.problem.options, engine=engine, granularity=cells)
        trial = replace(
            rotate_about_z(self.problem, yaw_deg),
            options=options,
            effort=effort,
            best_known_s=best_known_s,
            thorough=True,
        )
        try:
            decomposition = self.by_engine(trial)
            makespan_s = decomposition.makespan_s
            if self._is_better(decomposition, yaw_deg):
                self.best, self.yaw_deg = decomposition, yaw_deg
        except (NoFit, GeometryError, ModelNotSolid) as error:
            self.failure = self.failure or error
            out_of_budget = effort.cut_short and isinstance(error, NoFit)
            reason = "nothing was found before the budget was spent" if out_of_budget else str(error)
        elapsed_s, has_finished = perf_counter() - started_s, not effort.cut_short
        self.attempts.append(
            Attempt(engine, cells, yaw_deg, makespan_s, elapsed_s, effort.spent_s, has_finished, reason)
        )
        self.remaining_s -= effort.spent_s

    def _report_spent(self, spent_s: float) -> None:
        """Report the share of the budget that this and the earlier attempts have spent."""
        budget_s = self.problem.options.best.budget_s
        if budget_s > 0.0:
            report_progress(min(1.0, (budget_s - self.remaining_s + spent_s) / budget_s))

    def _is_better(self, decomposition: Decomposition, yaw_deg: float) -> bool:
        if self.best is None:
            return True
        if yaw_deg and not self.yaw_deg:
            decomposition = replace(
                decomposition, makespan_s=decomposition.makespan_s / (1.0 - MIN_TURNING_GAIN)
            )
        return _make_rank(decomposition) < _make_rank(self.best)

    def try_other_grids(self, granularity: str | int) -> None:
        """Try grids around one of a granularity, each once, while the possible gain is large enough."""
        problem, yaw_deg = rotate_about_z(self.problem, self.yaw_deg), self.yaw_deg
        problem = replace(problem, options=replace(problem.options, granularity=granularity))
        extents_mm, first = problem.model.extents_mm, problem.granularity(problem.model)
        shapes = {count_cells(extents_mm, first)}
        for share in OTHER_GRIDS:
            cells = min(MAX_CELLS, round(share * first))
            shape = count_cells(extents_mm, cells)
            if self.best is not None and self.best.compute_possible_gain(problem.printers) < MIN_GAIN:
                break
            if shape not in shapes:
                shapes.add(shape)
                self.try_engine(Engine.GUILLOTINE, cells, yaw_deg)


def rotate_about_z(problem: Problem, yaw_deg: float) -> Problem:
    """Rotate a problem's model about z."""
    return problem.rotate(Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix())


def _make_rank(result: Decomposition) -> tuple[bool, float, int]:
    """Make the sort key of a result; lower is better."""
    return bool(result.faults), result.makespan_s, len(result.parts)
