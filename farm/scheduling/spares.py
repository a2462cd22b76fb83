"""Free printers that are kept for what fails (`--spares`). Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from farm.model import Link
from farm.scheduling.situation import PlateView, PrinterView


def spare_printers(printers: Iterable[PrinterView], planned: Collection[str], spares: int) -> frozenset[str]:
    """Of the free printers that no waiting plate was `planned` for, the roomiest."""
    free = [p for p in printers if p.name not in planned and p.obstacle() is None]
    free.sort(key=lambda p: (p.kind.height_mm, p.name), reverse=True)
    return frozenset(printer.name for printer in free[:spares])


def takes_spare(plate: PlateView, fleet: Mapping[str, PrinterView]) -> bool:
    """Whether a plate may have such a printer: it failed elsewhere, or the one of its plan is out of use."""
    own = fleet.get(plate.planned)
    if plate.failed_on or own is None or not plate.need.matches(own.kind):
        return True
    return own.maintenance is not None or own.look is not None or own.link in (Link.ABSENT, Link.FAULT)
