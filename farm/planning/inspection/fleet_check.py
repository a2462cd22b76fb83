"""Check of the printers in `fleet.yaml` against Cura's files."""

from __future__ import annotations

from drivers.printers import PROFILES
from farm.config import FieldError, FleetSection, PrinterSection
from farm.planning.inspection.materials import choose_material
from farm.planning.printer_settings import build_slicing_printer
from slicing.errors import BadSetting, SlicingError
from slicing.settings import Resources, SettingsRequest, find_resources, resolve_settings


def complete_section(section: PrinterSection, fleet_section: FleetSection) -> PrinterSection:
    """Check a printer's section against Cura's files, and replace its material by a material file's name.

    Parameters
    ----------
    section
        The section, with the material as entered by a person, like PLA.
    fleet_section
        The keys under `fleet`, for the folder of the user's materials.

    Returns
    -------
    PrinterSection
        The section with the name of the material file, and the kind and colour of the material. It is
        unchanged if Cura's files are missing, which is reported when a job is submitted.

    Raises
    ------
    FieldError
        If a value of the section is missing in Cura's files; the error names its key and lists the possible
        values.
    """
    try:
        resources = find_resources(own_materials=fleet_section.materials)
    except SlicingError:
        return section
    _check_own_materials(resources)
    key = "model"
    try:
        resources.read_machine(section.model)
        key = "material"
        printer = build_slicing_printer(PROFILES[section.model])
        named_material = choose_material(section.material, printer, section.nozzle_mm, resources)
        section = section.with_filament(
            named_material.name, named_material.kind, section.colour or named_material.colour
        )
        request = SettingsRequest(printer, material=section.material, nozzle_mm=section.nozzle_mm)
        resolve_settings(request, resources)
    except BadSetting as error:
        key = "nozzle_mm" if str(error).startswith("nozzle ") else key
        raise FieldError(str(error), key) from error
    except SlicingError:
        return section
    return section


def _check_own_materials(resources: Resources) -> None:
    """Read every material of the user, so that an error in one is reported before it is used."""
    try:
        for name in resources.list_own_material_names():
            resources.read_material(name)
    except BadSetting as error:
        raise FieldError(str(error), "fleet", "materials") from error
