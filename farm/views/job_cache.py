"""Cache of the contents of jobs in views, kept until something of the job changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from farm import api
from farm.state import Books
from farm.views.accounting import JobSummary

MAX_JOBS = 1000
"""Maximum number of jobs that are kept, each with about 1 kB for a part."""


@dataclass(slots=True)
class JobContents:
    """Contents of a job in views that depend neither on the time nor on other jobs.

    Attributes
    ----------
    parts, plates
        Its parts and plates; the holds of plates are those of the last view.
    summary
        Its totals.
    """

    parts: list[api.PartView]
    plates: list[api.PlateStatus]
    summary: JobSummary


class JobCache:
    """Contents of the jobs that were looked at last, by the revision of each in the books.

    It serves one state folder and one time zone.
    """

    def __init__(self) -> None:
        self._contents: dict[int, tuple[object, JobContents]] = {}

    def find(self, books: Books, job: int, make: Callable[[], JobContents]) -> JobContents:
        """Return the contents of a job, made anew if something of it has changed."""
        revision = books.revision(job)
        cached_revision, contents = self._contents.get(job, (None, None))
        if contents is None or revision is None or cached_revision is not revision:
            contents = make()
            if job not in self._contents and len(self._contents) >= MAX_JOBS:
                self._contents.pop(next(iter(self._contents)))
            self._contents[job] = revision, contents
        return contents
