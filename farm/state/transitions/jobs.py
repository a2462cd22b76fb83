"""Rules for events about a job. Pure."""

from __future__ import annotations

from farm.errors import ErrorCode
from farm.model import Gluing, Hold, HoldCode, Job, JobState
from farm.state import events as ev
from farm.state import restore
from farm.state.books import Books, put, replace_fields
from farm.state.consequences import Result, end_job, request_pause, update_job_state
from farm.state.lifecycles import JOB_LIFECYCLE, InvalidTransition
from farm.state.plate_state import PlateState
from farm.state.retention import find_keep_reason
from farm.state.transitions.rules import change


@change.register
def _(event: ev.JobSubmitted, books: Books) -> Result:
    return put(books, event.job), ()


@change.register
def _(event: ev.JobHeld, books: Books) -> Result:
    return put(books, replace_fields(books.get_job(event.job), hold=event.hold)), ()


@change.register
def _(event: ev.PlanningStarted, books: Books) -> Result:
    return put(books, replace_fields(books.get_job(event.job), state=JobState.PLANNING, hold=None)), ()


@change.register
def _(event: ev.PlanningAbandoned, books: Books) -> Result:
    return put(books, replace_fields(books.get_job(event.job), state=JobState.QUEUED, hold=event.hold)), ()


@change.register
def _(event: ev.JobPlanned, books: Books) -> Result:
    job = _apply_plan(books.get_job(event.job), event)
    hold = (restore.RESTORE_HOLD if job.restored else _make_approval_hold(job.id)) if event.held else None
    job = replace_fields(job, state=JobState.HELD if event.held else JobState.PRINTING, hold=hold)
    return put(books, job, *event.parts, *event.plates), (ev.LinkFiles(job=job.id),)


@change.register
def _(event: ev.PlanRevised, books: Books) -> Result:
    previous = books.get_job(event.job)
    plates = list(books.list_plates(previous))
    if any(books.find_plate_state(plate) is not PlateState.WAITING or plate.prints for plate in plates):
        raise InvalidTransition(
            event, JOB_LIFECYCLE, previous.id, previous.state, "one of its plates has started"
        )
    job = replace_fields(_apply_plan(previous, event), revisions=previous.revisions + 1)
    removed_plates = [plate for plate in plates if plate.id not in job.plates]
    replaced_plates = [replace_fields(plate, replaced_by=job.plates) for plate in removed_plates]
    return put(books, job, *replaced_plates, *event.parts, *event.plates), (ev.LinkFiles(job=job.id),)


def _apply_plan(job: Job, event: ev.JobPlanned) -> Job:
    """Return a job with the parts, plates, times and files of its plan."""
    return replace_fields(
        job,
        parts=tuple(part.id for part in event.parts),
        plates=tuple(plate.id for plate in event.plates),
        repairs=event.repairs,
        scale=event.scale,
        serial_s=event.serial_s,
        expected_s=event.expected_s,
        lower_bound_s=event.lower_bound_s,
        plan=event.plan,
        picture=event.picture,
        assembly=event.assembly,
        decomposition=event.decomposition,
        instructions=event.instructions,
        planned_s=event.at_s,
        planned_for=event.printers,
        planning_s=event.planning_s,
        assembly_s=event.assembly_s,
    )


def _make_approval_hold(job: int) -> Hold:
    text = f"held until `farm approve {job}`"
    return Hold(code=HoldCode.APPROVAL, text=text)


@change.register
def _(event: ev.JobApproved, books: Books) -> Result:
    job = books.get_job(event.job)
    options = job.options.model_copy(update={"dry_run": False})
    books = put(books, replace_fields(job, state=JobState.PRINTING, hold=None, options=options))
    return update_job_state(books, event.job, event.at_s), ()


@change.register
def _(event: ev.JobReleased, books: Books) -> Result:
    job = books.get_job(event.job)
    options = job.options.model_copy(update={"hold": event.hold, "dry_run": False})
    return put(books, replace_fields(job, options=options)), ()


@change.register
def _(event: ev.JobFailed, books: Books) -> Result:
    return end_job(books, event.job, JobState.FAILED, event.at_s, event.error, event.reason)


@change.register
def _(event: ev.JobCancelled, books: Books) -> Result:
    job = books.get_job(event.job)
    # A job may be planned again until its first plate is assigned.
    may_be_planning = job.state is JobState.PLANNING or not books.has_started(job.id)
    reason = f"cancelled by {event.by}"
    books, instructions = end_job(
        books, event.job, JobState.CANCELLED, event.at_s, ErrorCode.CANCELLED, reason
    )
    if may_be_planning:
        instructions = (ev.StopPlanning(job=event.job), *instructions)
    return books, instructions


@change.register
def _(event: ev.JobPruned, books: Books) -> Result:
    job = books.get_job(event.job)
    keep_reason = find_keep_reason(books, job)
    if keep_reason is not None:
        raise InvalidTransition(event, JOB_LIFECYCLE, job.id, job.state, keep_reason)
    job = replace_fields(job, pruned_s=event.at_s, part_pictures=event.part_pictures)
    return put(books, job), (ev.LinkFiles(job=job.id),)


@change.register
def _(event: ev.JobPaused, books: Books) -> Result:
    job = books.get_job(event.job)
    books = put(books, replace_fields(job, paused=event.wanted))
    if not event.wanted:
        books = put(books, *(replace_fields(plate, paused=False) for plate in books.list_plates(job)))
    # Prints with a cancel request are not paused.
    pauses = [
        request_pause(p, event.wanted) for p in books.list_open_prints(event.job) if p.cancel_reason is None
    ]
    return put(books, *(attempt for attempt, _ in pauses)), tuple(instruction for _, instruction in pauses)


@change.register
def _(event: ev.JobAssembled, books: Books) -> Result:
    gluing = Gluing(minutes=event.minutes, at_s=event.at_s, by=event.by)
    return put(books, replace_fields(books.get_job(event.job), gluing=gluing)), ()
