"""State of planning: the jobs that are being planned, their progress, and the events for finished plans."""

from __future__ import annotations

from collections.abc import Iterator

from farm.errors import FarmError
from farm.model import Hold, Job, JobState, PlanProgress, PlanStep
from farm.planning import Plan, TooFewPrinters, build_planned_event
from farm.planning.replanning import PlanRevisions
from farm.scheduling import (
    Availability,
    HoldJob,
    JobAdmission,
    Situation,
    StartPlanning,
    list_pending_printers,
    list_reservations,
)
from farm.state import Books
from farm.state import events as ev


class JobPlanning:
    """Jobs that are being planned, for the first time or again; kept in memory only.

    Attributes
    ----------
    progress
        Progress of the unfinished plans, by job.
    holds
        Reason why the planning of a job has not started, by job.
    revisions
        Jobs that are being planned again.
    """

    def __init__(self) -> None:
        self.progress: dict[int, PlanProgress] = {}
        self.holds: dict[int, Hold] = {}
        self.revisions = PlanRevisions()
        self._admission = JobAdmission()
        # The latest instruction to plan each job, and the farm time at which the planning began.
        self._started_plans: dict[int, tuple[StartPlanning, float]] = {}

    def on_progress(self, job_id: int, progress: PlanProgress) -> None:
        """Store the progress of a plan; if the disk is full, stop planning a job that already has a plan."""
        self.progress[job_id] = progress
        if progress.step is PlanStep.NO_ROOM:
            self.revisions.end_replanning(job_id)

    def find_reservations(
        self, books: Books, situation: Situation, reserved_printers: dict[str, str]
    ) -> dict[str, str]:
        """Return the free printers that are reserved, each with its purpose: a plate, a job or a spare.

        Parameters
        ----------
        situation
            Situation after the current assignment: the plates that still wait, and the fleet.
        reserved_printers
            Printers for which plates are being replanned, each with the id of its plate.
        """
        pending_printers = list_pending_printers(self._admission.list_pending_plans(books))
        revised_printers = self.revisions.reserved_printers
        return {**pending_printers, **revised_printers, **list_reservations(situation, reserved_printers)}

    def admit(
        self, books: Books, situation: Situation, reserved_printers: dict[str, str], is_starting: bool
    ) -> Iterator[tuple[ev.AnyEvent, StartPlanning | None]]:
        """Yield the events about queued jobs, each with the instruction to perform after its commit, or None.

        See `find_reservations` and `farm.scheduling.JobAdmission.decide` for the parameters.
        """
        availability = Availability(
            situation.printers,
            reservations={
                **self.revisions.reserved_printers,
                **list_reservations(situation, reserved_printers),
            },
            replan_printers=frozenset(reserved_printers),
            is_starting=is_starting,
        )
        decisions = list(self._admission.decide(books, situation, availability))
        self.holds = {entry.job: entry.hold for entry in decisions if isinstance(entry, HoldJob)}
        now_s = situation.now_s
        for decision in decisions:
            if isinstance(decision, StartPlanning):
                yield ev.PlanningStarted(at_s=now_s, job=decision.job), decision
            elif not decision.hold.has_same_reason(books.get_job(decision.job).hold):
                yield ev.JobHeld(at_s=now_s, job=decision.job, hold=decision.hold), None

    def begin(self, instruction: StartPlanning, now_s: float) -> None:
        """Record that the planning of a job has begun."""
        self._admission.begin_planning(instruction)
        self._started_plans[instruction.job] = instruction, now_s

    def end(self, job_id: int) -> None:
        """Remove a job that is no longer being planned."""
        self.progress.pop(job_id, None)
        self._admission.end_planning(job_id)
        self.revisions.end_replanning(job_id)

    def finish(
        self, job: Job, result: Plan | FarmError, books: Books, situation: Situation
    ) -> ev.AnyEvent | None:
        """Return the event for a finished plan, or for the error that prevented it; None if nothing changes.

        Parameters
        ----------
        books, situation
            The committed books, and the situation with all waiting plates.
        """
        event: ev.AnyEvent | None = None
        if self.revisions.is_running(job.id):
            event = self.revisions.finish(job.id, result, books, situation)
        elif job.state is JobState.PLANNING:  # otherwise it was cancelled in the meantime
            event = self._finish_first_plan(job, result, books, situation)
        self.end(job.id)
        return event

    def _finish_first_plan(
        self, job: Job, result: Plan | FarmError, books: Books, situation: Situation
    ) -> ev.AnyEvent:
        now_s = situation.now_s
        if isinstance(result, TooFewPrinters):
            self._admission.set_min_parts(job.id, result.needed_count)
            return ev.PlanningAbandoned(at_s=now_s, job=job.id, hold=None)
        if isinstance(result, FarmError):
            return ev.JobFailed(at_s=now_s, job=job.id, error=result.code, reason=str(result))
        event = build_planned_event(job, result, situation.printers, books, situation.rules, now_s)
        instruction, start_s = self._started_plans.get(job.id, (None, now_s))
        printers = () if instruction is None else instruction.printers
        changes = {"printers": printers, "planning_s": now_s - start_s}
        return event.model_copy(update=changes)

    def list_jobs_in_planning(self, books: Books) -> list[int]:
        """List the ids of the jobs that are being planned, except those that wait for free disk space."""
        planning_jobs = (job.id for job in books.jobs.values() if job.state is JobState.PLANNING)
        return sorted(job_id for job_id in planning_jobs if not self._waits_for_disk_space(job_id))

    def _waits_for_disk_space(self, job_id: int) -> bool:
        progress = self.progress.get(job_id)
        return progress is not None and progress.step is PlanStep.NO_ROOM
