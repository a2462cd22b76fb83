"""Commands on jobs: submit, approve, pause, cancel; and the cancellation of abandoned dry runs."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from farm import api
from farm.control.controller import Controller
from farm.control.printer_commands import PrinterCommands
from farm.errors import ErrorCode, FarmError, RefusedError
from farm.model import Job, JobOptions, JobState
from farm.paths import StateFolder
from farm.planning import InspectedSubmission
from farm.scheduling import StartRules, parse_moment_s
from farm.state import events as ev
from farm.state.storage import compute_sha256
from farm.text import format_count
from farm.views.jobs import list_queue

DRY_RUN_TIMEOUT_S = 60.0
"""Real seconds without a client's request after which a dry run is cancelled; longer than a restart takes."""
PAGE_DRY_RUN_TIMEOUT_S = 3600.0
"""Real seconds for which a dry run is kept after a page has shown its plan."""
_CANCELLER = "the farm: nobody is waiting for its plan any more"


class JobCommands:
    """Commands that people give for jobs; each is checked, then handled as an event.

    Every method raises NotFoundError for an unknown name, and RefusedError for a command that is not allowed.
    """

    def __init__(self, controller: Controller, printers: PrinterCommands) -> None:
        self._controller, self._printers = controller, printers

    def find_submission(self, request_id: str) -> int | None:
        """Return the id of the job that a request with this id has submitted; None if there is none."""
        jobs = self._controller.books.jobs.values()
        return next((job.id for job in jobs if job.request_id == request_id), None)

    def check_submission(self, options: JobOptions) -> None:
        """Check a submission before its model is uploaded.

        Raises
        ------
        RefusedError
            If the farm is shutting down.
        FarmError
            If the start time or the deadline cannot be read, or is not in the future.
        """
        parse_start_and_deadline_s(options, self._controller.rules, self._controller.clock.now())
        if self._controller.is_stopping:
            raise RefusedError("the farm is shutting down: submit again after `farm up`")

    def list_unusable_options(self, options: JobOptions) -> list[str]:
        """Describe the options of a submission that require more printers than the fleet has."""
        printer_count = len(self._controller.fleet.printers)
        fleet = f"the fleet has {format_count(printer_count, 'printer')}"
        problems = []
        if options.printers is not None and options.printers > printer_count:
            problems.append(f"--printers {options.printers}: {fleet}, so the job cannot use more")
        if options.spares >= printer_count:
            problems.append(f"--spares {options.spares}: {fleet}, and at least one has to print the job")
        return problems

    def submit(
        self,
        request_id: str,
        name: str,
        model: InspectedSubmission,
        options: JobOptions,
        caller_name: str | None = None,
    ) -> tuple[int, bool]:
        """Submit a job; return its id, and True if the same request has already submitted it before."""
        existing_job = self.find_submission(request_id)
        if existing_job is not None:
            return existing_job, True
        controller = self._controller
        job_id, now_s = max(controller.books.jobs, default=0) + 1, controller.clock.now()
        not_before_s, deadline_s = parse_start_and_deadline_s(options, controller.rules, now_s)
        if controller.fleet.fleet.approve:
            options = options.model_copy(update={"hold": True})
        job = Job(
            id=job_id,
            request_id=request_id,
            name=options.name or name,
            model_file=model.file,
            options=options,
            own_gcode=model.own_gcode,
            size=model.size,
            repairs=model.repairs,
            scale=model.scale,
            not_before_s=not_before_s,
            done_by_s=deadline_s if options.assembled_by is None else None,
            assembled_by_s=None if options.assembled_by is None else deadline_s,
            submitted_s=now_s,
            submitted_by=caller_name,
        )
        controller.handle(ev.JobSubmitted(at_s=now_s, job=job))
        return job_id, False

    def cancel(self, job_id: int, caller_name: str) -> None:
        """Cancel a job, so that no more of its parts are printed."""
        job = self._controller.books.get_job(job_id)
        if job.state.ended:
            is_printable = job.parts and job.pruned_s is None
            hint = f"; `farm reprint {job_id} PART` prints a part again" if is_printable else ""
            raise RefusedError(f"job {job_id} has already ended: it is {job.state}{hint}")
        self._controller.handle(
            ev.JobCancelled(at_s=self._controller.clock.now(), job=job_id, by=caller_name)
        )

    def set_paused(self, job_id: int, is_paused: bool, caller_name: str) -> None:
        """Pause a job (its prints pause, and none of its plates start), or resume it."""
        books = self._controller.books
        job = books.get_job(job_id)
        if job.state.ended:
            raise RefusedError(f"job {job_id} has already ended: it is {job.state}")
        has_paused_parts = not is_paused and any(plate.paused for plate in books.list_plates(job))
        if job.paused is is_paused and not has_paused_parts:
            raise RefusedError(f"job {job_id} is {'already paused' if is_paused else 'not paused'}")
        if not is_paused:
            printers = (p.printer for p in books.list_open_prints(job_id) if p.pause_requested)
            self._printers.refuse_unattended_printers(sorted(printers))
        at_s = self._controller.clock.now()
        self._controller.handle(ev.JobPaused(at_s=at_s, job=job_id, wanted=is_paused, by=caller_name))

    def record_assembly(self, job_id: int, minutes: float, caller_name: str) -> None:
        """Record the minutes that a person took to glue the parts of a job, in place of an earlier report."""
        job = self._controller.books.get_job(job_id)
        if job.state not in (JobState.PRINTED, JobState.DONE):
            raise RefusedError(f"job {job_id} is {job.state}: report its assembly once all parts are printed")
        if len(job.parts) < 2:
            raise RefusedError(f"job {job_id} has one part: there is nothing to glue")
        at_s = self._controller.clock.now()
        self._controller.handle(ev.JobAssembled(at_s=at_s, job=job_id, minutes=minutes, by=caller_name))

    def move(self, job_id: int, move: api.QueueMove, caller_name: str) -> None:
        """Move a job in the queue: up, down, to the front, to the end, or before another job."""
        successor = find_successor(self._list_queue(job_id), job_id, move)
        at_s = self._controller.clock.now()
        self._controller.handle(ev.JobMoved(at_s=at_s, job=job_id, before=successor, by=caller_name))

    def reschedule(self, job_id: int, at: str, caller_name: str) -> None:
        """Set the time `at` before which no plates of a job start; "now" removes this limit.

        Raises
        ------
        RefusedError
            If the job has ended, or none of its plates is waiting.
        FarmError
            If the time cannot be read, or is not in the future.
        """
        self._list_queue(job_id)
        now_s, not_before_s = self._controller.clock.now(), None
        if at.strip().lower() != "now":
            try:
                not_before_s = parse_moment_s(at, now_s, self._controller.fleet.zone)
            except ValueError as error:
                raise FarmError(str(error), ErrorCode.SETTINGS) from error
        self._controller.handle(
            ev.JobRescheduled(at_s=now_s, job=job_id, not_before_s=not_before_s, by=caller_name)
        )

    def _list_queue(self, job_id: int) -> list[int]:
        """Return the ids of the jobs in the queue, in order. Raises RefusedError if it lacks this job."""
        books = self._controller.books
        if books.get_job(job_id).state.ended:
            raise RefusedError(f"job {job_id} has already ended: it is {books.get_job(job_id).state}")
        queue = [job.id for job in list_queue(books)]
        if job_id not in queue:
            raise RefusedError(f"no plate of job {job_id} is waiting: all of them have started")
        return queue

    async def approve(self, job_id: int, plan: str, state: StateFolder, caller_name: str) -> None:
        """Let a held job print, if its plan and files are still those that a person has reviewed.

        Parameters
        ----------
        job_id
            The job.
        plan
            Hash of the reviewed plan; empty if an earlier version of the farm made the plan.
        state
            State folder, with the files.
        caller_name
            Name of the person who approves the job.
        """
        job = self._find_held_job(job_id)
        if plan != (job.plan or ""):
            raise RefusedError(f"the plan of job {job_id} is {job.plan}, not {plan}: check it again")
        for plate in list(self._controller.books.list_plates(job)):
            path = state.files / plate.gcode
            if not path.is_file() or await asyncio.to_thread(compute_sha256, path) != plate.sha256:
                raise RefusedError(
                    f"{plate.name} has changed since it was planned: {path}; submit the model again"
                )
        self._find_held_job(job_id)  # the job may have been cancelled in the meantime
        self._controller.handle(ev.JobApproved(at_s=self._controller.clock.now(), job=job_id, by=caller_name))

    def keep_dry_run(self, job_id: int, caller_name: str) -> None:
        """Convert a dry run to a job that is held until its plan is approved."""
        job = self._controller.books.get_job(job_id)
        if not job.options.dry_run or job.state.ended:
            raise RefusedError(f"job {job_id} is not a dry run that can be kept: it is {job.state}")
        at_s = self._controller.clock.now()
        self._controller.handle(ev.JobReleased(at_s=at_s, job=job_id, by=caller_name, hold=True))

    def resubmit(self, job_id: int, request_id: str, options: JobOptions, caller_name: str) -> int:
        """Submit the model of a job again with other options; return the id of the new job."""
        job = self._controller.books.get_job(job_id)
        if job.pruned_s is not None:
            raise RefusedError(f"the files of job {job_id} were pruned: submit {job.name} again")
        self.check_submission(options)
        model = InspectedSubmission(job.model_file, job.repairs, job.scale or 1.0, job.own_gcode, job.size)
        return self.submit(request_id, job.name, model, options, caller_name)[0]

    async def release(self, job_id: int, state: StateFolder, caller_name: str, is_operator: bool) -> None:
        """End the hold of a job, even before it is planned; a job that is already printing does not change.

        Parameters
        ----------
        job_id
            The job.
        state
            State folder, with the files.
        caller_name
            Name of the person who releases the job.
        is_operator
            True if the person is an operator. Others may release only their own jobs, and only on a farm
            where jobs need no approval.
        """
        job = self._controller.books.get_job(job_id)
        if job.state.ended:
            raise RefusedError(f"job {job_id} has already ended: it is {job.state}")
        if not is_operator and (self._needs_operator(job) or job.submitted_by != caller_name):
            raise RefusedError(f"only an operator may let job {job_id} print: `farm approve {job_id}`")
        if job.state is JobState.HELD:
            await self.approve(job_id, job.plan or "", state, caller_name)
        elif job.options.hold and job.state in (JobState.QUEUED, JobState.PLANNING):
            self._controller.handle(
                ev.JobReleased(at_s=self._controller.clock.now(), job=job_id, by=caller_name)
            )

    def _needs_operator(self, job: Job) -> bool:
        return self._controller.fleet.fleet.approve or job.restored

    def _find_held_job(self, job_id: int) -> Job:
        job = self._controller.books.get_job(job_id)
        if job.state is not JobState.HELD:
            raise RefusedError(f"job {job_id} is not waiting for approval: it is {job.state}")
        return job


def find_successor(queue: Sequence[int], job_id: int, move: api.QueueMove) -> int | None:
    """Return the id of the job before which a job is put; None for the end of the queue.

    Parameters
    ----------
    queue
        Ids of the jobs in the queue, in order.
    job_id
        The job that is moved; `queue` contains it.
    move
        New place: a direction, an end of the queue, or another job, before which this job is put.

    Raises
    ------
    RefusedError
        If the job is already at that end of the queue, or the other job is not in the queue.
    """
    index = queue.index(job_id)
    other_jobs = [entry for entry in queue if entry != job_id]
    if move.before is not None:
        if move.before not in other_jobs:
            raise RefusedError(
                f"job {job_id} can be moved only before another job in the queue, not before job "
                f"{move.before}: `farm queue` lists the jobs"
            )
        return move.before
    new_indices = {
        api.QueuePlace.UP: index - 1,
        api.QueuePlace.DOWN: index + 1,
        api.QueuePlace.FIRST: 0 if index else -1,
        api.QueuePlace.LAST: len(other_jobs) if index < len(other_jobs) else len(queue),
    }
    target = new_indices[move.to or api.QueuePlace.LAST]
    if not 0 <= target <= len(other_jobs):
        raise RefusedError(f"job {job_id} is already {'first' if index == 0 else 'last'} in the queue")
    return other_jobs[target] if target < len(other_jobs) else None


def abort_prints(controller: Controller) -> None:
    """Cancel every open print and its job; if the job has ended, cancel only the plate of the print."""
    books, now_s = controller.books, controller.clock.now()
    job_ids = sorted({attempt.job for attempt in books.list_open_prints()})
    open_job_ids = [job_id for job_id in job_ids if not books.get_job(job_id).state.ended]
    controller.handle(*(ev.JobCancelled(at_s=now_s, job=job_id) for job_id in open_job_ids))
    plates_of_ended_jobs = [
        attempt.plate for attempt in controller.books.list_open_prints() if attempt.cancel_reason is None
    ]
    controller.handle(
        *(ev.PlateCancelled(at_s=now_s, plate=plate, by=ev.UNKNOWN_CALLER) for plate in plates_of_ended_jobs)
    )


def parse_start_and_deadline_s(
    options: JobOptions, rules: StartRules, now_s: float
) -> tuple[float | None, float | None]:
    """Parse the start time and the deadline of a job; None for each missing option.

    Raises
    ------
    FarmError
        If one of the times cannot be read or is not in the future, or there are two deadlines.
    """
    if options.done_by is not None and options.assembled_by is not None:
        raise FarmError("give --done-by or --assembled-by, not both", ErrorCode.SETTINGS)
    try:
        if options.at is not None:
            start_s: float | None = parse_moment_s(options.at, now_s, rules.zone)
        else:
            start_s = rules.find_night_start_s(now_s) if options.overnight else None
        deadline = options.done_by or options.assembled_by
        return start_s, None if deadline is None else parse_moment_s(deadline, start_s or now_s, rules.zone)
    except ValueError as error:
        raise FarmError(str(error), ErrorCode.SETTINGS) from error


class DryRuns:
    """Cancellation of dry runs whose clients are gone. Times are from a monotonic clock, in seconds."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._expiry_times_s: dict[int, float] = {}

    def keep(self, job_id: int, now_s: float, timeout_s: float = DRY_RUN_TIMEOUT_S) -> None:
        """Keep a dry run for at least `timeout_s` after a client's request about it."""
        self._expiry_times_s[job_id] = max(now_s + timeout_s, self._expiry_times_s.get(job_id, 0.0))

    def cancel_abandoned_runs(self, now_s: float) -> None:
        """Cancel the dry runs about which no client has sent a recent request."""
        jobs = self._controller.books.jobs.values()
        dry_run_ids = [job.id for job in jobs if job.options.dry_run and not job.state.ended]
        default_s = now_s + DRY_RUN_TIMEOUT_S
        self._expiry_times_s = {job_id: self._expiry_times_s.get(job_id, default_s) for job_id in dry_run_ids}
        abandoned_ids = [job_id for job_id, expiry_s in self._expiry_times_s.items() if now_s > expiry_s]
        if abandoned_ids:
            at_s = self._controller.clock.now()
            self._controller.handle(
                *(ev.JobCancelled(at_s=at_s, job=job_id, by=_CANCELLER) for job_id in abandoned_ids)
            )
