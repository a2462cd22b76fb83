"""Check of the printers in `fleet.yaml` against Cura's files."""

from __future__ import annotations

from drivers.printers import PROFILES
from farm.config import PrinterSection
from farm.planning.printer_settings import slicing_printer
from slicing.errors import BadSetting, SlicingError
from slicing.settings import SettingsRequest, find_resources, resolve_settings


def find_mistake(section: PrinterSection) -> tuple[str, str] | None:
    """Find the first value in a printer's section that Cura's files do not know.

    Returns
    -------
    tuple[str, str] | None
        The key, and the known values. None if all are known, or if Cura's files are missing (a
        submission reports that).
    """
    request = SettingsRequest(
        slicing_printer(PROFILES[section.model]), material=section.material, nozzle_mm=section.nozzle_mm
    )
    try:
        resources = find_resources()
        for key, look in (("model", resources.machine), ("material", resources.material)):
            try:
                look(getattr(section, key))
            except BadSetting as error:
                return key, str(error)
        resolve_settings(request, resources)
    except BadSetting as error:
        return ("nozzle_mm" if str(error).startswith("nozzle ") else "material"), str(error)
    except SlicingError:
        return None
    return None
