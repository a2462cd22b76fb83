"""Printer models as the slicing package takes them, from the drivers' profiles."""

from __future__ import annotations

from drivers.printers import Profile
from slicing.printer import HeadShape, MachineLimits, PrintCode, PrinterModel


def slicing_printer(profile: Profile) -> PrinterModel:
    """Hand a printer model's limits, start and end code to the slicing package."""
    return PrinterModel(
        name=profile.model,
        title=profile.title,
        slicer_names=profile.slicer_names,
        limits=MachineLimits(profile.max_nozzle_c, profile.max_bed_c, profile.min_extrusion_c),
        code=PrintCode(
            flavor=profile.gcode_flavor,
            start=profile.start_code,
            end=profile.end_code,
            prime_mm3=profile.prime_mm3,
            parked_mm=profile.parked_mm,
            ready_mm=profile.ready_mm,
        ),
        head=HeadShape(*profile.head_mm, above_nozzle=profile.head_above_nozzle_mm),
        retraction_mm=profile.retraction_mm,
        retraction_mm_s=profile.retraction_mm_s,
    )
