"""Filament on a printer's reel: loaded by a person, used by every print. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from farm.config import Fleet, PrinterSection
from farm.model import Plate, Printer, PrintState, Reel


def compute_used_grams(
    plate: Plate, state: PrintState, has_extruded: bool, printed_share: float | None
) -> float:
    """Compute the grams of filament that an ended print used: the whole plate's if its progress is unknown.

    Parameters
    ----------
    printed_share
        Printed share of the time of all layers, 0 to 1; None if unknown.
    """
    if state is PrintState.DONE:
        return plate.grams
    if printed_share is None:
        return plate.grams if has_extruded or state is PrintState.FAILED else 0.0
    return plate.grams * min(1.0, max(0.0, printed_share)) if has_extruded else 0.0


def subtract_grams(reel: Reel | None, grams: float) -> Reel | None:
    """Return the reel with `grams` subtracted, but not below 0."""
    if reel is None or reel.grams is None:
        return reel
    return reel.model_copy(update={"grams": max(0.0, reel.grams - grams)})


def mark_reel_uncertain(reel: Reel | None) -> Reel | None:
    """Return the reel with its grams marked as uncertain, because unknown prints may have used some."""
    if reel is None or reel.grams is None:
        return reel
    return reel.model_copy(update={"uncertain": True})


def apply_reel(section: PrinterSection, reel: Reel | None) -> PrinterSection:
    """Return a printer's section of `fleet.yaml` with the filament and nozzle of its loaded reel."""
    if reel is None:
        return section
    kind = reel.kind or (section.material_kind if reel.material == section.material else None)
    new_section = section.with_filament(reel.material, kind, reel.colour)
    return new_section.model_copy(update={"nozzle_mm": reel.nozzle_mm})


def apply_reels(fleet: Fleet, printers: Mapping[str, Printer]) -> Fleet:
    """Return the fleet with the filament and nozzle of the loaded reel in each printer's section."""
    sections = tuple(
        apply_reel(section, entry.reel if (entry := printers.get(section.name)) is not None else None)
        for section in fleet.printers
    )
    return fleet.model_copy(update={"printers": sections})
