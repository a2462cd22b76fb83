"""Rules for events that move a job in the queue, or change its start time. Pure.

A moved job takes the priority of the job that follows it, or, at the end of the queue, of the job before it.
Its new rank is between the ranks of its neighbours. The rank of a job that was never moved is its id, so that
it follows all earlier jobs of its priority.
"""

from __future__ import annotations

from collections.abc import Iterator

from farm.model import Job
from farm.state import events as ev
from farm.state.books import Books, put, replace_fields
from farm.state.consequences import Result
from farm.state.lifecycles import JOB_LIFECYCLE, InvalidTransition
from farm.state.transitions.rules import change


@change.register
def _(event: ev.JobMoved, books: Books) -> Result:
    other_jobs = [job for job in books.list_open_jobs() if job.id != event.job]
    job_ids = [job.id for job in other_jobs]
    if event.before is not None and event.before not in job_ids:
        target = books.get_job(event.before)
        raise InvalidTransition(event, JOB_LIFECYCLE, target.id, target.state, "not in the queue")
    index = len(other_jobs) if event.before is None else job_ids.index(event.before)
    return put(books, *_place_job(books.get_job(event.job), other_jobs, index, max(books.jobs))), ()


@change.register
def _(event: ev.JobRescheduled, books: Books) -> Result:
    return put(books, replace_fields(books.get_job(event.job), not_before_s=event.not_before_s)), ()


def _place_job(job: Job, other_jobs: list[Job], index: int, last_id: int) -> Iterator[Job]:
    """Yield a job with its new rank; if its neighbours leave no rank free, yield all jobs with new ranks.

    Parameters
    ----------
    other_jobs
        The other open jobs, in the order of the queue.
    index
        Index in `other_jobs` before which the job is put.
    last_id
        Largest id of all jobs, and thus the largest rank of a job that was never moved.
    """
    jobs_before, jobs_after = other_jobs[:index], other_jobs[index:]
    if not other_jobs:
        return
    priority = (jobs_after[0] if jobs_after else jobs_before[-1]).priority
    high = jobs_after[0].queue_rank[1] if jobs_after else last_id + 1.0
    low = (
        jobs_before[-1].queue_rank[1] if jobs_before and jobs_before[-1].priority == priority else high - 2.0
    )
    rank = (low + high) / 2.0
    job = replace_fields(job, moved_priority=priority, moved_rank=rank)
    if low < rank < high:
        yield job
        return
    order = [*jobs_before, job, *jobs_after]
    for i, moved_job in enumerate(order):
        yield replace_fields(moved_job, moved_rank=last_id - len(order) + 1.0 + i)
