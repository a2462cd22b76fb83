"""What is on a printer's reel: said by a person, and less by every print. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from farm.config import Fleet, PrinterSection
from farm.model import Plate, Printer, PrintState, Reel


def used_grams(plate: Plate, state: PrintState, extruded: bool, share: float | None) -> float:
    """What a print that has ended took off its reel: all of it where nobody knows how far it came.

    Parameters
    ----------
    share
        Of its layers' time, how much was printed; None where it is not known.
    """
    if state is PrintState.DONE:
        return plate.grams
    if share is None:
        return plate.grams if extruded or state is PrintState.FAILED else 0.0
    return plate.grams * min(1.0, max(0.0, share)) if extruded else 0.0


def subtract_grams(reel: Reel | None, grams: float) -> Reel | None:
    """The reel after a print."""
    if reel is None or reel.grams is None:
        return reel
    return reel.model_copy(update={"grams": max(0.0, reel.grams - grams)})


def mark_uncertain(reel: Reel | None) -> Reel | None:
    """The reel where prints may have taken of it that nobody knows of."""
    if reel is None or reel.grams is None:
        return reel
    return reel.model_copy(update={"doubted": True})


def section_with_reel(section: PrinterSection, reel: Reel | None) -> PrinterSection:
    """A printer of `fleet.yaml` with what a person has put on it since."""
    if reel is None:
        return section
    has = {"material": reel.material, "colour": reel.colour, "nozzle_mm": reel.nozzle_mm}
    return section.model_copy(update=has)


def fleet_with_reels(fleet: Fleet, printers: Mapping[str, Printer]) -> Fleet:
    """The fleet as it is now."""
    sections = tuple(
        section_with_reel(section, entry.reel if (entry := printers.get(section.name)) is not None else None)
        for section in fleet.printers
    )
    return fleet.model_copy(update={"printers": sections})
