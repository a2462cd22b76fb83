"""Admission of the job in front: whether its planning can begin, and for which printers. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from farm.model import Hold, HoldCode, Link
from farm.scheduling.matching import FleetPrinter, Requirements

_PASSING = (
    HoldCode.PRINTER_BUSY,
    HoldCode.BED_NOT_CLEAR,
    HoldCode.FILAMENT_UNKNOWN,
    HoldCode.REEL_DOUBTED,
)


@dataclass(frozen=True, slots=True)
class Begin:
    """Instruction to plan a job for these printers, in as many rounds."""

    printers: tuple[str, ...]
    rounds: int = 1


@dataclass(frozen=True, slots=True)
class JobRequest:
    """Printers that a job without a plan asks for.

    Attributes
    ----------
    requirements
        What a printer must offer.
    printers
        How many printers a person gave it; None for all.
    least_parts
        How many parts an earlier attempt has shown to be needed; 0 where nothing is known.
    spares
        How many of the free printers it leaves, as long as it has one.
    needs_approval
        Nothing of it is printed before a person approves its plan: printers that print now count too, as
        nobody knows what is then in front of it; where others have them then, it waits.
    """

    requirements: Requirements
    printers: int | None = None
    least_parts: int = 0
    spares: int = 0
    needs_approval: bool = False


@dataclass(frozen=True, slots=True)
class Promise:
    """Printers that another job is being planned for."""

    job: int
    priority: int
    printers: frozenset[str]


@dataclass(frozen=True, slots=True)
class Availability:
    """The fleet as it is available to the job in front.

    Attributes
    ----------
    printers
        The fleet, of which one at least matches.
    kept
        Printers that it does not get, with what each is kept for: a plate, a job.
    starting
        The farm has just started: printers that are still connecting are waited for.
    unattended_blocked
        Printers on which nothing may start while nobody is there: taken only where there is no other.
    """

    printers: tuple[FleetPrinter, ...]
    kept: Mapping[str, str] = field(default_factory=dict)
    starting: bool = False
    unattended_blocked: frozenset[str] = frozenset()

    def keeping(self, promises: Iterable[Promise]) -> Availability:
        """Return the same with the printers kept that jobs are being planned for."""
        kept = {name: f"job {promise.job}" for promise in promises for name in promise.printers}
        return replace(self, kept={**kept, **self.kept})


def find_mismatch(requirements: Requirements, printers: Iterable[FleetPrinter]) -> Hold | None:
    """Return a hold where no printer of the fleet matches: `fleet.yaml` may have changed since submission."""
    if any(requirements.matches(printer.capabilities) for printer in printers):
        return None
    return Hold(
        code=HoldCode.NO_SUCH_PRINTER,
        text="no printer of the fleet matches this job: change fleet.yaml, or cancel it",
    )


def begin(request: JobRequest, availability: Availability) -> Begin | Hold:
    """Choose the printers that the job in front takes.

    It takes all that match and are idle and clear, or as many as it was given, once they can hold it in one
    round; where even the whole fleet cannot, the idle ones with further rounds.
    """
    matching = sorted(
        (p for p in availability.printers if request.requirements.matches(p.capabilities)),
        key=lambda p: p.name,
    )
    arriving = [p.name for p in matching if p.link in (Link.STARTING, Link.CONNECTING) and not p.booked]
    if arriving and availability.starting:
        return Hold(code=HoldCode.PRINTER_CONNECTING, text=f"connecting to {' '.join(arriving)}")
    # A printer that is away or broken may never come back: it is not waited for.
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
        # What ends by itself is waited for; a person is asked only where nothing does.
        busy = [hold for hold in obstacles if hold.code is HoldCode.PRINTER_BUSY]
        full = [p.name for p in matching if (h := p.obstacle()) and h.code is HoldCode.BED_NOT_CLEAR]
        if busy and full:
            sooner = f"`farm cleared {full[0]}` would let it begin now, if that bed is clear"
            return Hold(code=HoldCode.PRINTER_BUSY, text=f"{busy[0].text}; {sooner}")
        return (busy or obstacles)[0]
    given = min(max(1, len(idle) - request.spares), request.printers or len(idle))
    ceiling = min(max(1, len(coming) - request.spares), request.printers or len(coming))
    least = request.least_parts
    if least > given:
        if least <= ceiling:
            text = f"it needs {least} printers at the same time, {given} of {ceiling} are idle and clear"
            return Hold(code=HoldCode.TOO_FEW_PRINTERS, text=text)
        return Begin(tuple(p.name for p in idle[:given]), rounds=-(-least // given))
    # The roomiest first: a person who gives two printers gives the best two.
    idle.sort(key=lambda p: (-p.capabilities.height_mm, p.name))
    return Begin(tuple(sorted(p.name for p in idle[:given])))


def _kept_hold(kept: Mapping[str, str]) -> Hold:
    """Return the hold for idle printers that are kept for something else."""
    names: dict[str, list[str]] = {}
    for name, purpose in kept.items():
        names.setdefault(purpose, []).append(name)
    text = "; ".join(
        f"{' '.join(those)} {'is' if len(those) == 1 else 'are'} kept for {purpose}"
        for purpose, those in names.items()
    )
    return Hold(code=HoldCode.PRINTER_BUSY, text=text)


def choose_printers_beside(
    request: JobRequest,
    availability: Availability,
    priority: int,
    promises: Iterable[Promise],
) -> Begin | Hold:
    """Choose the printers of a job beside others that are being planned.

    Those keep their printers from jobs of less priority, and from others while there are more.

    Parameters
    ----------
    request, availability
        As for `begin`.
    priority
        The job's priority.
    promises
        The printers of the jobs that are being planned.
    """
    others = list(promises)
    first = begin(request, availability.keeping(others))
    if isinstance(first, Begin):
        return first
    return begin(request, availability.keeping(other for other in others if other.priority > priority))
