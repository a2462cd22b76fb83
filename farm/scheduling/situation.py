"""Input of all scheduling decisions: the state of the farm at a given time. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from farm.scheduling.matching import FleetPrinter, WaitingPlate, choose_spares
from farm.scheduling.plate_queue import PlateQueue
from farm.scheduling.start_rules import StartRules


@dataclass(frozen=True)
class Situation:
    """Data for scheduling decisions: waiting plates, fleet and rules.

    Attributes
    ----------
    waiting_plates
        The plates that may be assigned to a printer, in the order in which they are assigned.
    printers
        The fleet, in any order.
    rules
        Attended and quiet hours, and the limit on printers that heat at the same time.
    now_s
        Farm time, seconds since the epoch.
    time_scale
        Farm seconds per wall second, to convert the duration of computations, which is in wall seconds.
    spares
        Number of free printers that each printing job keeps for parts that fail while nobody is present
        (`--spares`), by the id of the job.
    """

    waiting_plates: PlateQueue
    printers: tuple[FleetPrinter, ...]
    rules: StartRules
    now_s: float
    time_scale: float = 1.0
    spares: Mapping[int, int] = field(default_factory=dict)

    @cached_property
    def fleet(self) -> dict[str, FleetPrinter]:
        """Printers by name, in the order of their names."""
        return {printer.name: printer for printer in sorted(self.printers, key=lambda p: p.name)}

    @cached_property
    def free_printers(self) -> tuple[FleetPrinter, ...]:
        """Idle printers with a clear bed, in the order of their names."""
        return tuple(printer for printer in self.fleet.values() if printer.find_obstacle() is None)

    @cached_property
    def spare_printers(self) -> frozenset[str]:
        """Free printers that are kept for plates that failed elsewhere."""
        if not self.spares or self.rules.is_attended(self.now_s):
            return frozenset()
        return choose_spares(self.printers, self.waiting_plates.planned_printers, max(self.spares.values()))

    def can_start(self, plate: WaitingPlate, printer: FleetPrinter) -> bool:
        """Return whether the rules and the plate's start time allow it to start on a printer now."""
        return self.rules.find_start(plate, printer, self.now_s).at_s == self.now_s

    def find_next_change_s(self) -> float:
        """Return the next time at which the rules allow other plates to start; infinity for never.

        Until then, scheduling the same plates and printers gives the same result.
        """
        starts_s = (at_s for at_s in self.waiting_plates.earliest_starts_s if at_s > self.now_s)
        return min((self.rules.find_next_change_s(self.waiting_plates, self.printers, self.now_s), *starts_s))

    def without(self, plates: Collection[str]) -> Situation:
        """Return the situation without the waiting plates with these ids."""
        return replace(self, waiting_plates=self.waiting_plates.without(plates)) if plates else self

    def with_waiting_plates(self, plates: Iterable[WaitingPlate]) -> Situation:
        """Return the situation with other waiting plates."""
        return replace(self, waiting_plates=PlateQueue.from_plates(plates))

    def with_printers(self, printers: tuple[FleetPrinter, ...]) -> Situation:
        """Return the situation with another fleet."""
        return replace(self, printers=printers)
