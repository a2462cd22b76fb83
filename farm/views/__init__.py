"""Views of the state for people: descriptions of jobs, printers, tasks, history and notices. Pure.

`farm.views.report`, the report of a job, is imported separately, because its templates are slow to load.
"""

from __future__ import annotations

from farm.views.accounting import compute_duration_s
from farm.views.context import ViewContext
from farm.views.events import describe_event
from farm.views.history import describe_night, list_history, list_jobs, list_prints, select_shown_jobs
from farm.views.job_cache import JobCache
from farm.views.jobs import describe_job, describe_jobs, describe_timeline, group_waits, summarise_jobs
from farm.views.notices import Notice, list_due_notices
from farm.views.printers import describe_printer, list_speeds
from farm.views.tasks import list_tasks

__all__ = [
    "JobCache",
    "Notice",
    "ViewContext",
    "compute_duration_s",
    "describe_event",
    "describe_job",
    "describe_jobs",
    "describe_night",
    "describe_printer",
    "describe_timeline",
    "group_waits",
    "list_due_notices",
    "list_history",
    "list_jobs",
    "list_prints",
    "list_speeds",
    "list_tasks",
    "select_shown_jobs",
    "summarise_jobs",
]
