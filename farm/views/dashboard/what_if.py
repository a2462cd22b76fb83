"""Forecast with a what-if change to the start of a job or to its place in the queue. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from farm.model import Job
from farm.scheduling import Situation, WaitingPlate, describe_plates
from farm.state import Books, PlateState, put, replace_fields
from farm.state import events as ev
from farm.state.transitions import apply
from farm.views.context import ViewContext
from farm.views.dashboard.fleet_plan import FleetPlan, build_fleet_plan


@dataclass(frozen=True, slots=True)
class Change:
    """What-if change to a job.

    Attributes
    ----------
    job
        Id of the job.
    is_moved
        True if the job is moved in the queue: before the job `successor`, or to the end if it is None.
    not_before_s
        New earliest start, in seconds since the epoch; None to keep the present one.
    """

    job: int
    is_moved: bool = False
    successor: int | None = None
    not_before_s: float | None = None


@dataclass(frozen=True, slots=True)
class JobDelay:
    """Ends of a job without and with a change, seconds since the epoch; None if it is not in the forecast."""

    job: Job
    end_s: float | None
    new_end_s: float | None

    @property
    def delay_s(self) -> float | None:
        """Delay of the job's end by the change, in seconds; negative if it ends earlier, None if unknown."""
        return None if self.end_s is None or self.new_end_s is None else self.new_end_s - self.end_s


def apply_change(books: Books, change: Change, now_s: float) -> Books:
    """Return the books after a change to a job.

    Raises
    ------
    NotFoundError
        If there is no such job.
    InvalidTransition
        If the job cannot be moved.
    """
    books.get_job(change.job)
    if change.is_moved:
        event = ev.JobMoved(at_s=now_s, job=change.job, before=change.successor, by="")
        books, _ = apply(event, books)
    if change.not_before_s is not None:
        books = put(books, replace_fields(books.get_job(change.job), not_before_s=change.not_before_s))
    return books


def change_situation(situation: Situation, books: Books, change: Change, now_s: float) -> Situation:
    """Return the situation for a forecast with a change.

    The situation includes the plates of the changed job even if the job waits for approval or is paused.

    Parameters
    ----------
    situation
        The present situation.
    books
        The present books.
    change
        The what-if change.
    now_s
        Farm time, seconds since the epoch.
    """
    changed_books = apply_change(books, change, now_s)
    other_plates = tuple(
        _update_rank(plate, changed_books) for plate in situation.waiting_plates if plate.job != change.job
    )
    plates = (
        p
        for p in books.list_plates(books.get_job(change.job))
        if books.find_plate_state(p) is PlateState.WAITING
    )
    return situation.with_waiting_plates((*other_plates, *describe_plates(plates, changed_books)))


def _update_rank(plate: WaitingPlate, books: Books) -> WaitingPlate:
    job = books.get_job(plate.job)
    return replace(plate, priority=job.priority, rank=job.moved_rank)


def compare_plans(context: ViewContext, plan: FleetPlan, changed_plan: FleetPlan) -> list[JobDelay]:
    """Compare the ends of jobs in two plans, sorted by their ends in the first plan.

    Jobs that are in neither plan are left out.
    """
    ends_s, new_ends_s = plan.find_job_ends_s(), changed_plan.find_job_ends_s()
    delays = [
        JobDelay(job, ends_s.get(job.id), new_ends_s.get(job.id))
        for job in context.books.jobs.values()
        if job.id in ends_s or job.id in new_ends_s
    ]
    return sorted(delays, key=lambda delay: (_find_end_s(ends_s, delay.job.id), delay.job.id))


def _find_end_s(ends_s: Mapping[int, float], job: int) -> float:
    return ends_s.get(job, float("inf"))


def try_change(
    context: ViewContext, situation: Situation, change: Change, since_s: float
) -> tuple[FleetPlan, list[JobDelay]]:
    """Forecast the fleet with a change, and compare it with the present plan.

    Parameters
    ----------
    context
        Current data of the farm.
    situation
        Situation for the forecast.
    change
        The what-if change.
    since_s
        Time in seconds since the epoch; prints that ended before it are left out.

    Returns
    -------
    FleetPlan
        Plan with the change.
    list of JobDelay
        Ends of each job without and with the change.
    """
    plan = build_fleet_plan(context, situation, since_s)
    changed_situation = change_situation(situation, context.books, change, context.now_s)
    changed_plan = build_fleet_plan(context, changed_situation, since_s)
    return changed_plan, compare_plans(context, plan, changed_plan)
