"""Dry runs: jobs that are planned and never printed, cancelled when no client asks for the plan any more."""

from __future__ import annotations

from farm.control.controller import Controller
from farm.state import events as ev

PATIENCE_S = 60.0
"""Wall seconds without a request after which a dry run is abandoned; long enough for a restart."""
_BY = "the farm: nobody waits for its plan any more"


class DryRuns:
    """Cancels dry runs whose `farm submit` has exited. Times are wall seconds of a monotonic clock."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._requested_s: dict[int, float] = {}

    def keep(self, job: int, now_s: float) -> None:
        """Record the time of a client's request for the status of a job."""
        self._requested_s[job] = now_s

    def cancel_abandoned(self, now_s: float) -> None:
        """Cancel the dry runs without a request within `PATIENCE_S`."""
        jobs = self._controller.books.jobs.values()
        dry_runs = [job.id for job in jobs if job.options.dry_run and not job.state.ended]
        self._requested_s = {number: self._requested_s.get(number, now_s) for number in dry_runs}
        abandoned = [
            number for number, requested_s in self._requested_s.items() if now_s - requested_s > PATIENCE_S
        ]
        if abandoned:
            at_s = self._controller.clock.now()
            self._controller.handle(*(ev.JobCancelled(at_s=at_s, job=n, by=_BY) for n in abandoned))
