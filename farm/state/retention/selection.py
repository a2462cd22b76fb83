"""Selection of the ended jobs whose files are deleted, the oldest first. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass

from farm.model import Bed, Job, JobState, Print, PrintState
from farm.state.books import Books
from farm.state.retention.file_names import group_file_names_by_job

DAY_S = 86400.0
MIN_AGE_S = 2 * DAY_S
"""Minimum time for which the files of an ended job are kept, because people judge parts the next morning."""
_PRUNABLE_STATES = (JobState.DONE, JobState.FAILED, JobState.CANCELLED)


@dataclass(frozen=True, slots=True)
class RetentionRules:
    """Limits on stored files: maximum days since their job ended, and maximum size of all of them."""

    max_age_days: float
    max_bytes: float


def find_keep_reason(books: Books, job: Job) -> str | None:
    """Return the reason for which the files of a job are kept; None if they may be deleted."""
    return _find_keep_reason(books, job, _find_unjudged_jobs(books))


def _find_keep_reason(books: Books, job: Job, unjudged_jobs: Mapping[int, str]) -> str | None:
    if job.pruned_s is not None:
        return "already pruned"
    if job.state not in _PRUNABLE_STATES or job.ended_s is None:
        return f"{job.state}"
    if any(True for _ in books.list_open_prints(job.id)):
        return "being printed"
    return unjudged_jobs.get(job.id)


def _find_unjudged_jobs(books: Books) -> dict[int, str]:
    """Return the jobs with a part that a person has not judged yet, each with the reason to keep its files.

    A part that is judged bad is printed again, from the same files.
    """
    keep_reasons = {}
    for printer in books.printers.values():
        last_print = books.find_last_print(printer.name)
        if last_print is not None and (printer.bed is not Bed.CLEAR or _is_unjudged(last_print)):
            keep_reasons[last_print.job] = f"on the bed of {printer.name}"
    for attempt in books.prints.values():
        if attempt.restored and _is_unjudged(attempt):
            keep_reasons[attempt.job] = f"without a verdict on the part from {attempt.printer}"
    return keep_reasons


def _is_unjudged(attempt: Print) -> bool:
    return attempt.state is PrintState.DONE and attempt.verdict is None


def select_jobs(
    books: Books, sizes_bytes: Mapping[str, int], rules: RetentionRules, now_s: float, backup_s: float
) -> list[int]:
    """Select the jobs to prune: those that ended too long ago, then the oldest until all files fit.

    Parameters
    ----------
    books
        The books.
    sizes_bytes
        Size of each file in the store, by name.
    rules
        The limits.
    now_s
        Farm time, in seconds.
    backup_s
        Time of the newest verified backup, in seconds. A job that ended later is kept, because it is still
        open in the backup.

    Returns
    -------
    list of int
        Ids of the jobs, in the order in which they ended. Jobs that ended within the last two days are never
        selected.
    """
    names = group_file_names_by_job(books)
    reference_counts = Counter(name for job_names in names.values() for name in job_names)
    total_bytes = sum(sizes_bytes.get(name, 0) for name in reference_counts)
    selected_jobs = []
    for job, ended_s in _list_candidates(books, min(backup_s, now_s - MIN_AGE_S)):
        if ended_s >= now_s - rules.max_age_days * DAY_S and total_bytes <= rules.max_bytes:
            break
        selected_jobs.append(job.id)
        for name in names[job.id] - _list_kept_names(job):
            reference_counts[name] -= 1
            if reference_counts[name] == 0:
                total_bytes -= sizes_bytes.get(name, 0)
    return selected_jobs


def list_prunable_files(books: Books, names: Iterable[str], now_s: float) -> set[str]:
    """List the stored files that pruning may delete, because no open or recently ended job needs them."""
    prunable_jobs = {job.id for job, _ in _list_candidates(books, now_s - MIN_AGE_S)}
    kept_names: set[str] = set()
    for job_id, job_names in group_file_names_by_job(books).items():
        kept_names |= _list_kept_names(books.jobs[job_id]) if job_id in prunable_jobs else job_names
    return set(names) - kept_names


def list_jobs_pruned_since_backup(books: Books, stored_names: Container[str]) -> list[int]:
    """List the jobs that were pruned after the restored backup was made: some of their files are missing.

    Pruning keeps pictures. A job without its pictures is not listed, because the store may be unavailable.
    """
    unjudged_jobs = _find_unjudged_jobs(books)
    names_by_job = group_file_names_by_job(books)
    if not any(name in stored_names for job_names in names_by_job.values() for name in job_names):
        return []
    return [
        job_id
        for job_id, job_names in names_by_job.items()
        if any(name not in stored_names for name in job_names)
        and all(name in stored_names for name in _list_kept_names(books.jobs[job_id]))
        and _find_keep_reason(books, books.jobs[job_id], unjudged_jobs) is None
    ]


def _list_candidates(books: Books, cutoff_s: float) -> Iterable[tuple[Job, float]]:
    """List the prunable jobs that ended before a time, in the order in which they ended."""
    unjudged_jobs = _find_unjudged_jobs(books)
    ended_jobs = [
        (job, job.ended_s)
        for job in books.jobs.values()
        if job.ended_s is not None
        and job.ended_s < cutoff_s
        and _find_keep_reason(books, job, unjudged_jobs) is None
    ]
    return sorted(ended_jobs, key=lambda pair: (pair[1], pair[0].id))


def _list_kept_names(job: Job) -> frozenset[str]:
    return frozenset([job.picture] if job.picture else [])
