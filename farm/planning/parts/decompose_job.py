"""Decomposition of a job's model for its printers. Runs in a worker."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from decompose.auto import CountGoal, build_curve, decompose_for_goal
from decompose.best import listen_to_progress
from decompose.decompose import decompose_model
from decompose.engines.guillotine import ASSEMBLY_S
from decompose.errors import NoFit
from decompose.export import write_parts
from decompose.geometry import Model, Solid
from decompose.jit import is_compiled
from decompose.options import BestOptions, Engine, Options
from decompose.paused_search import PausedSearch
from decompose.print_time import CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter
from decompose.problem import Problem
from decompose.results import Decomposition, Part
from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.planning.decompose_progress import ProgressFile
from farm.planning.error_translation import translate_errors
from farm.planning.inspection.inspect_submission import read_inspected_model
from farm.planning.part_records import DecomposedPart
from farm.planning.parts.copies import choose_evenly_spaced_items, iterate_part_counts
from farm.planning.parts.cut_record import write_cut_record
from farm.planning.parts.job_drawing import write_drawing_record
from farm.planning.parts.pricing import build_decompose_options, build_target_printers, estimate_time_factors
from farm.planning.plan import DecomposedJob, DecomposeTask, PausedDecomposition, TooFewPrinters
from farm.planning.plate_times import reassign_loads
from slicing.settings import find_resources


def warm_up_planning(report: Callable[[str], object]) -> None:
    """Load the planning code before the first job by cutting a small box, and compile it if necessary."""
    if not is_compiled():
        report("compiling the planning code, which takes minutes; `farm setup` does it in advance")
    box = Model(Solid.box((0.0, 0.0, 0.0), (30.0, 10.0, 10.0)), (), 1.0)
    printers = [TargetPrinter(name, ((20.0, 20.0, 20.0),)) for name in "ab"]
    decompose_model(box, printers, Options(prove=False), CostModel.from_settings(PrintTimeSettings()))


def decompose_job(task: DecomposeTask) -> DecomposedJob | PausedDecomposition:
    """Cut a job's model for its printers, and write the parts into the task's folder.

    Returns
    -------
    DecomposedJob | PausedDecomposition
        A `PausedDecomposition` is returned only with `DecomposeTask.may_pause`.

    Raises
    ------
    TooFewPrinters
        If the model needs more printers; `needed_count` of the error would suffice.
    FarmError
        With code `no_fit`, `geometry`, `settings` or `model`, and the reason.
    """
    with translate_errors():
        resources = find_resources()
    model, quality = read_inspected_model(task.model), task.options.quality
    time_factors = estimate_time_factors(task.printers, task.time_factors, model.solid, quality, resources)
    printers, cost = build_target_printers(task.printers, time_factors, quality, resources, task.round_count)
    options = build_decompose_options(task.options, task.printers)
    if task.budget_s is not None:
        may_pause = task.may_pause and not task.options.dry_run
        options = replace(options, best=BestOptions(task.budget_s, may_pause))
    progress = ProgressFile(task.folder)
    progress.report(0.0, time.monotonic())
    try:
        with (
            listen_to_progress(lambda share: progress.report(share, time.monotonic())),
            ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads,  # they end with the worker
        ):
            assembly_s = ASSEMBLY_S * task.assembly_ratio
            goal = CountGoal(assembly_s=assembly_s, includes_gluing=task.options.assembled_by is not None)
            decomposition = ModelCutter(model, printers, options, cost, threads, goal).cut(task)
            search = PausedSearch(decomposition, model, cost, threads)
        return finish_job(search, task)
    except NoFit as error:
        if error.needed_printer_count is not None and error.needed_printer_count > len(printers):
            raise TooFewPrinters(str(error), error.needed_printer_count) from error
        raise FarmError(str(error), ErrorCode.NO_FIT) from error
    except Exception:
        with translate_errors():
            raise


def finish_job(search: PausedSearch, task: DecomposeTask) -> DecomposedJob | PausedDecomposition:
    """Write the parts that a search has found into the task's folder, or the record of a paused search.

    The record is a pickle of the best result, which only workers of the same version can read.
    """
    best = search.best_result
    if best.open_printers:
        record = task.folder / f"search-{len(best.attempts)}.pickle"
        record.write_bytes(pickle.dumps(best))
        return PausedDecomposition(record, len(search.plan_round()), search.spent_share)
    time_factors = estimate_time_factors(
        task.printers, task.time_factors, search.model.solid, task.options.quality, find_resources()
    )
    decomposition = replace(best, parts=_reassign_parts(best.parts, task.printers, time_factors))
    return write_decomposed_job(decomposition, search.model, task.folder)


def write_decomposed_job(decomposition: Decomposition, model: Model, folder: Path) -> DecomposedJob:
    """Write the files of a decomposition into a folder, and describe its parts.

    The files are the parts, the report, the cut record and the drawing record.

    Parameters
    ----------
    decomposition, model
        The parts, and the model that they were cut from.
    folder
        Folder of the job's plan.
    """
    stored_decomposition = write_parts(decomposition, folder)
    messages = (
        stored_decomposition.describe_thin_rims(),
        stored_decomposition.describe_small_feet(),
        *stored_decomposition.connectors.failures,
    )
    warnings = [text for text in messages if text]
    ranks = {number: rank for rank, number in enumerate(stored_decomposition.assembly.part_order, 1)}
    return DecomposedJob(
        parts=tuple(
            DecomposedPart.from_part(part, folder, ranks.get(number))
            for number, part in enumerate(stored_decomposition.parts)
        ),
        serial_price_s=stored_decomposition.serial_s,
        repairs=(*model.repairs, *(f"Warning: {text}." for text in warnings)),
        scale=model.scale,
        drawing_record=write_drawing_record(stored_decomposition, folder),
        cut_record=write_cut_record(stored_decomposition, folder),
        assembly_s=stored_decomposition.assembly.total_s if stored_decomposition.assembly.steps else None,
        step_count=len(stored_decomposition.assembly.steps),
    )


def _reassign_parts(
    parts: Sequence[Part], printers: Sequence[PrinterSection], time_factors: Mapping[str, float]
) -> tuple[Part, ...]:
    """Exchange loads among printers that differ only in speed: the fastest get the largest loads."""
    loads_s: dict[str, float] = {}
    for part in parts:
        loads_s[part.printer] = loads_s.get(part.printer, 0.0) + part.price_s
    kinds = {s.name: (s.model, s.material, s.nozzle_mm, s.volume_mm) for s in printers}
    new_printers = reassign_loads(loads_s, kinds, time_factors)
    return tuple(replace(part, printer=new_printers[part.printer]) for part in parts)


DEADLINE_MARGIN_RATIO = 1.1
"""Ratio of the time until `--done-by` to the time for which the parts are cut. The margin is for planning
and for prints that take longer than expected."""


@dataclass(frozen=True, slots=True)
class ModelCutter:
    """Cutter of a model for some printers. Every method raises the errors of `decompose`.

    Attributes
    ----------
    goal
        Goal by which the number of printers is chosen.
    """

    model: Model
    printers: list[TargetPrinter]
    options: Options
    cost: CostModel
    executor: Executor
    goal: CountGoal

    def cut(self, task: DecomposeTask) -> Decomposition:
        """Cut the model for the copies, the time limit and the number of printers of a task."""
        if task.options.copies > 1:
            return self.cut_for_copies(task)
        if task.time_limit_s is not None:
            decomposition = self.cut_within_time(task.time_limit_s)
        elif task.options.printers is None:
            decomposition = self.keep_model_whole() or self.cut_for_worthwhile_printers()
        else:
            decomposition = self.cut_for_all_printers()
        is_curve_shown = task.options.dry_run and task.options.printers is None
        return self.add_curve(decomposition) if is_curve_shown else decomposition

    def cut_for_all_printers(self) -> Decomposition:
        """Cut the model for all of the printers."""
        return decompose_model(self.model, self.printers, self.options, self.cost, self.executor)

    def cut_for_worthwhile_printers(self, time_limit_s: float | None = None) -> Decomposition:
        """Cut the model for as many printers as save time, or for the fewest that finish within a time."""
        goal = replace(self.goal, time_limit_s=time_limit_s)
        return decompose_for_goal(self.model, self.printers, self.options, self.cost, self.executor, goal)

    def keep_model_whole(self) -> Decomposition | None:
        """Keep the model whole, on the printer of lowest build height that it fits; None if it fits none.

        A user who wants the job to end sooner requests a number of printers.
        """
        x, y, z = map(float, self.model.extents_mm)
        poses = ((x, y, z), (y, z, x), (z, x, y))
        fitting_printers = [p for p in self.printers if any(p.fits(*pose) for pose in poses)]
        options = replace(self.options, engine=Engine.GUILLOTINE)  # finds one part if one suffices
        for printer in sorted(fitting_printers, key=lambda p: max(box[2] for box in p.box_sizes_mm)):
            try:
                return decompose_model(self.model, [printer], options, self.cost, self.executor)
            except NoFit:
                continue
        return None

    def add_curve(self, decomposition: Decomposition) -> Decomposition:
        """Add the curve of the printing time over the number of printers, for a dry run."""
        if decomposition.curve:
            return decomposition
        problem = Problem(self.model, tuple(self.printers), self.cost, self.options, self.executor)
        return replace(decomposition, curve=build_curve(problem))

    def cut_for_copies(self, task: DecomposeTask) -> Decomposition:
        """Cut the model for a share of the printers, so that all copies print at the same time.

        If the model needs more parts than that share has printers, the copies are printed in several rounds.
        A model that fits into one printer stays whole, unless the user requests a number of printers, or a
        time by which whole copies would not be finished.
        """
        copy_count, printer_count = task.options.copies, len(task.printers)
        limit_s = None if task.time_limit_s is None else task.time_limit_s / DEADLINE_MARGIN_RATIO
        is_count_requested = task.options.printers is not None and limit_s is None
        whole_model = None if is_count_requested and copy_count < printer_count else self.keep_model_whole()
        if whole_model is not None and (
            limit_s is None or whole_model.makespan_s * -(-copy_count // printer_count) <= limit_s
        ):
            return whole_model
        part_limit, min_parts = len(self.printers), 0
        indices_by_kind = sorted(range(part_limit), key=lambda i: self.printers[i].box_sizes_mm)
        for round_count, part_count in iterate_part_counts(copy_count, printer_count, part_limit):
            if part_count < min_parts and part_count < part_limit:
                continue
            # Sorted, so that the fastest printer is first, as in `self.printers`.
            chosen_indices = sorted(choose_evenly_spaced_items(indices_by_kind, part_count))
            cutter = replace(self, printers=[self.printers[i] for i in chosen_indices])
            try:
                if is_count_requested:
                    return cutter.cut_for_all_printers()
                return cutter.cut_for_worthwhile_printers(None if limit_s is None else limit_s / round_count)
            except NoFit as error:
                if part_count == part_limit:
                    raise
                min_parts = error.needed_printer_count or 0
        raise AssertionError("the last attempt has all printers")

    def cut_within_time(self, time_limit_s: float) -> Decomposition:
        """Cut the model into the fewest parts that meet a time limit with a margin.

        If the limit cannot be met, cut it into the parts that end soonest.
        """
        limit_s = time_limit_s / DEADLINE_MARGIN_RATIO
        whole_model = self.keep_model_whole()
        if whole_model is not None and whole_model.makespan_s <= limit_s:
            return whole_model
        return self.cut_for_worthwhile_printers(time_limit_s=limit_s)
