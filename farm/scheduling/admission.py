"""Admission of jobs to planning: for which printers each job is planned, and in which order. Pure.

A job is planned as soon as it is submitted, even while no printer is free, so that its time and filament are
known while its plates wait. Quick jobs never wait for others.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from farm.model import Hold, HoldCode, Job, JobState, Link
from farm.scheduling.assignment import Assignment, assign_plates
from farm.scheduling.holds import join_names
from farm.scheduling.matching import TEMPORARY_CODES, FleetPrinter, Requirements
from farm.scheduling.situation import Situation
from farm.scheduling.situation_builder import derive_job_requirements
from farm.state import Books

MAX_LONG_JOBS = 2
"""Maximum number of jobs that are planned at the same time, not counting quick jobs."""
MAX_QUICK_FACES = 200_000
"""Maximum number of triangles of a model that is planned in seconds, if it fits into one printer."""
SPARE_PURPOSE = "a failed part (--spares)"
"""Purpose of a spare printer, for messages."""
_BRIM_MM = 10.0  # width of the brim, only to estimate whether a model fits


@dataclass(frozen=True, slots=True)
class PrinterChoice:
    """Printers for which a job is planned, and the number of rounds; a printer prints one part per round."""

    printers: tuple[str, ...]
    round_count: int = 1


@dataclass(frozen=True, slots=True)
class JobRequest:
    """Request for printers by a job that has no plan yet.

    Attributes
    ----------
    requirements
        Requirements that each printer must meet.
    printer_count
        Number of printers that the user requested; None for all.
    min_parts
        Number of parts that the job needs according to an earlier attempt; 0 if unknown.
    spare_count
        Number of free printers to leave idle, as long as the job has at least one printer.
    starts_later
        True if the job waits for a start time or for approval. It is then planned for busy printers too,
        because nobody knows which printers will be free at its start.
    """

    requirements: Requirements
    printer_count: int | None = None
    min_parts: int = 0
    spare_count: int = 0
    starts_later: bool = False

    def limit_printer_count(self, available_count: int) -> int:
        """Return the number of the available printers that the job may use."""
        return min(max(1, available_count - self.spare_count), self.printer_count or available_count)


@dataclass(frozen=True, slots=True)
class PendingPlan:
    """Printers for which another job is being planned."""

    job: int
    priority: int
    printers: frozenset[str]


@dataclass(frozen=True, slots=True)
class Availability:
    """Availability of the printers to a job that is to be planned.

    Attributes
    ----------
    printers
        The fleet; at least one of its printers matches the job.
    reservations
        Free printers that are reserved, each with its purpose: a plate or a job.
    replan_printers
        Printers for which plates are being replanned: chosen only if there are no others.
    is_starting
        True just after the start of the farm, when jobs wait for printers that are still connecting.
    attended_only_printers
        Printers on which no print may start while nobody is present: chosen only if there are no others.
    """

    printers: tuple[FleetPrinter, ...]
    reservations: Mapping[str, str] = field(default_factory=dict)
    replan_printers: frozenset[str] = frozenset()
    is_starting: bool = False
    attended_only_printers: frozenset[str] = frozenset()

    def with_pending_plans(self, pending_plans: Iterable[PendingPlan]) -> Availability:
        """Return the availability if the printers of these plans are reserved too."""
        return replace(self, reservations={**list_pending_printers(pending_plans), **self.reservations})


def list_pending_printers(pending_plans: Iterable[PendingPlan]) -> dict[str, str]:
    """Return the printers of pending plans, each with its job."""
    return {
        name: f"job {pending_plan.job}"
        for pending_plan in pending_plans
        for name in sorted(pending_plan.printers)
    }


def find_mismatch(requirements: Requirements, printers: Iterable[FleetPrinter]) -> Hold | None:
    """Return a hold if no printer matches, because `fleet.yaml` may have changed since the submission."""
    if any(requirements.matches(printer.capabilities) for printer in printers):
        return None
    return Hold(
        code=HoldCode.NO_SUCH_PRINTER,
        text="no printer of the fleet matches this job: change fleet.yaml, or cancel it",
    )


def choose_printers(request: JobRequest, availability: Availability) -> PrinterChoice | Hold:
    """Choose the printers for which a job is planned.

    These are all matching idle printers with a clear bed. If there are none, or they cannot print the job in
    one round (one part each), printers that are busy or wait for a person are added. Absent or broken
    printers are used only if there are no others. If even all of these cannot print the job in one round, the
    idle printers print it in several rounds; see docs/adr/0004.
    """
    matching_printers = sorted(
        (p for p in availability.printers if request.requirements.matches(p.capabilities)),
        key=lambda p: p.name,
    )
    starting_printers = [
        p.name for p in matching_printers if p.link in (Link.STARTING, Link.CONNECTING) and not p.is_booked
    ]
    if starting_printers and availability.is_starting:
        return Hold(code=HoldCode.PRINTER_CONNECTING, text=f"connecting to {' '.join(starting_printers)}")
    usable_printers = list_usable_printers(matching_printers, availability)
    reserved_names = availability.replan_printers | availability.reservations.keys()
    idle = [p for p in usable_printers if p.find_obstacle() is None and p.name not in reserved_names]
    candidates = idle if idle and not request.starts_later else usable_printers
    count, min_parts = request.limit_printer_count(len(candidates)), request.min_parts
    if min_parts > count:
        max_parts = request.limit_printer_count(len(usable_printers))
        if min_parts > max_parts:
            return PrinterChoice(_choose_largest(candidates, count), round_count=-(-min_parts // count))
        candidates, count = usable_printers, max_parts
    return PrinterChoice(_choose_largest(candidates, count))


def _choose_largest(printers: Iterable[FleetPrinter], count: int) -> tuple[str, ...]:
    """Choose the tallest printers, so that two requested printers are the two largest; sort their names."""
    tallest_first = sorted(printers, key=lambda p: (-p.capabilities.height_mm, p.name))
    return tuple(sorted(p.name for p in tallest_first[:count]))


def list_usable_printers(
    matching_printers: list[FleetPrinter], availability: Availability
) -> list[FleetPrinter]:
    """List the matching printers that are free, or become free without a repair; all if there are none.

    Of these, `attended_only_printers` and `replan_printers` are listed only if there are no others.
    """
    usable_printers = [
        p for p in matching_printers if (hold := p.find_obstacle()) is None or hold.code in TEMPORARY_CODES
    ]
    attended_only = availability.attended_only_printers
    startable = [p for p in usable_printers if p.name not in attended_only] or usable_printers
    return (
        [p for p in startable if p.name not in availability.replan_printers] or startable or matching_printers
    )


def choose_unreserved_printers(
    request: JobRequest,
    availability: Availability,
    priority: int,
    pending_plans: Iterable[PendingPlan],
) -> PrinterChoice | Hold:
    """Choose the printers for which a job is planned, while other jobs are being planned.

    The printers of those jobs are not available to jobs of the same or a lower priority. They are available
    to a job of a higher priority only if no other matching printer is free.

    Parameters
    ----------
    request, availability
        See `choose_printers`.
    priority
        The job's priority.
    pending_plans
        The jobs that are being planned, with their printers.
    """
    plans = list(pending_plans)
    all_reserved = availability.with_pending_plans(plans)
    reserved_names = all_reserved.replan_printers | all_reserved.reservations.keys()
    free = (p for p in availability.printers if p.find_obstacle() is None and p.name not in reserved_names)
    if any(request.requirements.matches(p.capabilities) for p in free):
        return choose_printers(request, all_reserved)
    preferred_plans = (pending_plan for pending_plan in plans if pending_plan.priority >= priority)
    return choose_printers(request, availability.with_pending_plans(preferred_plans))


def is_quick(job: Job, printers: Iterable[FleetPrinter]) -> bool:
    """Return whether planning takes seconds: for own G-code, and small models that fit into one printer."""
    if job.own_gcode is not None:
        return True
    options, size = job.options, job.size
    deadline = options.done_by or options.assembled_by
    if size is None or size.faces > MAX_QUICK_FACES or deadline or options.printers not in (None, 1):
        return False
    x, y, z = size.extents_mm
    return any(
        width + 2 * _BRIM_MM <= right - left and depth + 2 * _BRIM_MM <= back - front and height <= top
        for printer in printers
        for left, front, right, back, top in printer.capabilities.build_boxes
        for width, depth, height in ((x, y, z), (y, z, x), (z, x, y))
    )


@dataclass(frozen=True, slots=True)
class StartPlanning:
    """Instruction to plan a job for some printers; see `PrinterChoice` and `is_quick`."""

    job: int
    printers: tuple[str, ...]
    round_count: int
    is_quick: bool = False


@dataclass(frozen=True, slots=True)
class HoldJob:
    """Decision that a job waits, with the reason."""

    job: int
    hold: Hold


class JobAdmission:
    """Admission of jobs to planning, with the printers of each job that is being planned.

    The state is in memory only: after a restart, jobs are planned again.
    """

    def __init__(self) -> None:
        self._min_parts: dict[int, int] = {}
        self._planned_printers: dict[int, frozenset[str]] = {}  # for each job that is being planned

    def set_min_parts(self, job: int, part_count: int) -> None:
        """Store the number of parts that a job needs, as found by an attempt to plan it."""
        self._min_parts[job] = part_count

    def begin_planning(self, decision: StartPlanning) -> None:
        """Record that a job is being planned, with its printers."""
        self._planned_printers[decision.job] = frozenset(decision.printers)

    def end_planning(self, job: int) -> None:
        """Record that the planning of a job has ended."""
        self._planned_printers.pop(job, None)

    def list_pending_plans(self, books: Books) -> list[PendingPlan]:
        """List the jobs that are being planned, with their printers."""
        return [
            PendingPlan(job_id, books.get_job(job_id).priority, names)
            for job_id, names in self._planned_printers.items()
        ]

    def decide(
        self, books: Books, situation: Situation, availability: Availability
    ) -> Iterator[StartPlanning | HoldJob]:
        """Yield a decision on each queued job: start its planning, or hold it for a reason.

        Parameters
        ----------
        books
            The committed books, with the plates that have just been assigned.
        situation
            The fleet after this assignment, the rules and the spares.
        availability
            Availability of the fleet to all jobs, with the reserved printers.
        """
        pending_plans = self.list_pending_plans(books)
        long_jobs: list[int] = []
        for job in books.list_unplanned_jobs():
            quick = is_quick(job, situation.printers)
            if job.state is JobState.PLANNING:
                long_jobs += [] if quick else [job.id]
                continue
            decision: PrinterChoice | Hold | None = find_mismatch(
                derive_job_requirements(job), situation.printers
            )
            if decision is None and not quick and len(long_jobs) >= MAX_LONG_JOBS:
                first = join_names(f"job {job_id}" for job_id in long_jobs)
                decision = Hold(code=HoldCode.NOT_FIRST, text=f"{first} are planned first")
            if decision is None:
                limited = limit_availability(availability, situation, job)
                request, priority = self._make_request(job, situation.now_s), job.priority
                decision = choose_unreserved_printers(request, limited, priority, pending_plans)
            if isinstance(decision, Hold):
                yield HoldJob(job.id, decision)
                continue
            pending_plans.append(PendingPlan(job.id, job.priority, frozenset(decision.printers)))
            long_jobs += [] if quick else [job.id]
            yield StartPlanning(job.id, decision.printers, decision.round_count, quick)

    def _make_request(self, job: Job, now_s: float) -> JobRequest:
        return JobRequest(
            requirements=derive_job_requirements(job),
            printer_count=job.options.printers if job.own_gcode is None else None,  # planning chooses one
            min_parts=self._min_parts.get(job.id, 0),
            spare_count=job.options.spares,
            starts_later=job.options.hold or (job.not_before_s or 0.0) > now_s,
        )


def list_reservations(situation: Situation, replan_printers: Mapping[str, str]) -> dict[str, str]:
    """Return the printers that are reserved and thus unavailable to a new job, each with its purpose.

    No printer is reserved for a plate that may not start now, because that plate may wait for a long time.

    Parameters
    ----------
    situation
        The plates that still wait, and the fleet after the current assignment.
    replan_printers
        Printers for which plates are being replanned, each with the plate.
    """
    assignments: Iterable[Assignment] = ()
    if situation.rules.max_heating is not None:
        # A plate that waits only because of the heating limit reserves its printer.
        assignments = assign_plates(replace(situation, rules=replace(situation.rules, max_heating=None)))
    return {
        **dict.fromkeys(situation.spare_printers, SPARE_PURPOSE),
        **{assignment.printer: assignment.plate for assignment in assignments},
        **replan_printers,
    }


def limit_availability(availability: Availability, situation: Situation, job: Job) -> Availability:
    """Return the availability at a job's start; if nobody is present then, set `attended_only_printers`."""
    start_s = max(situation.now_s, job.not_before_s or 0.0)
    is_attended = job.options.hold or situation.rules.is_attended(start_s)
    attended_only_printers = frozenset(
        p.name for p in situation.printers if not (p.may_print_unattended or is_attended)
    )
    return replace(availability, attended_only_printers=attended_only_printers)
