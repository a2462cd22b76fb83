"""Forecast of the prints of all waiting plates, with a lower bound of their end. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from farm.model import Bed, FilamentState, HoldCode, Link
from farm.scheduling.matching import Capabilities, FleetPrinter, WaitingPlate
from farm.scheduling.situation import Situation
from farm.scheduling.situation_builder import describe_plates
from farm.scheduling.start_rules import Start, StartRules, short_of_filament
from farm.state import Books

CLEARING_S = 900.0
"""Time in which a person clears a bed, once somebody is there."""
_COMING = (
    None,
    HoldCode.PRINTER_BUSY,
    HoldCode.BED_NOT_CLEAR,
    HoldCode.FILAMENT_UNKNOWN,
    HoldCode.REEL_UNCERTAIN,
)


@dataclass(frozen=True, slots=True)
class Slot:
    """Time of a plate on a printer, in seconds since the epoch."""

    plate: str
    printer: str
    starts_s: float
    ends_s: float


@dataclass(frozen=True, slots=True)
class Forecast:
    """Slots in order of their start, and the plates that no printer ever takes."""

    slots: tuple[Slot, ...]
    left: tuple[str, ...]
    ends_s: float  # of the last slot; now where there is none
    lower_bound_s: float  # no order of the plates ends sooner

    @property
    def starts_s(self) -> float:
        return min((slot.starts_s for slot in self.slots), default=self.ends_s)


def forecast_prints(situation: Situation, bounded: bool = True) -> Forecast:
    """Forecast the prints of all waiting plates by list scheduling.

    Longest first, each plate goes to the printer where it ends soonest. Between two plates on a printer, a
    person clears its bed. Printers that are away or broken count only where there is no other. At most
    `max_heating` printers heat at once. Where all printers are alike and free, the end is at most 4/3 of the
    least (Graham 1969, LPT), and the least where there are no more plates than printers.

    Parameters
    ----------
    situation
        Waiting plates, fleet and rules. The order of plates and printers does not change the answer.
    bounded
        Compute the lower bound; without it, the bound is now.
    """
    plates, fleet = situation.by_priority, list(situation.fleet.values())
    coming = [p for p in fleet if ((hold := p.obstacle()) and hold.code) in _COMING] or fleet
    schedule = _ListSchedule(coming, situation.rules, situation.now_s)
    candidates = schedule.candidates(plates)
    bound_s = situation.now_s
    if bounded:
        bound_s = _lower_bound_s(plates, candidates, dict(schedule.ready_s), situation.rules, bound_s)
    slots, left = [], []
    for plate in plates:
        slot = schedule.find_slot(plate, candidates[plate.id])
        if slot is None:
            left.append(plate.id)
        else:
            schedule.add(plate, slot)
            slots.append(slot)
    slots.sort(key=lambda slot: (slot.starts_s, slot.printer))
    ends_s = max((slot.ends_s for slot in slots), default=situation.now_s)
    return Forecast(tuple(slots), tuple(left), ends_s, min(bound_s, ends_s))


class _ListSchedule:
    """Printers with the prints that a forecast has given them so far.

    Attributes
    ----------
    ready_s
        When each printer is idle and its bed clear, in seconds since the epoch, by name.
    """

    def __init__(self, printers: Sequence[FleetPrinter], rules: StartRules, now_s: float) -> None:
        self.ready_s = {p.name: _ready_s(p, rules, now_s) for p in printers}
        self._printers, self._rules = printers, rules
        self._grams = {p.name: p.grams for p in printers}
        self._heating: list[tuple[float, float]] = []

    def candidates(self, plates: Iterable[WaitingPlate]) -> dict[str, list[FleetPrinter]]:
        """Return the printers that match each plate and have enough on their reels, by the plate's id."""
        classes: dict[Capabilities, list[FleetPrinter]] = {}
        for printer in self._printers:
            classes.setdefault(printer.capabilities, []).append(printer)
        return {
            plate.id: [
                printer
                for capabilities, printers in classes.items()
                if plate.requirements.matches(capabilities)
                for printer in printers
                if self._has_filament(plate, printer)
            ]
            for plate in plates
        }

    def find_slot(self, plate: WaitingPlate, candidates: Iterable[FleetPrinter]) -> Slot | None:
        """Return the slot in which a plate ends soonest, preferably on its planned printer; else None."""
        best = (math.inf, True, "", 0.0)
        earliest = sorted((self.ready_s[p.name] + seconds_on(plate, p), p.name, p) for p in candidates)
        for least_s, name, printer in earliest:
            if least_s > best[0]:
                break  # no later one ends sooner
            if not self._has_filament(plate, printer):
                continue
            start_s = _start_s(plate, printer, self.ready_s[name], self._rules, self._heating)
            if start_s is not None:
                best = min(best, (start_s + seconds_on(plate, printer), name != plate.planned, name, start_s))
        end_s, _, name, start_s = best
        return Slot(plate.id, name, start_s, end_s) if name else None

    def add(self, plate: WaitingPlate, slot: Slot) -> None:
        """Add a slot to the schedule: its printer is busy until its bed is clear, its reel has less."""
        self._heating.append((slot.starts_s, slot.starts_s + plate.heating_s))
        self.ready_s[slot.printer] = self._rules.bed_clear_s(slot.ends_s, CLEARING_S)
        grams = self._grams[slot.printer]
        self._grams[slot.printer] = None if grams is None else grams - plate.grams

    def _has_filament(self, plate: WaitingPlate, printer: FleetPrinter) -> bool:
        return short_of_filament(plate, printer, self._grams[printer.name]) is None


def as_idle(printer: FleetPrinter) -> FleetPrinter:
    """Return a printer as if it were idle and clear, for the duration of a plan instead of its start."""
    return replace(
        printer,
        bed=Bed.CLEAR,
        filament=FilamentState.PARKED,
        link=Link.READY,
        booked=False,
        attention_reason=None,
        maintenance=None,
        reel_uncertain=False,
    )


def seconds_on(plate: WaitingPlate, printer: FleetPrinter) -> float:
    """Return the seconds that a plate takes on a printer, by the learned time factors of both printers."""
    layers_s = plate.expected_s - plate.heating_s
    return plate.heating_s + layers_s * printer.time_factor / plate.time_factor


def _ready_s(printer: FleetPrinter, rules: StartRules, now_s: float) -> float:
    """Return when a printer is idle and clear."""
    if printer.obstacle() is None:
        return now_s
    return rules.bed_clear_s(max(now_s, printer.free_s or now_s), CLEARING_S)


def _start_s(
    plate: WaitingPlate,
    printer: FleetPrinter,
    from_s: float,
    rules: StartRules,
    heating: Sequence[tuple[float, float]],
) -> float | None:
    """Return the first moment when hours and the heating limit let a plate start on a printer."""
    while True:
        start: Start = rules.find_start(plate, printer, from_s)
        if start.at_s is None or rules.max_heating is None:
            return start.at_s
        at_s = start.at_s
        ends = sorted(end for begin, end in heating if begin < at_s + plate.heating_s and end > at_s)
        if len(ends) < rules.max_heating:
            return at_s
        from_s = ends[len(ends) - rules.max_heating]


def _lower_bound_s(
    plates: Sequence[WaitingPlate],
    can: Mapping[str, Sequence[FleetPrinter]],
    ready_s: Mapping[str, float],
    rules: StartRules,
    now_s: float,
) -> float:
    """Return an end that no schedule on these printers can beat, in seconds since the epoch.

    The greatest of: the end of each plate alone on its best printer; and, for the plates that can go to some
    set of printers only, the end of all their seconds spread evenly over that set as its printers get ready.
    """
    bound_s = now_s
    work_s: dict[frozenset[str], float] = {}
    for plate in plates:
        if not can[plate.id]:
            continue
        starts = [(p, rules.find_start(plate, p, ready_s[p.name]).at_s) for p in can[plate.id]]
        ends = [at_s + seconds_on(plate, p) for p, at_s in starts if at_s is not None]
        if not ends:
            continue
        bound_s = max(bound_s, min(ends))
        names = frozenset(p.name for p in can[plate.id])
        work_s[names] = work_s.get(names, 0.0) + min(seconds_on(plate, p) for p in can[plate.id])
    for names in work_s:
        total_s = sum(seconds for some, seconds in work_s.items() if some <= names)
        bound_s = max(bound_s, _filled_s(total_s, sorted(ready_s[name] for name in names)))
    return bound_s


def _filled_s(work_s: float, ready: Sequence[float]) -> float:
    """Return the end of so much work on machines that are ready at these moments, in ascending order."""
    level_s = ready[0]
    for count, following in enumerate([*ready[1:], float("inf")], 1):
        room_s = (following - level_s) * count
        if work_s <= room_s:
            return level_s + work_s / count
        work_s -= room_s
        level_s = following
    raise AssertionError("the last machine takes whatever is left")


_KEPT_S = 60.0  # farm seconds for which a forecast of unchanged books is kept
_APART_S = 5.0  # wall seconds between forecasts: 300 plates on 100 printers take a third of one


class ForecastCache:
    """Forecasts the ends of all waiting plates, at most every few wall seconds.

    Parameters
    ----------
    rules
        Hours and the heating limit.
    scale
        Farm seconds in a wall second.
    """

    def __init__(self, rules: StartRules, scale: float) -> None:
        self._rules, self._apart_s = rules, _APART_S * scale
        self._books: Books | None = None
        self._at_s = float("-inf")
        self._ends_s: Mapping[str, float] = {}

    def clock_set(self) -> None:
        """Drop the forecast after a step of the host's clock, as hours have shifted."""
        self._at_s = float("-inf")

    def ends_s(
        self, books: Books, printers: Callable[[], Sequence[FleetPrinter]], now_s: float
    ) -> Mapping[str, float]:
        """Return when each waiting plate that a printer can take ends, in seconds since the epoch."""
        old_s = now_s - self._at_s
        if old_s > self._apart_s and (books is not self._books or old_s > _KEPT_S):
            waiting = tuple(describe_plates(books.waiting_plates(), books))
            situation = Situation(waiting, tuple(printers()) if waiting else (), self._rules, now_s)
            slots = forecast_prints(situation, bounded=False).slots if waiting else ()
            self._books, self._at_s = books, now_s
            self._ends_s = {slot.plate: slot.ends_s for slot in slots}
        return self._ends_s
