"""Views of jobs: their state and times, the queue, and the timeline of a job. Pure."""

from __future__ import annotations

from farm.views.jobs.description import (
    describe_job,
    describe_jobs,
    describe_print,
    group_waits,
    summarise_jobs,
)
from farm.views.jobs.queue import count_waiting_plates, describe_queue, list_queue
from farm.views.jobs.timeline import describe_timeline
from farm.views.jobs.times import compute_assembly_times, compute_job_times

__all__ = [
    "compute_assembly_times",
    "compute_job_times",
    "count_waiting_plates",
    "describe_job",
    "describe_jobs",
    "describe_print",
    "describe_queue",
    "describe_timeline",
    "group_waits",
    "list_queue",
    "summarise_jobs",
]
