"""Printers that a job may go to, and their slicer settings."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.printers import PROFILES
from farm.config import PrinterSection
from farm.errors import Refused
from farm.model import JobOptions
from farm.planning.error_translation import translate_errors
from farm.planning.slicing_printers import slicing_printer
from slicing.settings import EngineSettings, Resources, SettingsRequest, find_resources, resolve_settings


def matching_printers(printers: Sequence[PrinterSection], options: JobOptions) -> list[PrinterSection]:
    """Return the enabled printers with the material and the colour that a job needs, at least one.

    Raises
    ------
    Refused
        There is none; the message says what there is.
    """
    enabled = [section for section in printers if section.enabled]
    matching = [
        section
        for section in enabled
        if options.material in (None, section.material) and options.colour in (None, section.colour)
    ]
    if not matching:
        have = sorted({f"{s.material} {s.colour}" if s.colour else s.material for s in enabled})
        wanted = " ".join(filter(None, (options.material, options.colour))) or "a printer"
        raise Refused(
            f"no printer of the fleet has {wanted}; there is {', '.join(have) or 'no printer at all'}"
        )
    return matching


def settings_request(section: PrinterSection, quality: str) -> SettingsRequest:
    """Build the request for the slicer's settings on a printer, with supports: poses count on them."""
    return SettingsRequest(
        slicing_printer(PROFILES[section.model]),
        quality,
        section.material,
        nozzle_mm=section.nozzle_mm,
        supported=True,
    )


def printer_settings(section: PrinterSection, quality: str, resources: Resources) -> EngineSettings:
    """Resolve the slicer's settings for a printer. Raises FarmError with code `settings`."""
    with translate_errors():
        return resolve_settings(settings_request(section, quality), resources)


def check_settings(printers: Sequence[PrinterSection], options: JobOptions) -> None:
    """Check that every printer that a job may go to can print its quality; runs in a worker.

    Raises
    ------
    FarmError
        `refused` where no printer of the fleet matches, `settings` where its quality does not exist, `engine`
        where Cura's files are missing; each with what there is instead.
    """
    with translate_errors():
        resources = find_resources()
    for section in matching_printers(printers, options):
        printer_settings(section, options.quality, resources)
