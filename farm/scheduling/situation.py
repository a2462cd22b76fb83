"""State of the farm at one moment, as the scheduler sees it. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

from farm.model import Link
from farm.scheduling.matching import FleetPrinter, WaitingPlate
from farm.scheduling.start_rules import StartRules


@dataclass(frozen=True)
class Situation:
    """All data for scheduling decisions: waiting plates, fleet and rules.

    Attributes
    ----------
    waiting
        The plates that may go to a printer, in any order.
    printers
        The fleet, in any order.
    rules
        Hours, and how many printers may heat at once.
    now_s
        Farm time, seconds since the epoch.
    time_scale
        Farm seconds in a wall second; work in the daemon's own processes takes wall seconds.
    spares
        Free printers that are kept for plates that failed elsewhere (`--spares`).
    """

    waiting: tuple[WaitingPlate, ...]
    printers: tuple[FleetPrinter, ...]
    rules: StartRules
    now_s: float
    time_scale: float = 1.0
    spares: int = 0

    @cached_property
    def fleet(self) -> dict[str, FleetPrinter]:
        """Return the printers by name, in the order of their names."""
        return {printer.name: printer for printer in sorted(self.printers, key=lambda p: p.name)}

    @cached_property
    def by_priority(self) -> tuple[WaitingPlate, ...]:
        """Return the waiting plates in the order in which they choose."""
        return tuple(sorted(self.waiting, key=lambda plate: plate.priority_key))

    @cached_property
    def planned(self) -> frozenset[str]:
        """Return the printers that the waiting plates were planned for."""
        return frozenset(plate.planned for plate in self.waiting)

    @cached_property
    def free(self) -> tuple[FleetPrinter, ...]:
        """Return the printers that are idle and clear, by name."""
        return tuple(printer for printer in self.fleet.values() if printer.obstacle() is None)

    def spare_printers(self, planned: Collection[str] | None = None) -> frozenset[str]:
        """Return the free printers that are kept for plates that failed elsewhere: the largest.

        Parameters
        ----------
        planned
            Printers that plates were planned for, which are not kept; None for those of the waiting plates.
        """
        planned = self.planned if planned is None else planned
        free = [printer for printer in self.free if printer.name not in planned]
        free.sort(key=lambda p: (p.capabilities.height_mm, p.name), reverse=True)
        return frozenset(printer.name for printer in free[: self.spares])

    def takes_spare(self, plate: WaitingPlate) -> bool:
        """Return whether a plate may take a spare: it failed elsewhere, or its own printer is out of use."""
        own = self.fleet.get(plate.planned)
        if plate.failed_on or own is None or not plate.requirements.matches(own.capabilities):
            return True
        return (
            own.maintenance is not None
            or own.attention_reason is not None
            or own.link in (Link.ABSENT, Link.FAULT)
        )

    def can_start(self, plate: WaitingPlate, printer: FleetPrinter) -> bool:
        """Return whether hours and start times let a plate start on a printer now."""
        return self.rules.find_start(plate, printer, self.now_s).at_s == self.now_s

    def next_change_s(self) -> float:
        """Return the next moment at which time alone changes a decision or its reason; infinity for never.

        Until then, scheduling the same plates and printers gives the same answer: hours and start times
        change at the moments of `StartRules.next_change_s`, and reasons name the end of a print while it is
        still to come.
        """
        ends_s = (p.free_s for p in self.printers if p.free_s is not None and p.free_s > self.now_s)
        return min(self.rules.next_change_s(self.waiting, self.printers, self.now_s), *ends_s, math.inf)

    def with_waiting(self, waiting: tuple[WaitingPlate, ...]) -> Situation:
        """Return the same moment with other plates that wait."""
        return replace(self, waiting=waiting)

    def with_printers(self, printers: tuple[FleetPrinter, ...]) -> Situation:
        """Return the same moment with another fleet."""
        return replace(self, printers=printers)
