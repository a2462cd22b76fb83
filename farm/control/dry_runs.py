"""Dry runs: jobs that are planned but not printed, cancelled when no client requests the plan any more."""

from __future__ import annotations

from farm.control.controller import Controller
from farm.state import events as ev

PATIENCE_S = 60.0
"""Wall seconds without a request after which a dry run is abandoned; long enough for a restart."""
PAGE_PATIENCE_S = 3600.0
"""Wall seconds for which a page with the plan of a dry run may be read."""
_CANCELLER = "the farm: nobody waits for its plan any more"


class DryRuns:
    """Cancels dry runs whose `farm submit` has exited. Times are wall seconds of a monotonic clock."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._kept_until_s: dict[int, float] = {}

    def keep(self, job: int, now_s: float, patience_s: float = PATIENCE_S) -> None:
        """Keep a dry run for some time after a client's request about it."""
        self._kept_until_s[job] = max(now_s + patience_s, self._kept_until_s.get(job, 0.0))

    def cancel_abandoned(self, now_s: float) -> None:
        """Cancel the dry runs that no request has kept until now."""
        jobs = self._controller.books.jobs.values()
        dry_runs = [job.id for job in jobs if job.options.dry_run and not job.state.ended]
        self._kept_until_s = {n: self._kept_until_s.get(n, now_s + PATIENCE_S) for n in dry_runs}
        abandoned_jobs = [number for number, until_s in self._kept_until_s.items() if now_s > until_s]
        if abandoned_jobs:
            at_s = self._controller.clock.now()
            self._controller.handle(
                *(ev.JobCancelled(at_s=at_s, job=n, by=_CANCELLER) for n in abandoned_jobs)
            )
