"""Which plate goes to which printer now, and why every other plate waits. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from farm.model import Hold
from farm.scheduling.hold_reasons import Reasons
from farm.scheduling.situation import PlateView, PrinterView
from farm.scheduling.spares import spare_printers, takes_spare
from farm.scheduling.start_rules import Rules, short_of_filament


@dataclass(frozen=True, slots=True)
class Assignment:
    plate: str
    printer: str


def assign(
    plates: Iterable[PlateView],
    printers: Iterable[PrinterView],
    rules: Rules,
    now_s: float,
    spares: int = 0,
) -> tuple[list[Assignment], dict[str, Hold]]:
    """Give each waiting plate a printer, or a reason.

    Plates have their turn by priority, then by order of submission, then the longest first (LPT). A plate
    keeps the printer of its plan while that one can take it now; otherwise it goes to any matching printer
    that is idle and clear, rather to one that no other waiting plate was planned for, and to the lowest. A
    plate that finds every such printer taken moves an earlier one to another that will do as well (an
    augmenting path), so that no printer is idle for want of a better order. A plate goes back to a printer on
    which it failed only where no other is free. A job that was given a number of printers never prints on
    more of them at once.

    Parameters
    ----------
    plates, printers
        What waits, and the fleet, in any order: the answer is the same.
    rules
        The house's: hours and the breaker.
    now_s
        Farm time.
    spares
        How many free printers are kept for plates that failed elsewhere (`--spares`).

    Returns
    -------
    assignments, holds
        Each printer at most once, each plate in exactly one of the two.
    """
    fleet = {printer.name: printer for printer in sorted(printers, key=lambda p: p.name)}
    turns = sorted(plates, key=lambda plate: plate.turn)
    free = [name for name, printer in fleet.items() if printer.obstacle() is None]
    free.sort(key=lambda name: (fleet[name].kind.height_mm, name))
    planned = frozenset(plate.planned for plate in turns)
    kept = spare_printers(fleet.values(), planned, spares)
    heating = sum(printer.heating for printer in fleet.values())
    matching = _Matching(fleet, free, kept, rules, now_s, planned)
    starts = len(free) if rules.max_heating is None else max(0, rules.max_heating - heating)
    places = {plate.job: plate.places for plate in turns if plate.places is not None}
    left: list[PlateView] = []
    for again in (False, True):
        for plate in left if again else turns:
            if len(matching.taken) >= min(starts, len(free)) or places.get(plate.job) == 0:
                left += [] if again else [plate]
            elif matching.place(plate, again):
                if plate.job in places:
                    places[plate.job] -= 1
            elif not again:
                left.append(plate)
    given = {plate.id: name for name, plate in matching.taken.items()}
    full = rules.max_heating if len(matching.taken) >= starts else None
    reasons = Reasons(fleet, frozenset(matching.taken), kept, rules, now_s, full)
    return (
        [Assignment(plate.id, given[plate.id]) for plate in turns if plate.id in given],
        {
            plate.id: reasons.no_place() if places.get(plate.job) == 0 else reasons.why(plate)
            for plate in turns
            if plate.id not in given
        },
    )


class _Matching:
    """A bipartite matching of plates and free printers that grows by augmenting paths."""

    def __init__(
        self,
        fleet: dict[str, PrinterView],
        free: list[str],
        kept: frozenset[str],
        rules: Rules,
        now_s: float,
        planned: frozenset[str],
    ) -> None:
        self.taken: dict[str, PlateView] = {}
        self._fleet, self._free, self._kept = fleet, free, kept
        self._rules, self._now_s, self._planned = rules, now_s, planned
        self._known: dict[str, list[str]] = {}

    def place(self, plate: PlateView, again: bool) -> bool:
        """Find a printer for a plate; `again`: also one on which it failed."""
        if again:
            back = next((n for n in self._free if n not in self.taken and self._can(plate, n)), None)
            if back is not None:
                self.taken[back] = plate
            return back is not None
        return self._augment(plate, set())

    def _augment(self, plate: PlateView, seen: set[str]) -> bool:
        choices = [name for name in self._choices(plate) if name not in seen]
        for name in choices:
            if name not in self.taken:
                self.taken[name] = plate
                return True
        for name in choices:
            if name not in seen:
                seen.add(name)
                if self._augment(self.taken[name], seen):
                    self.taken[name] = plate
                    return True
        return False

    def _choices(self, plate: PlateView) -> list[str]:
        """The printers that can take it now, the best first."""
        if plate.id not in self._known:
            fresh = [n for n in self._free if n not in plate.failed_on] or self._only(plate)
            names = [name for name in fresh if self._can(plate, name)]
            names.sort(key=lambda name: (name != plate.planned, name in self._planned))  # stable: the lowest
            self._known[plate.id] = names
        return self._known[plate.id]

    def _only(self, plate: PlateView) -> list[str]:
        """Where it failed on every printer that matches there is nothing better to wait for."""
        others = (p for p in self._fleet.values() if p.name not in plate.failed_on)
        return [] if any(plate.need.matches(p.kind) for p in others) else self._free

    def _can(self, plate: PlateView, name: str) -> bool:
        printer = self._fleet[name]
        return (
            plate.need.matches(printer.kind)
            and (name not in self._kept or takes_spare(plate, self._fleet))
            and short_of_filament(plate, printer, printer.grams) is None
            and self._rules.start(plate, printer, self._now_s).at_s == self._now_s
        )
