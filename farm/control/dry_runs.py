"""Dry runs: jobs of which only the plan is wanted, for as long as somebody asks for it."""

from __future__ import annotations

from farm.control.controller import Core
from farm.state import events as ev

PATIENCE_S = 60.0
"""Wall seconds without a question after which nobody wants it any more; a restart may take that long."""
_BY = "the farm: nobody waits for its plan any more"


class DryRuns:
    """Cancels those whose `farm submit` has gone. Times are wall seconds of any clock that only goes on."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._asked_s: dict[int, float] = {}

    def asked(self, job: int, now_s: float) -> None:
        """Somebody asked how a job is."""
        self._asked_s[job] = now_s

    def end_forgotten(self, now_s: float) -> None:
        """Cancel what nobody has asked for in a while."""
        going = [j for j in self._core.books.jobs.values() if j.options.dry_run and not j.state.ended]
        self._asked_s = {job.id: self._asked_s.get(job.id, now_s) for job in going}
        forgotten = [job for job, asked_s in self._asked_s.items() if now_s - asked_s > PATIENCE_S]
        for job in forgotten:
            self._core.happened(ev.JobCancelled(at_s=self._core.clock.now(), job=job, by=_BY))
        if forgotten:
            self._core.settle()
