"""Views of the past: last night, ended jobs, ended prints. Pure."""

from __future__ import annotations

from farm import api
from farm.model import Job, JobState, Print, PrintState
from farm.state import Books
from farm.views.accounting import (
    compute_duration_s,
    compute_job_totals,
    compute_night_totals,
    is_wasted,
)
from farm.views.context import ViewContext
from farm.views.jobs import describe_print

MAX_ENDED_JOBS = 10
"""Number of ended jobs on the status page; `farm history` lists the prints of all jobs."""


def select_shown_jobs(books: Books) -> list[Job]:
    """Select the jobs of the status page, in order of submission: all open jobs, and the last ended ones.

    A printed job counts as open until all its parts have a verdict. Dry runs that have ended are left out.
    """
    open_jobs: list[Job] = []
    ended_jobs: list[Job] = []
    for job in books.jobs.values():
        if job.options.dry_run and job.state.ended:
            continue
        (ended_jobs if job.state.ended and job.state is not JobState.PRINTED else open_jobs).append(job)
    return sorted(
        [*open_jobs, *sorted(ended_jobs, key=lambda job: job.id)[-MAX_ENDED_JOBS:]], key=lambda job: job.id
    )


def describe_night(context: ViewContext) -> api.NightView | None:
    """Describe the prints of last night; return None if no print ended then."""
    night = compute_night_totals(context.books, context.books.prints.values(), context.now_s)
    if night is None:
        return None
    return api.NightView(
        since=context.format_time(night.since_s) or "",
        plates=night.plate_count,
        printed=night.printed_count,
        failed=night.failed_count,
        printing=night.printing_count,
        waiting=night.waiting_count,
        grams=night.grams,
        wasted_grams=night.wasted_grams,
    )


def list_history(
    context: ViewContext, job: int | None = None, printer: str | None = None, max_count: int = 100
) -> list[api.HistoryRow]:
    """List the prints that ended last, oldest first: of all jobs and printers, or of the given ones."""
    ended_prints = [
        attempt
        for attempt in context.books.prints.values()
        if attempt.state.ended and job in (None, attempt.job) and printer in (None, attempt.printer)
    ]
    ended_prints.sort(key=lambda attempt: (attempt.ended_s or 0.0, attempt.id))
    return [make_history_row(context, attempt) for attempt in ended_prints[-max_count:]]


def list_prints(
    context: ViewContext, job: int | None, printer: str | None, state: PrintState | None, max_count: int
) -> list[api.PrintRow]:
    """List the prints that were assigned last, including open prints, oldest first."""
    prints = [
        attempt
        for attempt in context.books.prints.values()
        if job in (None, attempt.job)
        and printer in (None, attempt.printer)
        and state in (None, attempt.shown_state)
    ]
    prints.sort(key=lambda attempt: (attempt.assigned_s, attempt.number))
    return [_make_print_row(context, attempt) for attempt in prints[-max_count:]]


def _make_print_row(context: ViewContext, attempt: Print) -> api.PrintRow:
    row = api.PrintRow(**dict(make_history_row(context, attempt)), id=attempt.id, plate=attempt.plate)
    if not attempt.state.ended and attempt.started_s is not None:
        row.took_s = max(0.0, context.now_s - attempt.started_s)
    return row


def list_jobs(context: ViewContext, state: JobState | None, max_count: int) -> list[api.JobRow]:
    """List the jobs that were submitted last, oldest first."""
    jobs = [job for job in context.books.jobs.values() if state in (None, job.state)]
    jobs.sort(key=lambda job: job.id)
    return [_make_job_row(context, job) for job in jobs[-max_count:]]


def _make_job_row(context: ViewContext, job: Job) -> api.JobRow:
    totals = compute_job_totals(context.books, job)
    return api.JobRow(
        id=job.id,
        name=job.name,
        state=job.state,
        submitted=context.format_time(job.submitted_s) or "",
        submitted_by=job.submitted_by,
        ended=context.format_time(job.ended_s),
        note=job.options.note,
        plates=len(job.plates),
        printed=totals.printed_count,
        good=totals.good_count,
        error=job.error,
        reason=job.reason,
        assembled=context.format_time(job.assembled_s),
        assembly_s=job.gluing_s,
    )


def make_history_row(context: ViewContext, attempt: Print) -> api.HistoryRow:
    """Make the history row of a print; its time and filament are 0 until the print has ended."""
    plate, job = context.books.plates[attempt.plate], context.books.jobs[attempt.job]
    return api.HistoryRow(
        **dict(describe_print(context, attempt)),
        job=attempt.job,
        name=job.name,
        note=job.options.note,
        submitted_by=job.submitted_by,
        took_s=compute_duration_s(attempt),
        expected_s=plate.expected_s,
        grams=attempt.grams,
        wasted=is_wasted(attempt),
        assembled=context.format_time(job.assembled_s),
        assembly_s=job.gluing_s,
    )
