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
from farm.views.jobs.times import measure_assembly, measure_times

__all__ = [
    "count_waiting_plates",
    "describe_job",
    "describe_jobs",
    "describe_print",
    "describe_queue",
    "describe_timeline",
    "group_waits",
    "list_queue",
    "measure_assembly",
    "measure_times",
    "summarise_jobs",
]
