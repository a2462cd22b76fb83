"""Filament on a printer's reel: loaded by a person, used by every print. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from farm.config import Fleet, PrinterSection
from farm.model import Plate, Printer, PrintState, Reel


def used_grams(plate: Plate, state: PrintState, extruded: bool, share: float | None) -> float:
    """Compute the grams that an ended print used: all of its plate's where its progress is not known.

    Parameters
    ----------
    share
        Printed share of its layers' time, 0 to 1; None where it is not known.
    """
    if state is PrintState.DONE:
        return plate.grams
    if share is None:
        return plate.grams if extruded or state is PrintState.FAILED else 0.0
    return plate.grams * min(1.0, max(0.0, share)) if extruded else 0.0


def subtract_grams(reel: Reel | None, grams: float) -> Reel | None:
    """Return the reel with so much less on it, and never less than nothing."""
    if reel is None or reel.grams is None:
        return reel
    return reel.model_copy(update={"grams": max(0.0, reel.grams - grams)})


def mark_uncertain(reel: Reel | None) -> Reel | None:
    """Return the reel where prints may have used some of it that are not known."""
    if reel is None or reel.grams is None:
        return reel
    return reel.model_copy(update={"uncertain": True})


def section_with_reel(section: PrinterSection, reel: Reel | None) -> PrinterSection:
    """Return a printer of `fleet.yaml` with the reel that a person has loaded since."""
    if reel is None:
        return section
    has = {"material": reel.material, "colour": reel.colour, "nozzle_mm": reel.nozzle_mm}
    return section.model_copy(update=has)


def fleet_with_reels(fleet: Fleet, printers: Mapping[str, Printer]) -> Fleet:
    """Return the fleet with the reels that are loaded now."""
    sections = tuple(
        section_with_reel(section, entry.reel if (entry := printers.get(section.name)) is not None else None)
        for section in fleet.printers
    )
    return fleet.model_copy(update={"printers": sections})
