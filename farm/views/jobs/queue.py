"""View of the queue: the open jobs with plates left to start, in the order of scheduling. Pure."""

from __future__ import annotations

from farm import api
from farm.model import Job, JobState
from farm.state import Books, PlateState
from farm.views.context import ViewContext
from farm.views.jobs.times import compute_job_times


def list_queue(books: Books) -> list[Job]:
    """List the open jobs with plates left to start, in the order of scheduling."""
    return [
        job
        for job in books.list_open_jobs()
        if job.state is not JobState.PRINTING or count_waiting_plates(books, job)
    ]


def count_waiting_plates(books: Books, job: Job) -> int:
    """Count the plates of a job that have not started."""
    return sum(books.find_plate_state(plate) is PlateState.WAITING for plate in books.list_plates(job))


def describe_queue(context: ViewContext) -> api.Queue:
    """Describe the queue, with the expected end of each job."""
    return api.Queue(
        now=context.format_time(context.now_s) or "",
        jobs=[
            api.QueueEntry(
                id=job.id,
                name=job.name,
                state=job.state,
                waiting=count_waiting_plates(context.books, job),
                eta=context.format_time(compute_job_times(context, job).end_s),
                submitted_by=job.submitted_by,
            )
            for job in list_queue(context.books)
        ],
    )
