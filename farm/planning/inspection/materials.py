"""Names of materials: those that people use, such as `black PETG`, and Cura's names for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from farm.config import PrinterSection
from farm.model import JobOptions
from farm.planning.printer_settings import list_matching_printers
from slicing.errors import BadSetting, SlicingError
from slicing.printer import PrinterModel
from slicing.settings import Resources, SettingsRequest, find_resources, resolve_settings

_GENERIC_PREFIX = "generic_"


@dataclass(frozen=True, slots=True)
class NamedMaterial:
    """Material named by a person.

    Attributes
    ----------
    name
        Name of a material file, or the kind that the person named, like PLA.
    kind
        Its kind, like PLA.
    colour
        The other words that the person used, like black; None if there are none.
    """

    name: str
    kind: str
    colour: str | None = None


def parse_material(text: str, kinds: Mapping[str, str]) -> NamedMaterial | None:
    """Find the material in a person's text: the name of a file, or a kind, with or without a colour.

    Parameters
    ----------
    text
        A text such as `generic_pla`, `pla`, `black PETG` or `CPE+`.
    kinds
        The kind of each material, by the name of its file.

    Returns
    -------
    NamedMaterial | None
        None if no word of the text is a material.
    """
    materials = {name.casefold(): NamedMaterial(name, kind) for name, kind in kinds.items()}
    materials |= {_normalise_name(kind): NamedMaterial(kind, kind) for kind in kinds.values() if kind}
    for name, kind in kinds.items():
        if name.startswith(_GENERIC_PREFIX):  # TPU is Cura's generic_tpu, of the kind TPU 95A
            materials[_normalise_name(name.removeprefix(_GENERIC_PREFIX))] = NamedMaterial(kind, kind)
    words = text.split()
    for length in range(len(words), 0, -1):
        for first in range(len(words) - length + 1):
            phrase = " ".join(words[first : first + length])
            material = materials.get(phrase.casefold()) or materials.get(_normalise_name(phrase))
            if material is not None:
                colour = " ".join(words[:first] + words[first + length :])
                return NamedMaterial(material.name, material.kind, colour or None)
    return None


def _normalise_name(name: str) -> str:
    return " ".join(name.casefold().replace("_", " ").replace("-", " ").split())


def list_material_kinds(resources: Resources) -> dict[str, str]:
    """Return the kind of each material, by the name of its file."""
    return {name: resources.read_material_kind(name) or "" for name in resources.list_material_names()}


def choose_material(
    text: str, printer: PrinterModel, nozzle_mm: float, resources: Resources
) -> NamedMaterial:
    """Choose the material file for a printer from a person's text.

    A kind stands for Cura's generic material of this kind. If the printer cannot print that material, the
    only other material of this kind that it can print is chosen.

    Raises
    ------
    BadSetting
        If the text matches no material or several; the message lists the materials that this printer can
        print.
    """
    kinds = list_material_kinds(resources)
    named_material = parse_material(text, kinds)
    if named_material is None:
        printable_text = _describe_printable_kinds(printer, nozzle_mm, kinds, resources)
        raise BadSetting(f"{text}: there is no such material{printable_text}")
    if named_material.name in kinds:
        return named_material
    names_of_kind = [name for name, kind in kinds.items() if kind == named_material.kind]
    generic_names = [name for name in names_of_kind if name.startswith(_GENERIC_PREFIX)]
    candidates: list[str] = []
    for names in (generic_names, names_of_kind):
        candidates = candidates or [name for name in names if _can_print(name, printer, nozzle_mm, resources)]
    if len(candidates) == 1:
        return NamedMaterial(candidates[0], named_material.kind, named_material.colour)
    if candidates:
        raise BadSetting(f"{named_material.kind}: there are several; name one of {', '.join(candidates)}")
    raise BadSetting(
        f"{named_material.kind}: Cura has no profile for it on the {printer.title} with a nozzle of "
        f"{nozzle_mm:g} mm{_describe_printable_kinds(printer, nozzle_mm, kinds, resources)}"
    )


def resolve_filament(
    options: JobOptions, printers: Sequence[PrinterSection], own_materials: Path | None
) -> JobOptions:
    """Replace the requested material with its kind or the name of its file, and set the colour.

    Parameters
    ----------
    options
        The options of a job as submitted.
    printers
        The fleet.
    own_materials
        Folder of the user's own material files.

    Raises
    ------
    RefusedError
        If no printer of the fleet has the material; the message lists the available materials.
    """
    if options.material is not None:
        with suppress(SlicingError):  # without Cura's files, the inspection reports an error
            named_material = parse_material(
                options.material, list_material_kinds(find_resources(own_materials=own_materials))
            )
            if named_material is not None:
                filament = {
                    "material": named_material.name,
                    "colour": options.colour or named_material.colour,
                }
                options = options.model_copy(update=filament)
    list_matching_printers(printers, options)
    return options


def _can_print(name: str, printer: PrinterModel, nozzle_mm: float, resources: Resources) -> bool:
    """Return whether a printer can print a material with its nozzle in the farm's quality."""
    try:
        resolve_settings(SettingsRequest(printer, material=name, nozzle_mm=nozzle_mm), resources)
    except SlicingError:
        return False
    return True


def _describe_printable_kinds(
    printer: PrinterModel, nozzle_mm: float, kinds: Mapping[str, str], resources: Resources
) -> str:
    """Describe the kinds that a printer can print: Cura's generic materials, and the user's own."""
    own_names = resources.list_own_material_names()
    names = [name for name in kinds if name.startswith(_GENERIC_PREFIX) or name in own_names]
    printable_kinds = {kinds[name] for name in names if _can_print(name, printer, nozzle_mm, resources)}
    if not printable_kinds:
        return ""
    return (
        f"; it prints {', '.join(sorted(printable_kinds, key=str.casefold))}, and others with a material "
        "file of your own (`fleet.materials` in fleet.yaml)"
    )
