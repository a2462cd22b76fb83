"""Assignment of waiting plates to printers, and a reason for every plate that still waits. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from farm.model import Hold
from farm.scheduling.holds import HoldReasons
from farm.scheduling.matching import WaitingPlate
from farm.scheduling.situation import Situation
from farm.scheduling.start_rules import short_of_filament


@dataclass(frozen=True, slots=True)
class Assignment:
    plate: str
    printer: str


def assign_plates(situation: Situation) -> tuple[list[Assignment], dict[str, Hold]]:
    """Give each waiting plate a printer, or a reason to wait.

    Plates choose by priority, then by order of submission, then the longest first (LPT). A plate
    gets the printer of its plan where that one can take it now; otherwise a matching printer that is idle and
    clear, preferably one that no other waiting plate was planned for, and the lowest. Where all of them are
    taken, an earlier plate is moved to another printer that matches it too (an augmenting path), so that no
    printer is left idle by the order. A plate returns to a printer on which it failed only where no other is
    free. A job that was given a number of printers never prints on more at once.

    Parameters
    ----------
    situation
        Waiting plates, fleet and rules. The order of plates and printers does not change the answer.

    Returns
    -------
    assignments, holds
        Each printer at most once, each plate in exactly one of the two.
    """
    free = sorted((p.name for p in situation.free), key=lambda n: situation.fleet[n].capabilities.height_mm)
    kept = situation.spare_printers()
    matching = _Matching(situation, free, kept)
    limit = situation.rules.max_heating
    heating = sum(printer.heating for printer in situation.printers)
    starts = len(free) if limit is None else max(0, limit - heating)
    places = {plate.job: plate.places for plate in situation.waiting if plate.places is not None}
    left: list[WaitingPlate] = []
    for failed_too in (False, True):
        for plate in left if failed_too else situation.by_priority:
            if len(matching.taken) >= min(starts, len(free)) or places.get(plate.job) == 0:
                left += [] if failed_too else [plate]
            elif matching.place(plate, failed_too):
                if plate.job in places:
                    places[plate.job] -= 1
            elif not failed_too:
                left.append(plate)
    given = {plate.id: name for name, plate in matching.taken.items()}
    full = limit if len(matching.taken) >= starts else None
    reasons = HoldReasons(situation, frozenset(matching.taken), kept, full)
    return (
        [Assignment(plate.id, given[plate.id]) for plate in situation.by_priority if plate.id in given],
        {
            plate.id: reasons.no_place() if places.get(plate.job) == 0 else reasons.find(plate)
            for plate in situation.by_priority
            if plate.id not in given
        },
    )


class _Matching:
    """A bipartite matching of plates and free printers that grows by augmenting paths."""

    def __init__(self, situation: Situation, free: list[str], kept: frozenset[str]) -> None:
        self.taken: dict[str, WaitingPlate] = {}
        self._situation, self._free, self._kept = situation, free, kept
        self._known: dict[str, list[str]] = {}

    def place(self, plate: WaitingPlate, failed_too: bool) -> bool:
        """Find a printer for a plate; with `failed_too`, one on which it failed as well."""
        if failed_too:
            previous = next((n for n in self._free if n not in self.taken and self._can(plate, n)), None)
            if previous is not None:
                self.taken[previous] = plate
            return previous is not None
        return self._augment(plate, set())

    def _augment(self, plate: WaitingPlate, seen: set[str]) -> bool:
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

    def _choices(self, plate: WaitingPlate) -> list[str]:
        """Return the printers that can take a plate now, the best first."""
        if plate.id not in self._known:
            fresh = [n for n in self._free if n not in plate.failed_on] or self._only(plate)
            names = [name for name in fresh if self._can(plate, name)]
            names.sort(
                key=lambda name: (name != plate.planned, name in self._situation.planned)
            )  # stable: the lowest
            self._known[plate.id] = names
        return self._known[plate.id]

    def _only(self, plate: WaitingPlate) -> list[str]:
        """Return all free printers where a plate failed on every one that matches, else none."""
        others = (p for p in self._situation.fleet.values() if p.name not in plate.failed_on)
        return [] if any(plate.requirements.matches(p.capabilities) for p in others) else self._free

    def _can(self, plate: WaitingPlate, name: str) -> bool:
        printer = self._situation.fleet[name]
        return (
            plate.requirements.matches(printer.capabilities)
            and (name not in self._kept or self._situation.takes_spare(plate))
            and short_of_filament(plate, printer, printer.grams) is None
            and self._situation.can_start(plate, printer)
        )
