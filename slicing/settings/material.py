"""Cura's material files, read for one printer and nozzle, and the shrinkage of materials."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from slicing.errors import BadSetting

NAMESPACES = {"m": "http://www.ultimaker.com/material"}
CURA_SETTING = "{http://www.ultimaker.com/cura}setting"

# Names in material files, and the settings that they stand for (Cura 4.13, XmlMaterialProfile).
_KEYS = {
    "print temperature": "default_material_print_temperature",
    "heated bed temperature": "default_material_bed_temperature",
    "standby temperature": "material_standby_temperature",
    "print cooling": "cool_fan_speed",
    "retraction amount": "retraction_amount",
    "retraction speed": "retraction_speed",
    "adhesion tendency": "material_adhesion_tendency",
    "surface energy": "material_surface_energy",
    "build volume temperature": "build_volume_temperature",
    "anti ooze retract position": "material_anti_ooze_retracted_position",
    "anti ooze retract speed": "material_anti_ooze_retraction_speed",
    "break preparation position": "material_break_preparation_retracted_position",
    "break preparation speed": "material_break_preparation_speed",
    "break preparation temperature": "material_break_preparation_temperature",
    "break position": "material_break_retracted_position",
    "break speed": "material_break_speed",
    "break temperature": "material_break_temperature",
    "flush purge speed": "material_flush_purge_speed",
    "flush purge length": "material_flush_purge_length",
    "end of filament purge speed": "material_end_of_filament_purge_speed",
    "end of filament purge length": "material_end_of_filament_purge_length",
    "maximum park duration": "material_maximum_park_duration",
    "no load move factor": "material_no_load_move_factor",
}
_GRAPH, _GRAPH_KEY = "processing temperature graph", "material_flow_temp_graph"
_BOOLEANS = {"yes": "True", "no": "False"}  # in elements with the keys of Cura's settings

NO_SHRINKAGE = (1.0, 1.0)
# Factors (XY, Z) by which parts are printed larger. Material files of Cura 4.13 and 5.0 give 100 % or no
# value. The factors of PLA, Tough PLA and PETG are Cura 5.0's own, from its profiles for the Ultimaker S3 and
# S5. The others are [assumed]: typical shrinkage of printed parts, which is lower than in data sheets for
# moulded ones, and half as much in Z as in X and Y, as in Cura's figures for PLA.
_SHRINKAGE: Mapping[str, tuple[float, float]] = {
    kind: (1 + xy_percent / 100, 1 + z_percent / 100)
    for kind, xy_percent, z_percent in (
        ("PLA", 0.2, 0.1),
        ("Tough PLA", 0.3, 0.1),
        ("PETG", 0.5, 0.1),
        ("ABS", 0.7, 0.35),
        ("ASA", 0.6, 0.3),
        ("HIPS", 0.6, 0.3),
        ("CPE", 0.4, 0.2),
        ("CPE+", 0.5, 0.25),
        ("PC", 0.6, 0.3),
        ("Nylon", 1.0, 0.5),
        ("PP", 1.8, 0.9),
        ("TPU", 0.6, 0.3),
        ("TPU 95A", 0.6, 0.3),
    )
}


@dataclass(frozen=True, slots=True)
class Material:
    """Values of a material file for one printer with one nozzle."""

    values: dict[str, str]
    density_g_cm3: float
    kind: str  # PLA, ABS, ...


def read_material(root: ET.Element, name: str, product: str, hotend: str) -> Material:
    """Read a parsed material file for a printer.

    Parameters
    ----------
    root
        The file's root element.
    name
        Name of the material in messages.
    product
        The printer's name in material files, like ``Ultimaker 2+``.
    hotend
        The nozzle's name in material files, like ``0.4 mm``.

    Raises
    ------
    BadSetting
        If the material is not for this printer, or its density is missing.
    """
    settings = root.find("m:settings", NAMESPACES)
    values: dict[str, str] = {}
    is_compatible = True
    sections = [] if settings is None else [settings, *_list_printer_sections(settings, product, hotend)]
    for section in sections:
        for entry in section.findall("m:setting", NAMESPACES):
            key, text = entry.get("key", ""), (entry.text or "").strip()
            if key == "hardware compatible":
                is_compatible = text in ("yes", "unknown")
            elif key in _KEYS:
                values[_KEYS[key]] = text
            elif key == _GRAPH:
                values[_GRAPH_KEY] = str(_read_points(entry))
        for entry in section.findall(CURA_SETTING):
            text = (entry.text or "").strip()
            values[entry.get("key", "")] = _BOOLEANS.get(text.lower(), text)
    if not is_compatible:
        raise BadSetting(
            f"material {name} is not for the {product} with the nozzle {hotend}; choose another material or "
            "nozzle"
        )
    for key, path in (("material_diameter", "properties/m:diameter"), ("material_guid", "metadata/m:GUID")):
        value = root.findtext(f"m:{path}", namespaces=NAMESPACES)
        if value:
            values[key] = value
    density = root.findtext("m:properties/m:density", namespaces=NAMESPACES)
    if density is None:
        raise BadSetting(f"material {name} has no density in its file; choose another one, like generic_pla")
    return Material(values, float(density), read_material_kind(root))


def _read_points(graph: ET.Element) -> list[list[float]]:
    """Read the points (flow, temperature) of a graph."""
    points = graph.findall("m:point", NAMESPACES)
    return [[float(point.get(name, 0)) for name in ("flow", "temperature")] for point in points]


def read_material_kind(root: ET.Element) -> str:
    """Read the kind of a material, such as PLA; all colours and brands of a kind have the same qualities."""
    return root.findtext("m:metadata/m:name/m:material", default="", namespaces=NAMESPACES)


def _list_printer_sections(settings: ET.Element, product: str, hotend: str) -> Iterator[ET.Element]:
    """Yield the sections of this printer, then of its nozzle; the last one takes precedence."""
    for machine in settings.findall("m:machine", NAMESPACES):
        products = {i.get("product") for i in machine.findall("m:machine_identifier", NAMESPACES)}
        if product in products:
            yield machine
            yield from (h for h in machine.findall("m:hotend", NAMESPACES) if h.get("id") == hotend)


def find_shrinkage_factors(kind: str) -> tuple[float, float]:
    """Find the factors (XY, Z) by which parts of a kind of material are printed larger; 1 if unknown."""
    return _SHRINKAGE.get(kind, NO_SHRINKAGE)
