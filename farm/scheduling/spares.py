"""Free printers that are kept in reserve for failed parts (`--spares`). Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from farm.model import Link
from farm.scheduling.matching import FleetPrinter, WaitingPlate


def choose_spares(
    printers: Iterable[FleetPrinter], planned_printers: Collection[str], spares: int
) -> frozenset[str]:
    """Return the `spares` largest free printers for which no waiting plate was `planned_printers`."""
    free = [p for p in printers if p.name not in planned_printers and p.obstacle() is None]
    free.sort(key=lambda p: (p.capabilities.height_mm, p.name), reverse=True)
    return frozenset(printer.name for printer in free[:spares])


def takes_spare(plate: WaitingPlate, fleet: Mapping[str, FleetPrinter]) -> bool:
    """Return whether a plate may take a spare: it failed elsewhere, or its own printer is out of use."""
    planned_printer = fleet.get(plate.planned)
    if (
        plate.failed_on
        or planned_printer is None
        or not plate.requirements.matches(planned_printer.capabilities)
    ):
        return True
    return (
        planned_printer.maintenance is not None
        or planned_printer.attention_reason is not None
        or planned_printer.link in (Link.ABSENT, Link.FAULT)
    )
