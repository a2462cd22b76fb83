"""Adjustment of a job's cuts to the times of its parts according to the slicer. Runs in a worker."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple
from pathlib import Path

from decompose.print_time import CostModel
from decompose.rebalance import SlicedCuts, rebalance_planes
from farm.model import FeatureSeconds, TimeFactors
from farm.planning.error_translation import translate_errors
from farm.planning.inspection.inspect_submission import read_inspected_model
from farm.planning.parts.cut_record import read_cut_record
from farm.planning.parts.decompose_job import write_decomposed_job
from farm.planning.parts.pricing import build_printer_cost, compute_time_ratio
from farm.planning.plan import DecomposedJob, SlicedJob
from farm.planning.printer_settings import resolve_printer_settings
from slicing.settings import find_resources


def rebalance_parts(rounds: Sequence[SlicedJob], folder: Path) -> DecomposedJob | None:
    """Move the cuts of a job so that the part with the longest sliced time finishes sooner.

    Parameters
    ----------
    rounds
        A job with a cut record (`SlicedJob.should_rebalance`), and the same job after each move so far.
    folder
        Folder for the new parts.

    Returns
    -------
    DecomposedJob | None
        The job with new parts; None if moved cuts save no time.

    Raises
    ------
    FarmError
        With code `geometry`, `no_fit` or `settings`, and the reason.
    """
    task = rounds[0].task
    with translate_errors():
        resources = find_resources()
    costs = {
        section.name: build_printer_cost(
            section, resolve_printer_settings(section, task.options.quality, resources)
        )
        for section in task.printers
    }
    cuts = [_read_cuts(sliced_job, costs) for sliced_job in rounds]
    model = read_inspected_model(task.model)
    with translate_errors(), ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:
        # One cost model prices all parts, as in `build_target_printers`.
        new_decomposition = rebalance_planes(model, cuts, costs[task.printers[0].name], threads)
        if new_decomposition is None:
            return None
        return write_decomposed_job(new_decomposition, model, folder)


def _read_cuts(sliced_job: SlicedJob, costs: Mapping[str, CostModel]) -> SlicedCuts:
    """Read the cuts of a job, with times relative to the cost model of the first printer.

    Parameters
    ----------
    sliced_job
        Sliced job with a cut record.
    costs
        Cost model of each printer.
    """
    assert sliced_job.decomposed_job.cut_record is not None  # cuts without a record are not moved
    cost = costs[sliced_job.task.printers[0].name]
    times_s = [
        part_s / compute_time_ratio(costs[part.printer.name], cost)
        for part, part_s in zip(sliced_job.parts, _compute_times_s(sliced_job), strict=True)
    ]
    decomposition = read_cut_record(sliced_job.decomposed_job.cut_record)
    return SlicedCuts(decomposition, times_s, sliced_job.compute_makespan_s())


def _compute_times_s(sliced_job: SlicedJob) -> list[float]:
    """Compute the time of each part relative to the speed of its printer, for `rebalance_planes`.

    That function assumes one speed for each printer, which is its speed for the features of the whole job. So
    each time is multiplied by the printer's time factor for the part, and divided by that for the job.
    """
    parts = sliced_job.parts
    totals_s = map(sum, zip(*(astuple(part.result.features) for part in parts), strict=True))
    job_shares = FeatureSeconds(**dict(zip(FeatureSeconds.model_fields, totals_s, strict=True))).shares
    times_s = []
    for part in parts:
        factors = sliced_job.task.find_time_factors(part.printer.name)
        relative_factor = factors.compute_factor(part.features.shares) / factors.compute_factor(job_shares)
        times_s.append(part.compute_expected_s(TimeFactors(relative_factor)))
    return times_s
