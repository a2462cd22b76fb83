"""Admission of jobs to planning: planning starts for the front of the queue, the others get a hold. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from farm.model import Hold, HoldCode, Job, JobState, Link
from farm.scheduling.assignment import Assignment, assign_plates
from farm.scheduling.matching import FleetPrinter, Requirements
from farm.scheduling.situation import Situation
from farm.scheduling.situation_builder import job_requirements
from farm.state import Books

_PASSING = (
    HoldCode.PRINTER_BUSY,
    HoldCode.BED_NOT_CLEAR,
    HoldCode.FILAMENT_UNKNOWN,
    HoldCode.REEL_UNCERTAIN,
)


@dataclass(frozen=True, slots=True)
class Begin:
    """Instruction to plan a job for these printers, in this number of rounds."""

    printers: tuple[str, ...]
    rounds: int = 1


@dataclass(frozen=True, slots=True)
class JobRequest:
    """Printers that a job without a plan asks for.

    Attributes
    ----------
    requirements
        Requirements on each printer.
    printers
        Number of printers that the user requested; None for all.
    least_parts
        Number of parts needed according to an earlier attempt; 0 if unknown.
    spares
        Number of free printers to leave idle, while it has at least one.
    needs_approval
        Nothing is printed before a person approves its plan: busy printers count too, as the queue at that
        time is not known; if other jobs have them then, it waits.
    """

    requirements: Requirements
    printers: int | None = None
    least_parts: int = 0
    spares: int = 0
    needs_approval: bool = False


@dataclass(frozen=True, slots=True)
class Promise:
    """Printers for which another job is being planned."""

    job: int
    priority: int
    printers: frozenset[str]


@dataclass(frozen=True, slots=True)
class Availability:
    """Availability of the fleet to the first job in the queue.

    Attributes
    ----------
    printers
        The fleet; at least one printer matches.
    kept
        Printers that are reserved, each with its purpose: a plate or a job.
    starting
        The farm has just started: printers that are still connecting are waited for.
    unattended_blocked
        Printers on which nothing may start while nobody is present: chosen only if there is no other.
    """

    printers: tuple[FleetPrinter, ...]
    kept: Mapping[str, str] = field(default_factory=dict)
    starting: bool = False
    unattended_blocked: frozenset[str] = frozenset()

    def keeping(self, promises: Iterable[Promise]) -> Availability:
        """Return the availability with the printers of these promises reserved too."""
        kept = {name: f"job {promise.job}" for promise in promises for name in promise.printers}
        return replace(self, kept={**kept, **self.kept})


def find_mismatch(requirements: Requirements, printers: Iterable[FleetPrinter]) -> Hold | None:
    """Return a hold if no printer of the fleet matches: `fleet.yaml` may have changed since submission."""
    if any(requirements.matches(printer.capabilities) for printer in printers):
        return None
    return Hold(
        code=HoldCode.NO_SUCH_PRINTER,
        text="no printer of the fleet matches this job: change fleet.yaml, or cancel it",
    )


def choose_printers(request: JobRequest, availability: Availability) -> Begin | Hold:
    """Choose the printers for the first job in the queue.

    It takes all matching printers that are idle and clear, or as many as it was given, once they can print it
    in one round; if the whole fleet cannot, the idle ones in several rounds.
    """
    matching = sorted(
        (p for p in availability.printers if request.requirements.matches(p.capabilities)),
        key=lambda p: p.name,
    )
    arriving = [p.name for p in matching if p.link in (Link.STARTING, Link.CONNECTING) and not p.booked]
    if arriving and availability.starting:
        return Hold(code=HoldCode.PRINTER_CONNECTING, text=f"connecting to {' '.join(arriving)}")
    # A printer that is absent or broken may never return: nothing waits for it.
    coming = [p for p in matching if (hold := p.obstacle()) is None or hold.code in _PASSING]
    if not request.needs_approval:
        coming = [p for p in coming if p.name not in availability.unattended_blocked] or coming
    idle = (
        coming
        if request.needs_approval
        else [p for p in coming if p.obstacle() is None and p.name not in availability.kept]
    )
    if not idle:
        kept = [p.name for p in coming if p.obstacle() is None and p.name in availability.kept]
        if kept:
            return _kept_hold({name: availability.kept[name] for name in kept})
        obstacles = [obstacle for p in matching if (obstacle := p.obstacle()) is not None]
        # Prefer a reason that ends by itself; ask a person only if there is none.
        busy = [hold for hold in obstacles if hold.code is HoldCode.PRINTER_BUSY]
        full = [p.name for p in matching if (h := p.obstacle()) and h.code is HoldCode.BED_NOT_CLEAR]
        if busy and full:
            advice = f"`farm cleared {full[0]}` would let it start now, if that bed is clear"
            return Hold(code=HoldCode.PRINTER_BUSY, text=f"{busy[0].text}; {advice}")
        return (busy or obstacles)[0]
    granted = min(max(1, len(idle) - request.spares), request.printers or len(idle))
    ceiling = min(max(1, len(coming) - request.spares), request.printers or len(coming))
    least = request.least_parts
    if least > granted:
        if least <= ceiling:
            text = f"it needs {least} printers at the same time, {granted} of {ceiling} are idle and clear"
            return Hold(code=HoldCode.TOO_FEW_PRINTERS, text=text)
        return Begin(tuple(p.name for p in idle[:granted]), rounds=-(-least // granted))
    # The largest first: two requested printers are the best two.
    idle.sort(key=lambda p: (-p.capabilities.height_mm, p.name))
    return Begin(tuple(sorted(p.name for p in idle[:granted])))


def _kept_hold(kept: Mapping[str, str]) -> Hold:
    """Return the hold for idle printers that are reserved."""
    names: dict[str, list[str]] = {}
    for name, purpose in kept.items():
        names.setdefault(purpose, []).append(name)
    text = "; ".join(
        f"{' '.join(kept_names)} {'is' if len(kept_names) == 1 else 'are'} kept for {purpose}"
        for purpose, kept_names in names.items()
    )
    return Hold(code=HoldCode.PRINTER_BUSY, text=text)


def choose_printers_beside(
    request: JobRequest,
    availability: Availability,
    priority: int,
    promises: Iterable[Promise],
) -> Begin | Hold:
    """Choose the printers of a job while others are being planned.

    Those reserve their printers against jobs of lower priority, and against others while more are free.

    Parameters
    ----------
    request, availability
        See `choose_printers`.
    priority
        The job's priority.
    promises
        The reserved printers of the jobs that are being planned.
    """
    others = list(promises)
    first = choose_printers(request, availability.keeping(others))
    if isinstance(first, Begin):
        return first
    return choose_printers(
        request, availability.keeping(other for other in others if other.priority > priority)
    )


@dataclass(frozen=True, slots=True)
class StartPlanning:
    """Instruction to plan a job for these printers, in this number of rounds."""

    job: int
    printers: tuple[str, ...]
    rounds: int


@dataclass(frozen=True, slots=True)
class HoldJob:
    """Decision that a job waits, with the reason."""

    job: int
    hold: Hold


class JobAdmission:
    """Decides which jobs are planned, and records for which printers.

    State is kept in memory only: after a restart, jobs are planned again.
    """

    def __init__(self) -> None:
        self._least_parts: dict[int, int] = {}
        self._planned: dict[int, frozenset[str]] = {}  # printers for which a job is being planned

    def require_parts(self, number: int, parts: int) -> None:
        """Store the number of parts that a job needs according to an attempt to plan it."""
        self._least_parts[number] = parts

    def begin(self, order: StartPlanning) -> None:
        """Store the printers for which a job is being planned."""
        self._planned[order.job] = frozenset(order.printers)

    def end(self, number: int) -> None:
        """Remove a job whose planning has ended."""
        self._planned.pop(number, None)

    def decide(
        self, books: Books, situation: Situation, kept: Mapping[str, str], starting: bool
    ) -> Iterator[StartPlanning | HoldJob]:
        """Yield a decision on each queued job: its planning starts, or it has a reason to wait.

        Own G-code has a separate queue: its planning is quick, and never waits for a decomposition. A
        job that no printer matches does not block the others.

        Parameters
        ----------
        books
            The committed books, with the plates that have just been assigned.
        situation
            The fleet after this assignment, the rules and the spares.
        kept
            Printers that are reserved, each with its purpose.
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
                decision = Hold(code=HoldCode.NOT_FIRST, text=text)
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
            printers=job.options.printers if job.own_gcode is None else None,  # planning chooses one
            least_parts=self._least_parts.get(job.id, 0),
            spares=job.options.spares,
            needs_approval=job.options.hold,
        )


def kept_printers(situation: Situation, reserved: Mapping[str, str]) -> dict[str, str]:
    """Return the printers that are reserved and so not available to a new job, each with its purpose.

    No printer is reserved for a plate that may not start, as it may wait for long.

    Parameters
    ----------
    situation
        The plates that still wait, and the fleet after the present assignment.
    reserved
        Printers for which plates are being replanned, with the plate.
    """
    soon: Iterable[Assignment] = ()
    if situation.rules.max_heating is not None:  # plates that start once another printer has heated up
        soon = assign_plates(replace(situation, rules=replace(situation.rules, max_heating=None)))
    return {
        **dict.fromkeys(situation.kept, "a failed part (--spares)"),
        **{each.printer: each.plate for each in soon},
        **reserved,
    }


def _own_hold(job: Job, situation: Situation) -> Hold | None:
    """Return the hold of a job that is independent of other jobs; None if there is none."""
    mismatch = find_mismatch(job_requirements(job), situation.printers)
    if mismatch is not None:
        return mismatch
    if job.paused:
        return Hold(code=HoldCode.PAUSED, text=f"it is paused: `farm resume {job.id}`")
    if job.not_before_s is not None and situation.now_s < job.not_before_s and not job.options.hold:
        text = f"it starts {situation.rules.format_moment(job.not_before_s, situation.now_s)}"
        return Hold(code=HoldCode.START_TIME, text=text)
    return None


def _availability(situation: Situation, kept: Mapping[str, str], starting: bool) -> Availability:
    attended = situation.rules.is_attended(situation.now_s)
    blocked = frozenset(p.name for p in situation.printers if not (p.unattended or attended))
    return Availability(situation.printers, kept, starting, blocked)
