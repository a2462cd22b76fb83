"""Printers and plates as the scheduler sees them, for tests."""

from farm.model import Bed, FilamentState, Link
from farm.scheduling.assign import Need, PlateView, PrinterView


def printer(name, **changes):
    facts = {
        "model": "ultimaker2_plus",
        "height_mm": 205.0,
        "material": "generic_pla",
        "colour": None,
        "nozzle_mm": 0.4,
        "bed": Bed.CLEAR,
        "filament": FilamentState.PARKED,
        "link": Link.READY,
        "booked": False,
        "look": None,
    }
    return PrinterView(name=name, **{**facts, **changes})


def plate(name, planned, **changes):
    facts = {"need": Need("generic_pla", None, 0.4, 100.0), "estimated_s": 3600.0, "failed_on": frozenset()}
    return PlateView(id=name, planned=planned, **{**facts, **changes})
