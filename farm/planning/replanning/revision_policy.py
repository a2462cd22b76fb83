"""Policy of plan revisions: decides whether a job is planned again for other printers before it starts. Pure.

A job is planned as soon as it is submitted, for the printers that are available then. When it can start, the
number of free printers may have changed. It is then planned again if the new plan ends sooner by a margin.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from farm.planning.replanning.policy import JOINING_TIME_S, saves_enough
from farm.scheduling import Requirements, Situation, WaitingPlate, compute_printing_s, forecast_prints

MAX_REVISIONS = 3
"""Maximum number of times that the plan of a job is replaced."""
CUT_GROWTH_SHARE = 0.15
"""Maximum share by which the printing time of all parts grows if a model is cut into more parts."""


@dataclass(frozen=True, slots=True)
class PlannedJob:
    """Planned job without a started plate.

    Attributes
    ----------
    id
        Id of the job.
    plates
        Its waiting plates, at least one.
    planned_for
        The printers that were available to its plan.
    requirements
        Requirements on each printer, independent of the plan.
    planning_s
        Time to make another plan, in seconds of the farm's clock.
    print_deadline_s
        Time by which its last part must be printed; None for no limit.
    end_s
        Time at which it ends if all of its plates start now; None if some of them cannot.
    """

    id: int
    plates: tuple[WaitingPlate, ...]
    planned_for: tuple[str, ...]
    requirements: Requirements
    planning_s: float
    print_deadline_s: float | None = None
    end_s: float | None = None


def may_revise(job: PlannedJob, situation: Situation, candidates: Iterable[Sequence[str]]) -> bool:
    """Return whether another plan may save time, according to quick estimates without a forecast."""
    if job.end_s is None:
        return any(_has_other_printers(job, names) for names in candidates)
    if job.print_deadline_s is not None and job.end_s <= job.print_deadline_s:
        return False
    return any(_may_save_time(job, tuple(names), job.end_s, situation) for names in candidates)


def choose_revision(
    job: PlannedJob, situation: Situation, candidates: Iterable[Sequence[str]]
) -> tuple[str, ...] | None:
    """Choose the printers for which a job is planned again; None if its plan is kept.

    The plan is also kept if the estimated new plan would be revised again immediately.

    Parameters
    ----------
    job
        A job whose plates wait in the situation.
    situation
        The current situation.
    candidates
        Sets of printers for which it could be planned.
    """
    printer_sets = list(dict.fromkeys(tuple(names) for names in candidates))
    best = _find_best_printers(job, situation, printer_sets)
    if best is None:
        return None
    plate_ids = {plate.id for plate in job.plates}
    plates = estimate_plates(job, best)
    new_situation = situation.with_waiting_plates((*situation.waiting_plates.without(plate_ids), *plates))
    is_final = (
        _find_best_printers(
            replace(job, plates=plates, planned_for=best, end_s=None), new_situation, printer_sets
        )
        is None
    )
    return best if is_final else None


def _find_best_printers(
    job: PlannedJob, situation: Situation, candidates: Sequence[tuple[str, ...]]
) -> tuple[str, ...] | None:
    """Find the set of printers whose plan ends soonest; None if no plan saves enough."""
    if not may_revise(job, situation, candidates):
        return None
    plate_ids = {plate.id for plate in job.plates}
    # Later jobs do not delay this job; without them the forecast is fast.
    earlier_jobs = replace(
        situation, waiting_plates=situation.waiting_plates.limit_to_rank(job.plates[0].queue_rank)
    )
    current_end_s = find_end_s(plate_ids, earlier_jobs) if job.end_s is None else job.end_s
    if job.print_deadline_s is not None and current_end_s <= job.print_deadline_s:
        return None
    ends_s = {}
    for names in candidates:
        if _may_save_time(job, names, current_end_s, situation):
            plates = estimate_plates(job, names)
            other_plates = earlier_jobs.waiting_plates.without(plate_ids)
            new_situation = earlier_jobs.with_waiting_plates((*other_plates, *plates))
            ends_s[names] = find_end_s({p.id for p in plates}, new_situation) + _estimate_extra_time_s(
                job, names
            )
    best = min(ends_s, key=ends_s.__getitem__, default=None)
    if best is None or math.isinf(ends_s[best]):
        return None
    return best if saves_enough(current_end_s, ends_s[best], situation.now_s) else None


def _may_save_time(job: PlannedJob, names: Sequence[str], current_end_s: float, situation: Situation) -> bool:
    """Return whether a plan saves enough time if each of its plates starts on the fastest printer now."""
    if not _may_be_better(job, names, current_end_s):
        return False
    plate = estimate_plates(job, names)[0]
    earliest_s = situation.now_s + min(compute_printing_s(plate, printer) for printer in situation.printers)
    return saves_enough(current_end_s, earliest_s + _estimate_extra_time_s(job, names), situation.now_s)


def _estimate_extra_time_s(job: PlannedJob, names: Sequence[str]) -> float:
    """Estimate the seconds to make another plan, and to join its additional parts."""
    return JOINING_TIME_S * max(0, len(names) - len(job.plates)) + job.planning_s


def _has_other_printers(job: PlannedJob, names: Sequence[str]) -> bool:
    return bool(names) and set(names) != set(job.planned_for)


def _may_be_better(job: PlannedJob, names: Sequence[str], current_end_s: float) -> bool:
    """Return whether a plan for some printers may differ from the current plan, and be better."""
    if not _has_other_printers(job, names):
        return False
    if math.isinf(current_end_s):
        return True
    # Some printers print several of its plates in turn, because fewer and larger parts would not fit.
    if len(job.plates) > len(job.planned_for):
        return len(names) >= len(job.plates)
    # If the plan did not use all of its printers, a plan for more printers would not use them either.
    if len(names) > len(job.plates):
        return len(job.plates) >= len(job.planned_for)
    return len(names) < len(job.plates)


def estimate_plates(job: PlannedJob, names: Sequence[str]) -> tuple[WaitingPlate, ...]:
    """Estimate the plates of a plan for some printers: equal parts, one for each printer."""
    first = job.plates[0]
    layers_s = sum((p.expected_s - p.overhead_s) / p.time_factor for p in job.plates)
    work_ratio = 1.0 + CUT_GROWTH_SHARE if len(names) > len(job.plates) else 1.0
    part_plate = replace(
        first,
        requirements=job.requirements,
        expected_s=first.overhead_s + layers_s * work_ratio / len(names),
        grams=sum(p.grams for p in job.plates) * work_ratio / len(names),
        time_factor=1.0,
    )
    return tuple(
        replace(part_plate, id=f"{job.id}/revised-{index:02d}", name="", planned_printer=name)
        for index, name in enumerate(names)
    )


def find_end_s(plates: set[str], situation: Situation) -> float:
    """Return the expected end of the last of these plates; infinity if one of them never starts."""
    ends_s = {slot.plate: slot.end_s for slot in forecast_prints(situation, include_bound=False).slots}
    return max((ends_s.get(plate, math.inf) for plate in plates), default=situation.now_s)
