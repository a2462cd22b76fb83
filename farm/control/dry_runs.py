"""Dry runs: jobs that are planned and never printed, cancelled once nobody asks for the plan."""

from __future__ import annotations

from farm.control.controller import Controller
from farm.state import events as ev

PATIENCE_S = 60.0
"""Wall seconds without a question after which nobody wants it any more; a restart may take that long."""
_BY = "the farm: nobody waits for its plan any more"


class DryRuns:
    """Cancels those whose `farm submit` has gone. Times are wall seconds of any clock that only goes on."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._asked_s: dict[int, float] = {}

    def keep(self, job: int, now_s: float) -> None:
        """Note that somebody asked how a job is."""
        self._asked_s[job] = now_s

    def cancel_abandoned(self, now_s: float) -> None:
        """Cancel what nobody has asked for in a while."""
        jobs = self._controller.books.jobs.values()
        going = [job.id for job in jobs if job.options.dry_run and not job.state.ended]
        self._asked_s = {number: self._asked_s.get(number, now_s) for number in going}
        abandoned = [number for number, asked_s in self._asked_s.items() if now_s - asked_s > PATIENCE_S]
        if abandoned:
            at_s = self._controller.clock.now()
            self._controller.handle(*(ev.JobCancelled(at_s=at_s, job=n, by=_BY) for n in abandoned))
