"""Cache of the descriptions of jobs in views; a change to a job invalidates its description."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from farm import api
from farm.state import Books
from farm.views.accounting import JobTotals

T = TypeVar("T")

MAX_JOBS = 1000
"""Maximum number of cached jobs; a job takes about 1 kB for each part."""


@dataclass(slots=True)
class PartsAndPlates:
    """Views of a job's parts and plates; `describe_jobs` updates the plates' holds before it uses them."""

    parts: list[api.PartView]
    plates: list[api.PlateStatus]


class JobVersionCache(Generic[T]):
    """Cache of one description for each job; a description is valid until the job changes in the books."""

    def __init__(self) -> None:
        self._descriptions: dict[int, tuple[object, T]] = {}

    def find(self, books: Books, job_id: int, make_description: Callable[[], T]) -> T:
        """Return the cached description of a job, or a new one if the job has changed."""
        version = books.find_job_version(job_id)
        cached = self._descriptions.get(job_id)
        if cached is not None and version is not None and cached[0] is version:
            return cached[1]
        description = make_description()
        if job_id not in self._descriptions and len(self._descriptions) >= MAX_JOBS:
            self._descriptions.pop(next(iter(self._descriptions)))
        self._descriptions[job_id] = version, description
        return description


class JobCache:
    """Cache of descriptions of jobs that depend neither on the time nor on other jobs.

    The descriptions contain paths and local times, so a cache is for one state folder and one time zone.

    Attributes
    ----------
    contents
        Parts and plates of each job.
    totals
        Totals of each job.
    """

    def __init__(self) -> None:
        self.contents = JobVersionCache[PartsAndPlates]()
        self.totals = JobVersionCache[JobTotals]()
