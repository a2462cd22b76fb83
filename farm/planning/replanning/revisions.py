"""Revisions of plans: before its first plate starts, a job may be planned again for other printers."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence

from farm.errors import FarmError
from farm.model import Hold, HoldCode, Job, JobState, compute_assembly_ratio
from farm.planning.plan import Plan
from farm.planning.planned_event import build_planned_event
from farm.planning.replanning.policy import CUTTING_TIME_S
from farm.planning.replanning.revision_policy import (
    MAX_REVISIONS,
    PlannedJob,
    choose_revision,
    find_end_s,
    may_revise,
)
from farm.scheduling import (
    SPARE_PURPOSE,
    Assignment,
    Availability,
    FleetPrinter,
    JobRequest,
    Situation,
    StartPlanning,
    WaitingPlate,
    compute_printing_s,
    derive_job_requirements,
    describe_plates,
    join_names,
    limit_availability,
    list_usable_printers,
)
from farm.state import Books, PlateState
from farm.state import events as ev
from farm.state.transitions import apply

log = logging.getLogger(__name__)

PLANNING_TIMEOUT_RATIO = 3.0
"""Multiple of the expected planning time after which a job starts with its current plan."""
MAX_FORECAST_SIZE = 1000
"""Limit on the number of printers and plates in the forecasts of one run of the scheduler. Above it, the
remaining jobs wait for the next run."""
_ExaminationKey = tuple[int, str | None, frozenset[str], frozenset[str]]
"""Id of a job, hash of its plan, and the idle and the usable printers for which it was examined."""


class PlanRevisions:
    """Coordinator that decides which jobs are planned again, and whether the new plans are used.

    A job is examined when its first plate could start, and when a printer of its plan is no longer available.
    Its plates do not start while another plan is made. The state is in memory only: after a restart, jobs are
    examined again.

    Attributes
    ----------
    has_remaining_jobs
        True if jobs remain for the next run of the scheduler, which begins immediately.
    postponed_plates
        Plates of these jobs that could start, but wait until their job is examined.
    """

    def __init__(self) -> None:
        self._running: dict[int, StartPlanning] = {}
        self._start_times_s: dict[int, float] = {}
        self._hold_ends_s: dict[int, float] = {}
        self.has_remaining_jobs, self.postponed_plates = False, frozenset[str]()
        self._examined_keys: set[_ExaminationKey] = set()
        # For each job: its version in the books, and whether its plan may change.
        self._change_checks: dict[int, tuple[object, bool]] = {}

    def is_running(self, job_id: int) -> bool:
        """Return whether a job is being planned again."""
        return job_id in self._running

    def end_replanning(self, job_id: int) -> None:
        """Record that the replanning of a job has ended."""
        self._running.pop(job_id, None)
        self._hold_ends_s.pop(job_id, None)

    @property
    def reserved_printers(self) -> dict[str, str]:
        """Printers for which jobs are being planned again, each with its job."""
        return {name: f"job {running.job}" for running in self._running.values() for name in running.printers}

    @property
    def next_change_s(self) -> float:
        """Time at which the next job stops waiting for its new plan; infinity if none waits."""
        return min(self._hold_ends_s.values(), default=math.inf)

    def list_holds(self, books: Books, now_s: float) -> dict[str, Hold]:
        """Return a hold for each plate whose job is being planned again, up to a time limit."""
        return {
            plate: Hold(
                code=HoldCode.BEING_REPLANNED,
                text=f"its job is being planned again for {join_names(running.printers)}, to finish sooner",
            )
            for running in self._running.values()
            if now_s < self._hold_ends_s[running.job]
            for plate in books.get_job(running.job).plates
        }

    def revise(
        self,
        books: Books,
        situation: Situation,
        assignments: Iterable[Assignment],
        find_reservations: Callable[[], Mapping[str, str]],
    ) -> Iterator[StartPlanning]:
        """Yield the instructions to plan jobs again.

        Parameters
        ----------
        books, situation
            The committed books; the plates that may be assigned now, and the fleet.
        assignments
            Assignments of the situation, see `assign_plates`.
        find_reservations
            Function that returns the free printers that are reserved, each with its purpose.
        """
        self.has_remaining_jobs, self.postponed_plates = False, frozenset()
        changeable_jobs = {job.id for job in books.jobs.values() if self._is_changeable(books, job)}
        plates_by_job = _find_unstarted_jobs(books, situation, changeable_jobs) if changeable_jobs else {}
        if not plates_by_job:
            return
        plate_by_printer = {assignment.printer: assignment.plate for assignment in assignments}
        starting_jobs = {books.plates[plate].job for plate in plate_by_printer.values()}
        candidates = _CandidatePrinters(situation, (*find_reservations().items(), *plate_by_printer.items()))
        assembly_ratio, forecast_size = compute_assembly_ratio(books.jobs.values()), 0
        for job_id in sorted(plates_by_job, key=lambda job_id: job_id not in starting_jobs):
            job, plates, can_start = books.get_job(job_id), plates_by_job[job_id], job_id in starting_jobs
            if self.is_running(job_id) or (not can_start and candidates.can_use_all(job, job.planned_for)):
                continue
            idle_printers, usable_printers = candidates.choose_printers(job, plates)
            # The idle printers change often, so they are ignored for a job that cannot start yet; it is
            # examined again once it can start.
            key = job_id, job.plan, frozenset(idle_printers if can_start else ()), frozenset(usable_printers)
            if key in self._examined_keys:
                continue
            end_s = _compute_immediate_end_s(plates, plate_by_printer, situation)
            planned_job = _describe_job(job, plates, situation, assembly_ratio, end_s)
            names = None
            if may_revise(planned_job, situation, (idle_printers, usable_printers)):
                if forecast_size > MAX_FORECAST_SIZE:
                    self._postpone_job(plates if can_start else ())
                    continue
                earlier_plates = situation.waiting_plates.limit_to_rank(plates[0].queue_rank)
                forecast_size += len(situation.printers) + len(earlier_plates)
                names = choose_revision(planned_job, situation, (idle_printers, usable_printers))
            self._examined_keys = {k for k in self._examined_keys if k[0] in changeable_jobs} | {key}
            if names is not None:
                yield self._start_planning(planned_job, names, situation.now_s)

    def _postpone_job(self, plates: Iterable[WaitingPlate]) -> None:
        """Leave a job for the next run; its plates that could start wait until then."""
        self.has_remaining_jobs = True
        self.postponed_plates |= {plate.id for plate in plates}

    def _start_planning(self, job: PlannedJob, names: tuple[str, ...], now_s: float) -> StartPlanning:
        """Start planning a job again for some printers; its plates are held for a limited time."""
        job_id = job.id
        log.info("job %d is planned again for %s", job_id, " ".join(names), extra={"job": job_id})
        self._running[job_id] = StartPlanning(job_id, names, round_count=1)
        self._start_times_s[job_id] = now_s
        self._hold_ends_s[job_id] = now_s + PLANNING_TIMEOUT_RATIO * job.planning_s
        return self._running[job_id]

    def _is_changeable(self, books: Books, job: Job) -> bool:
        if job.state is not JobState.PRINTING:
            return False
        version = books.find_job_version(job.id)
        known_version, is_changeable = self._change_checks.get(job.id, (None, False))
        if known_version is not version:
            is_changeable = _may_change(books, job)
            self._change_checks[job.id] = version, is_changeable
        return is_changeable

    def finish(
        self, job_id: int, result: Plan | FarmError, books: Books, situation: Situation
    ) -> ev.PlanRevised | None:
        """Return the event of a plan that replaces the earlier plan; None if the earlier plan is kept.

        Parameters
        ----------
        job_id
            The job.
        result
            The new plan, or the error that prevented it.
        books, situation
            The committed books; all waiting plates, and the fleet.
        """
        running = self._running[job_id]
        self.end_replanning(job_id)
        job = books.get_job(job_id)
        changeable_jobs = {job_id} if _may_change(books, job) else set()
        plates = _find_unstarted_jobs(books, situation, changeable_jobs).get(job_id)
        if plates is None:  # a person has cancelled or changed the job in the meantime
            return None
        if isinstance(result, FarmError):
            log.warning("job %d keeps its plan: %s", job_id, result, extra={"job": job_id})
            return None
        planned_event = build_planned_event(
            job, result, situation.printers, books, situation.rules, situation.now_s
        )
        planned_event = planned_event.model_copy(
            update={"printers": running.printers, "planning_s": situation.now_s - self._start_times_s[job_id]}
        )
        event = ev.PlanRevised(**dict(planned_event))
        if not _ends_sooner(event, books, situation):
            log.info("job %d keeps its plan: the new one does not end sooner", job_id, extra={"job": job_id})
            return None
        return event


def _find_unstarted_jobs(
    books: Books, situation: Situation, jobs: Collection[int]
) -> dict[int, tuple[WaitingPlate, ...]]:
    """Find the jobs whose plates may all be assigned, each with its plates."""
    return {
        entry.job: entry.plates
        for entry in situation.waiting_plates.jobs
        if entry.job in jobs and len(entry.plates) == len(books.get_job(entry.job).plates)
    }


def _may_change(books: Books, job: Job) -> bool:
    """Return whether a job's plan may change: no plate has started, and nobody has approved or changed it."""
    if job.state is not JobState.PRINTING or not job.planned_for or job.revisions >= MAX_REVISIONS:
        return False
    if job.own_gcode is not None or job.options.copies > 1:
        return False
    if job.options.hold or job.restored or job.paused:
        return False
    plates = list(books.list_plates(job))
    return not any(plate.prints or plate.paused for plate in plates) and all(
        books.find_plate_state(plate) is PlateState.WAITING for plate in plates
    )


class _CandidatePrinters:
    """Printers that jobs could use, found once for all jobs with the same requirements.

    Parameters
    ----------
    situation
        The plates that may be assigned now, and the fleet.
    purposes
        Printers that are taken, each with its plate or with the purpose of its reservation.
    """

    def __init__(self, situation: Situation, purposes: Sequence[tuple[str, str]]) -> None:
        self._situation, self._purposes = situation, purposes
        self._usable_printers: dict[Hashable, dict[str, FleetPrinter]] = {}

    def can_use_all(self, job: Job, names: Iterable[str]) -> bool:
        """Return whether a job could use each of the named printers, and none of them needs a repair."""
        return all(map(self._find_usable_printers(job).__contains__, names))

    def choose_printers(
        self, job: Job, plates: Iterable[WaitingPlate]
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return two choices of printers for a job: from the idle ones, and from all that need no repair.

        Printers that are reserved for `plates`, which belong to the job, count as idle.
        """
        # `JobRequest` subtracts the spare printers of the job.
        own_purposes = {plate.id for plate in plates} | {SPARE_PURPOSE}
        taken_printers = {name for name, purpose in self._purposes if purpose not in own_purposes}
        request = JobRequest(
            derive_job_requirements(job), job.options.printers, spare_count=job.options.spares
        )
        usable_printers = list(self._find_usable_printers(job).values())
        idle_printers = [
            p for p in usable_printers if p.find_obstacle() is None and p.name not in taken_printers
        ]
        return _select_largest_printers(idle_printers, request), _select_largest_printers(
            usable_printers, request
        )

    def _find_usable_printers(self, job: Job) -> dict[str, FleetPrinter]:
        """Find the printers that a job could use without a repair, by name."""
        requirements, printers = derive_job_requirements(job), self._situation.printers
        key = requirements, job.not_before_s, job.options.hold
        usable_printers = self._usable_printers.get(key)
        if usable_printers is None:
            matching_printers = [p for p in printers if requirements.matches(p.capabilities)]
            availability = limit_availability(Availability(printers), self._situation, job)
            usable_printers = {p.name: p for p in list_usable_printers(matching_printers, availability)}
            self._usable_printers[key] = usable_printers
        return usable_printers


def _select_largest_printers(printers: Sequence[FleetPrinter], request: JobRequest) -> tuple[str, ...]:
    largest = sorted(printers, key=lambda p: (-p.capabilities.height_mm, p.name))
    return tuple(sorted(p.name for p in largest[: request.limit_printer_count(len(printers))]))


def _compute_immediate_end_s(
    plates: Sequence[WaitingPlate], plate_by_printer: Mapping[str, str], situation: Situation
) -> float | None:
    """Return the expected end of plates that all start now; None if any of them does not start now."""
    printers = {plate: situation.fleet[name] for name, plate in plate_by_printer.items()}
    if not all(plate.id in printers for plate in plates):
        return None
    return situation.now_s + max(compute_printing_s(plate, printers[plate.id]) for plate in plates)


def _describe_job(
    job: Job,
    plates: tuple[WaitingPlate, ...],
    situation: Situation,
    assembly_ratio: float,
    end_s: float | None,
) -> PlannedJob:
    return PlannedJob(
        id=job.id,
        plates=plates,
        planned_for=job.planned_for,
        requirements=derive_job_requirements(job),
        planning_s=max(job.planning_s or 0.0, CUTTING_TIME_S * situation.time_scale),
        print_deadline_s=job.compute_print_deadline_s(assembly_ratio),
        end_s=end_s,
    )


def _ends_sooner(event: ev.PlanRevised, books: Books, situation: Situation) -> bool:
    """Return whether the plates of a new plan end before those of the current plan."""
    changed_books, _ = apply(event, books)
    job = changed_books.get_job(event.job)
    new_plates = tuple(describe_plates(changed_books.list_plates(job), changed_books))
    other_plates = tuple(plate for plate in situation.waiting_plates if plate.job != job.id)
    current_end_s = find_end_s(set(books.get_job(job.id).plates), situation)
    return (
        find_end_s(set(job.plates), situation.with_waiting_plates((*other_plates, *new_plates)))
        < current_end_s
    )
