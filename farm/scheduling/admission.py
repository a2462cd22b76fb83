"""Whether the job in front can begin now, and with which printers. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from farm.model import Hold, HoldCode, Link
from farm.scheduling.situation import Need, PrinterView

_PASSING = (
    HoldCode.PRINTER_BUSY,
    HoldCode.BED_NOT_CLEAR,
    HoldCode.FILAMENT_UNKNOWN,
    HoldCode.REEL_DOUBTED,
)


@dataclass(frozen=True, slots=True)
class Begin:
    """Plan the job for these printers, in as many rounds."""

    printers: tuple[str, ...]
    rounds: int = 1


def unmatched(need: Need, printers: Iterable[PrinterView]) -> Hold | None:
    """Why a job waits for nobody: since it was submitted, `fleet.yaml` may have changed."""
    if any(need.matches(printer.kind) for printer in printers):
        return None
    return Hold(
        code=HoldCode.NO_SUCH_PRINTER,
        text="no printer of the fleet matches this job: change fleet.yaml, or cancel it",
    )


def begin(
    need: Need,
    wanted: int | None,
    least: int,
    printers: Iterable[PrinterView],
    taken: frozenset[str],
    patient: bool,
    spares: int = 0,
    later: bool = False,
    asleep: frozenset[str] = frozenset(),
) -> Begin | Hold:
    """The printers that the job in front takes.

    It takes all that match and are idle and clear, or as many as it was given, once they can hold it in one
    round; where even the whole fleet cannot, the idle ones with further rounds.

    Parameters
    ----------
    need
        What the job asks of a printer.
    wanted
        How many printers a person gave it; None for all.
    least
        How many parts an earlier attempt has shown to be needed; 0 where nothing is known.
    printers
        The fleet, of which one at least matches.
    taken
        Printers that waiting plates of earlier jobs will get.
    patient
        Wait for printers that are still connecting: true while the farm has just started.
    spares
        How many of the free printers it leaves, as long as it has one.
    later
        Nothing of it is printed yet (it waits for a person's approval): printers that print now count too.
        Nobody knows when it is approved, and what is then in front of it: it is planned for all of them, and
        where others have them then, it waits.
    asleep
        Printers on which nothing may start at this hour: they are taken only where there is no other.
    """
    matching = sorted((p for p in printers if need.matches(p.kind)), key=lambda p: p.name)
    arriving = [p.name for p in matching if p.link in (Link.STARTING, Link.CONNECTING) and not p.booked]
    if arriving and patient:
        return Hold(code=HoldCode.PRINTER_CONNECTING, text=f"connecting to {' '.join(arriving)}")
    # A printer that is away or broken may never come back: it is not waited for.
    coming = [p for p in matching if (hold := p.obstacle()) is None or hold.code in _PASSING]
    if not later:
        coming = [p for p in coming if p.name not in asleep] or coming
    idle = coming if later else [p for p in coming if p.obstacle() is None and p.name not in taken]
    if not idle:
        obstacles = [obstacle for p in matching if (obstacle := p.obstacle()) is not None]
        if not obstacles:
            return Hold(code=HoldCode.PRINTER_BUSY, text="every matching printer has a plate waiting")
        # What ends by itself is waited for; a person is asked only where nothing does.
        busy = [hold for hold in obstacles if hold.code is HoldCode.PRINTER_BUSY]
        full = [p.name for p in matching if (h := p.obstacle()) and h.code is HoldCode.BED_NOT_CLEAR]
        if busy and full:
            sooner = f"`farm cleared {full[0]}` would let it begin now, if that bed is clear"
            return Hold(code=HoldCode.PRINTER_BUSY, text=f"{busy[0].text}; {sooner}")
        return (busy or obstacles)[0]
    given = min(max(1, len(idle) - spares), wanted or len(idle))
    ceiling = min(max(1, len(coming) - spares), wanted or len(coming))
    if least > given:
        if least <= ceiling:
            text = f"it needs {least} printers in one round, {given} of {ceiling} are idle and clear"
            return Hold(code=HoldCode.TOO_FEW_PRINTERS, text=text)
        return Begin(tuple(p.name for p in idle[:given]), rounds=-(-least // given))
    # The roomiest first: a person who gives two printers gives the best two.
    idle.sort(key=lambda p: (-p.kind.height_mm, p.name))
    return Begin(tuple(sorted(p.name for p in idle[:given])))


def begin_beside(
    priority: int,
    promised: Iterable[tuple[int, frozenset[str]]],
    answer: Callable[[frozenset[str]], Begin | Hold],
) -> Begin | Hold:
    """The answer for a job beside others that are being planned.

    Those keep their printers from jobs of less priority, and from others while there are more.

    Parameters
    ----------
    promised
        The priorities of the jobs that are being planned, and their printers.
    answer
        What `begin` says without these printers.
    """
    others = list(promised)
    first = answer(frozenset().union(*(names for _, names in others)))
    if isinstance(first, Begin):
        return first
    return answer(frozenset().union(*(names for above, names in others if above > priority)))
