"""Forecast of the printer and the time of each waiting plate, with a lower bound on the end. Pure."""

from __future__ import annotations

import heapq
import itertools
import math
from collections import Counter
from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from farm.model import Bed, FilamentState, Link
from farm.scheduling.matching import (
    TEMPORARY_CODES,
    Capabilities,
    FleetPrinter,
    WaitingPlate,
    choose_spares,
)
from farm.scheduling.plate_matching import FleetOrder, MatchingInputs, match_plates
from farm.scheduling.situation import Situation
from farm.scheduling.start_rules import StartRules, find_filament_shortage

CLEARING_TIME_S = 900.0
"""Time that a person needs to clear a bed."""
_CHANGES_PER_STEP = 400  # they take about 5 ms
_HORIZON_S = 15 * 86400.0  # if no plate starts within this time, no plate ever will
_PRINT_END, _HEATING_END, _CLEARING_END, _JOB_START = range(4)
"""Kinds of change; simultaneous changes are handled in this order."""


@dataclass(frozen=True, slots=True)
class Slot:
    """Start and end of a plate on a printer, in seconds since the epoch."""

    plate: str
    printer: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Forecast:
    """Slots in order of their start, and the plates that can never be printed."""

    slots: tuple[Slot, ...]
    unprintable_plates: tuple[str, ...]
    end_s: float  # end of the last slot; the current time if there is none
    lower_bound_s: float  # lower bound on the end, for any assignment and order of the plates

    @property
    def start_s(self) -> float:
        """Start of the first slot; the current time if there is none."""
        return min((slot.start_s for slot in self.slots), default=self.end_s)


def forecast_prints(situation: Situation, include_bound: bool = True) -> Forecast:
    """Forecast the prints of all waiting plates by simulating the farm's decisions.

    Plates are matched with printers as by `assign_plates` whenever a printer becomes free or has heated up, a
    job may use another printer, or attended or quiet hours begin or end. Between two
    plates on a printer, a person must be present to clear its bed. Absent or broken printers are used only if
    there are no others. If all printers are alike and free, a job takes at most 4/3 of the shortest possible
    time (Graham 1969, LPT), plus the few seconds by which the order of gluing may change the order of plates
    (`TIME_TOLERANCE_S`); with at least as many printers as plates, it ends with its longest plate.

    Parameters
    ----------
    situation
        Waiting plates, fleet and rules. The result does not depend on the order of plates and printers.
    include_bound
        True to compute the lower bound; if False, it is the current time.
    """
    steps = forecast_in_steps(situation, include_bound)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            forecast: Forecast = end.value
            return forecast


def forecast_in_steps(situation: Situation, include_bound: bool = True) -> Generator[None, None, Forecast]:
    """Forecast the prints of all waiting plates, as `forecast_prints` does, in short steps.

    The generator yields after each step, and returns the forecast.
    """
    rules, now_s = situation.rules, situation.now_s
    fleet = list(situation.fleet.values())
    usable_printers = [
        p for p in fleet if (hold := p.find_obstacle()) is None or hold.code in TEMPORARY_CODES
    ] or fleet
    simulation = _Simulation(situation, usable_printers)
    yield from simulation.run()
    slots = sorted(simulation.slots, key=lambda slot: (slot.start_s, slot.printer))
    unplaced_plates = tuple(plate.id for plates in simulation.queue.values() for plate in plates.values())
    end_s = max((slot.end_s for slot in slots), default=now_s)
    bound_s = now_s
    if include_bound:
        started_plates = {slot.plate for slot in slots}
        plates = [plate for plate in situation.waiting_plates if plate.id in started_plates]
        ready_times_s = {p.name: _find_ready_time_s(p, rules, now_s) for p in usable_printers}
        bound_s = _compute_lower_bound_s(
            plates, _find_fitting_printers(plates, usable_printers), ready_times_s, rules, now_s
        )
    return Forecast(tuple(slots), unplaced_plates, end_s, min(bound_s, end_s))


class _Simulation:
    """Simulation of the farm from now on, from one change to the next, without failures.

    Free printers that get no plate are blocked: no waiting plate can start on them before attended or quiet
    hours begin or end, or a job may use more printers.
    """

    def __init__(self, situation: Situation, usable_printers: Sequence[FleetPrinter]) -> None:
        self.slots: list[Slot] = []
        self.queue = {job.queue_rank: {p.id: p for p in job.plates} for job in situation.waiting_plates.jobs}
        self._rules, self._now_s, self._spares = situation.rules, situation.now_s, dict(situation.spares)
        # Number of plates to print by job, including those being printed.
        self._remaining_plates = Counter(plate.job for plate in situation.waiting_plates)
        self._fleet = {printer.name: make_idle_printer(printer) for printer in usable_printers}
        self._order = FleetOrder.from_printers(self._fleet.values())
        self._planned_plates = Counter(plate.planned_printer for plate in situation.waiting_plates)
        self._extra_printer_counts = situation.waiting_plates.extra_printer_counts
        self._heating_count = 0
        self._idle: set[str] = set()
        self._blocked_printers: set[str] = set()
        self._changes: list[tuple[float, int, str, object]] = []
        for printer in usable_printers:
            # A printer that matches no plate starts none, but may be kept as a spare.
            is_used = self._spares or any(map(printer.capabilities.meets, situation.waiting_plates.demands))
            self._add_printer(printer, bool(is_used))
        for at_s in situation.waiting_plates.earliest_starts_s:
            self._push_change(at_s, _JOB_START, "")

    def _add_printer(self, printer: FleetPrinter, is_used: bool) -> None:
        now_s = self._now_s
        if printer.is_booked:
            self._remaining_plates.update([printer.job] if printer.job is not None else [])
            self._push_change(max(now_s, printer.print_end_s or now_s), _PRINT_END, printer.job)
        if printer.is_heating:
            self._heating_count += 1
            self._push_change(max(now_s, printer.heating_end_s or now_s), _HEATING_END, printer.name)
        if not is_used:
            return
        ready_s = _find_ready_time_s(printer, self._rules, now_s)
        if ready_s <= now_s:
            self._idle.add(printer.name)
        else:
            self._push_change(ready_s, _CLEARING_END, printer.name)

    def _push_change(self, at_s: float, kind: int, subject: object) -> None:
        if at_s >= self._now_s:
            heapq.heappush(self._changes, (at_s, kind, str(subject), subject))

    def run(self) -> Generator[None, None, None]:
        """Simulate until no plate waits, or no waiting plate can ever start; yield every few changes."""
        self._match_plates()
        edge_s, deadline_s = self._find_next_edge_s(), self._now_s + _HORIZON_S
        for number in itertools.count(1):
            if not self.queue:
                return
            if not number % _CHANGES_PER_STEP:
                yield
            change_s = self._changes[0][0] if self._changes else math.inf
            if edge_s <= change_s:
                if edge_s > deadline_s:
                    return
                self._now_s = edge_s
                self._blocked_printers.clear()
                edge_s = self._find_next_edge_s()
                if change_s == self._now_s:
                    continue  # handle the change first: when a print ends, its job may use another printer
            elif change_s == math.inf:
                return
            else:
                self._now_s, kind, _, subject = heapq.heappop(self._changes)
                self._apply_change(kind, subject)
            if self._match_plates():
                deadline_s = self._now_s + _HORIZON_S

    def _find_next_edge_s(self) -> float:
        edges = (
            self._rules.attended_hours.find_next_edge_s(self._now_s),
            self._rules.quiet_hours.find_next_edge_s(self._now_s),
        )
        return min((edge_s for edge_s in edges if edge_s is not None), default=math.inf)

    def _apply_change(self, kind: int, subject: object) -> None:
        if kind == _CLEARING_END:
            self._idle.add(str(subject))
        elif kind == _HEATING_END:
            self._heating_count -= 1
        elif kind == _PRINT_END and isinstance(subject, int):
            self._end_print(subject)
        elif kind == _JOB_START:
            self._blocked_printers.clear()

    def _end_print(self, job: int) -> None:
        self._remaining_plates[job] -= 1
        if not self._remaining_plates[job] and self._spares.pop(job, 0):
            self._blocked_printers.clear()
        if job in self._extra_printer_counts:
            self._extra_printer_counts[job] += 1
            self._blocked_printers.clear()

    def _match_plates(self) -> bool:
        """Start the plates that can start now; return whether there were any."""
        if self._spares:
            self._blocked_printers.clear()  # the spares depend on the waiting plates
        free = self._idle - self._blocked_printers
        max_heating = self._rules.max_heating
        start_limit = len(free) if max_heating is None else max(0, max_heating - self._heating_count)
        if not free or not start_limit:
            return False
        planned_printers = self._planned_plates.keys()
        inputs = MatchingInputs(
            fleet=self._fleet,
            free_printers=free,
            order=self._order,
            planned_printers=planned_printers,
            spare_printers=self._choose_spare_printers(planned_printers),
            extra_printer_counts=self._extra_printer_counts,
            start_limit=start_limit,
            rules=self._rules,
            now_s=self._now_s,
        )
        plate_by_printer = match_plates(
            ((rank, plates.values()) for rank, plates in self.queue.items()), inputs
        )
        for name, plate in plate_by_printer.items():
            self._start_print(plate, name)
        if len(plate_by_printer) < start_limit:
            self._blocked_printers |= free - plate_by_printer.keys()
        return bool(plate_by_printer)

    def _choose_spare_printers(self, planned_printers: Collection[str]) -> frozenset[str]:
        if not self._spares or self._rules.is_attended(self._now_s):
            return frozenset()
        spare_count = max(self._spares.values())
        return choose_spares((self._fleet[name] for name in self._idle), planned_printers, spare_count)

    def _start_print(self, plate: WaitingPlate, name: str) -> None:
        printer = self._fleet[name]
        end_s = self._now_s + compute_printing_s(plate, printer)
        self.slots.append(Slot(plate.id, name, self._now_s, end_s))
        self._idle.discard(name)
        if printer.grams is not None:
            self._fleet[name] = replace(printer, grams=printer.grams - plate.grams)
        self._heating_count += 1
        self._push_change(self._now_s + plate.overhead_s, _HEATING_END, name)
        self._push_change(end_s, _PRINT_END, plate.job)
        self._push_change(self._rules.find_clearing_end_s(end_s, CLEARING_TIME_S), _CLEARING_END, name)
        if plate.job in self._extra_printer_counts:
            self._extra_printer_counts[plate.job] -= 1
        self._planned_plates[plate.planned_printer] -= 1
        if not self._planned_plates[plate.planned_printer]:
            del self._planned_plates[plate.planned_printer]
        plates = self.queue[plate.queue_rank]
        del plates[plate.id]
        if not plates:
            del self.queue[plate.queue_rank]


def make_idle_printer(printer: FleetPrinter) -> FleetPrinter:
    """Return a printer as if it were idle with a clear bed, for the simulation."""
    return replace(
        printer,
        bed=Bed.CLEAR,
        filament=FilamentState.PARKED,
        link=Link.READY,
        is_booked=False,
        attention_reason=None,
        maintenance=None,
        is_reel_uncertain=False,
    )


def compute_printing_s(plate: WaitingPlate, printer: FleetPrinter) -> float:
    """Compute the printing time of a plate on a printer from its expected time on the planned printer."""
    layers_s = plate.expected_s - plate.overhead_s
    factor = printer.time_factors.compute_factor(plate.feature_shares)
    return plate.overhead_s + layers_s * factor / plate.time_factor


def _find_ready_time_s(printer: FleetPrinter, rules: StartRules, now_s: float) -> float:
    """Return the time at which a printer will be idle with a clear bed."""
    if printer.find_obstacle() is None:
        return now_s
    return rules.find_clearing_end_s(max(now_s, printer.print_end_s or now_s), CLEARING_TIME_S)


def _find_fitting_printers(
    plates: Iterable[WaitingPlate], printers: Iterable[FleetPrinter]
) -> dict[str, list[FleetPrinter]]:
    """Return the printers that match each plate and have enough filament for it."""
    kinds: dict[Capabilities, list[FleetPrinter]] = {}
    for printer in printers:
        kinds.setdefault(printer.capabilities, []).append(printer)
    return {
        plate.id: [
            printer
            for kind, kind_printers in kinds.items()
            if plate.requirements.matches(kind)
            for printer in kind_printers
            if find_filament_shortage(plate, printer) is None
        ]
        for plate in plates
    }


def _compute_lower_bound_s(
    plates: Sequence[WaitingPlate],
    fitting_printers: Mapping[str, Sequence[FleetPrinter]],
    ready_times_s: Mapping[str, float],
    rules: StartRules,
    now_s: float,
) -> float:
    """Return a lower bound on the end of any schedule on these printers.

    It is the largest of these bounds: the end of each plate on the printer on which it ends soonest; and, for
    each set of printers, the time at which they end if the plates that fit no other printer are divided
    evenly among them.
    """
    bound_s = now_s
    work_s: dict[frozenset[str], float] = {}
    for plate in plates:
        if not fitting_printers[plate.id]:
            continue
        starts = [
            (p, rules.find_start(plate, p, ready_times_s[p.name]).at_s) for p in fitting_printers[plate.id]
        ]
        ends_s = [at_s + compute_printing_s(plate, p) for p, at_s in starts if at_s is not None]
        if not ends_s:
            continue
        bound_s = max(bound_s, min(ends_s))
        names = frozenset(p.name for p in fitting_printers[plate.id])
        work_s[names] = work_s.get(names, 0.0) + min(
            compute_printing_s(plate, p) for p in fitting_printers[plate.id]
        )
    for names in work_s:
        total_s = sum(seconds for subset, seconds in work_s.items() if subset <= names)
        bound_s = max(bound_s, _compute_completion_s(total_s, sorted(ready_times_s[name] for name in names)))
    return bound_s


def _compute_completion_s(work_s: float, ready_times_s: Sequence[float]) -> float:
    """Return the time at which printers, ready at these ascending times, finish an amount of work."""
    level_s = ready_times_s[0]
    for count, next_s in enumerate([*ready_times_s[1:], float("inf")], 1):
        capacity_s = (next_s - level_s) * count
        if work_s <= capacity_s:
            return level_s + work_s / count
        work_s -= capacity_s
        level_s = next_s
    raise AssertionError("the last printer takes the remaining work")
