"""The job in front: planned for the printers that it takes, or held with what it waits for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from farm.config import PrinterSection
from farm.model import Hold, HoldCode, Job, JobState
from farm.scheduling.admission import Availability, JobRequest, begin_beside, unmatched
from farm.scheduling.matching import FleetPrinter
from farm.scheduling.situation_builder import job_requirements
from farm.scheduling.spares import spare_printers
from farm.state import events as ev

if TYPE_CHECKING:
    from farm.control.controller import Core


class JobAdmission:
    """What it remembers goes with the daemon: a plan that died with one is made anew.

    Parameters
    ----------
    core
        Whose jobs these are.
    plan
        Starts the planning of a job for these printers, in as many rounds, and returns at once.
    """

    def __init__(self, core: Core, plan: Callable[[Job, list[PrinterSection], int], None]) -> None:
        self._core, self._plan = core, plan
        self._least: dict[int, int] = {}  # parts that a job was seen to need
        self._planned: dict[int, frozenset[str]] = {}  # the printers that a job is being planned for

    def needs(self, number: int, parts: int) -> None:
        """A job was seen to need so many parts."""
        self._least[number] = parts

    def planned(self, number: int) -> None:
        """A job is not being planned any more."""
        self._planned.pop(number, None)

    def settle(self, held: Mapping[str, Hold], promised: frozenset[str]) -> None:
        """Begin the job in front. One that no printer matches (any more) is held, and others pass it.

        G-code has a front of its own: it is planned in a moment, and never waits for a decomposition.

        Parameters
        ----------
        held
            The waiting plates that no printer takes now.
        promised
            Printers that a plate is being made otherwise for.
        """
        views, now_s = self._core.fleet_printers(), self._core.clock.now()
        fronts: dict[bool, Job] = {}
        for job in self._core.books.queue():
            own = job.own_gcode is not None
            nobody = unmatched(job_requirements(job), views)
            if job.state is JobState.PLANNING:
                fronts[own] = job
            elif nobody is not None:
                self._hold(job, nobody)
            elif job.paused:
                self._hold(job, Hold(code=HoldCode.PAUSED, text=f"it is paused: `farm resume {job.id}`"))
            elif job.not_before_s is not None and now_s < job.not_before_s and not job.options.hold:
                text = f"it starts {self._core.rules.words(job.not_before_s)}"
                self._hold(job, Hold(code=HoldCode.START_TIME, text=text))
            elif own in fronts:
                text = f"job {fronts[own].id} is in front of it"
                self._hold(job, Hold(code=HoldCode.NOT_FRONT, text=text))
            else:
                fronts[own] = job
                self._begin(job, views, held, promised)

    def _begin(
        self, job: Job, views: list[FleetPrinter], held: Mapping[str, Hold], promised: frozenset[str]
    ) -> None:
        """Start to plan a job, or book what it waits for."""
        attended = self._core.rules.is_attended(self._core.clock.now())
        taken = frozenset(self._core.books.plates[name].printer for name in held)
        taken |= spare_printers(views, taken, self._core.spares()) | promised
        request = JobRequest(
            requirements=job_requirements(job),
            printers=job.options.printers if job.own_gcode is None else None,  # its plan chooses one
            least_parts=self._least.get(job.id, 0),
            spares=job.options.spares,
            needs_approval=job.options.hold,
        )
        availability = Availability(
            printers=tuple(views),
            taken=taken,
            starting=self._core.arriving(),
            unattended_blocked=frozenset(p.name for p in views if not (p.unattended or attended)),
        )
        planned = [(self._core.books.job(n).options.priority, names) for n, names in self._planned.items()]
        answer = begin_beside(request, availability, job.options.priority, planned)
        if isinstance(answer, Hold):
            self._hold(job, answer)
            return
        self._core.happened(ev.PlanningStarted(at_s=self._core.clock.now(), job=job.id))
        self._planned[job.id] = frozenset(answer.printers)
        sections = [self._core.fleet.printer(name) for name in answer.printers]
        self._plan(self._core.books.job(job.id), sections, answer.rounds)

    def _hold(self, job: Job, hold: Hold) -> None:
        if job.hold != hold:
            self._core.happened(ev.JobHeld(at_s=self._core.clock.now(), job=job.id, hold=hold))
