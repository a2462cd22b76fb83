"""Admission of jobs to planning: the front of the queue begins, the others get a reason to wait. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from farm.model import Hold, HoldCode, Job, JobState
from farm.planning.replanning.coordinator import StartReplan
from farm.scheduling.admission import (
    Availability,
    Begin,
    JobRequest,
    Promise,
    choose_printers_beside,
    find_mismatch,
)
from farm.scheduling.assign import Assignment, assign
from farm.scheduling.situation import Situation
from farm.scheduling.situation_builder import job_requirements
from farm.state.books import Books


@dataclass(frozen=True, slots=True)
class StartPlanning:
    """Instruction to plan a job for these printers, in as many rounds."""

    job: int
    printers: tuple[str, ...]
    rounds: int


@dataclass(frozen=True, slots=True)
class HoldJob:
    """Decision that a job waits, and why."""

    job: int
    hold: Hold


class JobAdmission:
    """Decides which jobs begin to be planned, and remembers for which printers.

    It is in memory only: a plan that died with a daemon is made again by the next one.
    """

    def __init__(self) -> None:
        self._least_parts: dict[int, int] = {}
        self._planned: dict[int, frozenset[str]] = {}  # the printers that a job is being planned for

    def require_parts(self, number: int, parts: int) -> None:
        """Note that a job needs so many parts, as an attempt to plan it has shown."""
        self._least_parts[number] = parts

    def begin(self, order: StartPlanning) -> None:
        """Note that a job is being planned."""
        self._planned[order.job] = frozenset(order.printers)

    def end(self, number: int) -> None:
        """Note that a job is not being planned any more."""
        self._planned.pop(number, None)

    def decide(
        self, books: Books, situation: Situation, kept: Mapping[str, str], starting: bool
    ) -> Iterator[StartPlanning | HoldJob]:
        """Yield what becomes of each queued job: it begins, or has a reason to wait.

        Own G-code has a front of its own: it is planned in a moment, and never waits for a decomposition. A
        job that no printer matches lets the others pass.

        Parameters
        ----------
        books
            As committed, with the plates that have just been assigned.
        situation
            The fleet after that, the rules, and the spares.
        kept
            Printers that no job gets, with what each is kept for.
        starting
            The farm has just started: printers that are still connecting are waited for.
        """
        planned = dict(self._planned)
        fronts: dict[bool, Job] = {}
        for job in books.queue():
            own = job.own_gcode is not None
            if job.state is JobState.PLANNING:
                fronts[own] = job
                continue
            decision: Begin | Hold | None = _own_hold(job, situation)
            if decision is None and own in fronts:
                text = f"job {fronts[own].id} goes first"
                decision = Hold(code=HoldCode.NOT_FRONT, text=text)
            if decision is None:
                fronts[own] = job
                decision = choose_printers_beside(
                    self._request(job),
                    _availability(situation, kept, starting),
                    job.options.priority,
                    [Promise(n, books.job(n).options.priority, names) for n, names in planned.items()],
                )
            if isinstance(decision, Begin):
                planned[job.id] = frozenset(decision.printers)
                yield StartPlanning(job.id, decision.printers, decision.rounds)
            else:
                yield HoldJob(job.id, decision)

    def _request(self, job: Job) -> JobRequest:
        return JobRequest(
            requirements=job_requirements(job),
            printers=job.options.printers if job.own_gcode is None else None,  # its plan chooses one
            least_parts=self._least_parts.get(job.id, 0),
            spares=job.options.spares,
            needs_approval=job.options.hold,
        )


def kept_printers(situation: Situation, replans: Iterable[StartReplan]) -> dict[str, str]:
    """Return the printers that no job can count on, with what each is kept for.

    Nothing is kept for a plate that may not start: what ends its wait may be far away.

    Parameters
    ----------
    situation
        What waits on, and the fleet after the plates that start now.
    replans
        The plates that are being replanned, and for which printers.
    """
    soon: Iterable[Assignment] = ()
    if situation.rules.max_heating is not None:  # as soon as another printer has heated up
        soon = assign(replace(situation, rules=replace(situation.rules, max_heating=None)))
    return {
        **dict.fromkeys(situation.kept, "a failed part (--spares)"),
        **{each.printer: each.plate for each in soon},
        **{name: replan.plate for replan in replans for name in replan.printers},
    }


def _own_hold(job: Job, situation: Situation) -> Hold | None:
    """Return why a job would begin on no printer, whoever is in front of it."""
    nobody = find_mismatch(job_requirements(job), situation.printers)
    if nobody is not None:
        return nobody
    if job.paused:
        return Hold(code=HoldCode.PAUSED, text=f"it is paused: `farm resume {job.id}`")
    if job.not_before_s is not None and situation.now_s < job.not_before_s and not job.options.hold:
        text = f"it starts {situation.rules.format_moment(job.not_before_s)}"
        return Hold(code=HoldCode.START_TIME, text=text)
    return None


def _availability(situation: Situation, kept: Mapping[str, str], starting: bool) -> Availability:
    attended = situation.rules.is_attended(situation.now_s)
    blocked = frozenset(p.name for p in situation.printers if not (p.unattended or attended))
    return Availability(situation.printers, kept, starting, blocked)
