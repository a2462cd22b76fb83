"""Cura's profiles for a printer, nozzle, material and quality (Cura 4.13, ``MaterialNode``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from slicing.errors import BadSetting, suggest_names
from slicing.settings.definitions import parse_literal, parse_value
from slicing.settings.formula import Formula
from slicing.settings.material import Material, read_material
from slicing.settings.own_materials import RELATED_KINDS
from slicing.settings.qualities import FARM_QUALITIES
from slicing.settings.resolver import ProfileIndex, ProfileValues, Scope
from slicing.settings.resources import Machine, Profile, Resources

_GENERIC_MATERIALS = ("generic_pla", "generic_pla_175")
_MAX_DIAMETER_DIFFERENCE_MM = 0.5
"""Maximum difference between the diameters of filament and printer: Cura compares whole millimetres."""


@dataclass(frozen=True, slots=True)
class Stacks:
    """A printer model's definitions with all profiles that apply to a request, except the user's."""

    machine: Machine
    material: Material
    profiles: Mapping[Scope, Mapping[ProfileIndex, ProfileValues]]


def find_stacks(
    resources: Resources, printer_model: str, nozzle_mm: float, material: str, quality: str
) -> Stacks:
    """Find the profiles for a request.

    Parameters
    ----------
    resources
        Cura's files.
    printer_model
        Id of Cura's definition.
    nozzle_mm
        Diameter of the nozzle.
    material, quality
        Names of Cura's files, or a quality of the farm.

    Raises
    ------
    BadSetting
        If the model, nozzle, material or quality does not exist, or does not fit the others.
    """
    machine = resources.read_machine(printer_model)
    hotend, variant = _find_variant(machine, nozzle_mm, resources)
    material_profile = _read_material(machine, hotend, material, resources)
    global_profile, quality_profile = _find_qualities(
        machine, hotend, material, material_profile.kind, quality, resources
    )

    def convert_values(values: Mapping[str, str]) -> ProfileValues:
        return {
            key: _convert_value(machine, key, text) for key, text in values.items() if _is_known(machine, key)
        }

    extruder = {
        ProfileIndex.QUALITY: convert_values(quality_profile.values),
        ProfileIndex.MATERIAL: convert_values(material_profile.values),
        ProfileIndex.VARIANT: convert_values(variant),
    }
    return Stacks(
        machine,
        material_profile,
        {
            Scope.GLOBAL: {ProfileIndex.QUALITY: convert_values(global_profile.values)},
            Scope.EXTRUDER: extruder,
        },
    )


def _is_known(machine: Machine, key: str) -> bool:
    return key in machine.settings or key in machine.extruder


def _check_values(machine: Machine, material: Material, name: str) -> None:
    """Check that the values of a user's material have the types of their settings."""
    for key, text in material.values.items():
        setting = machine.settings.get(key) or machine.extruder.get(key)
        if setting is not None:
            try:
                parse_value(setting, text)
            except BadSetting as error:
                raise BadSetting(f"material {name}: {error}") from error


def _convert_value(machine: Machine, key: str, text: str) -> object:
    """Read a profile's value: a formula if it starts with an equals sign."""
    if text.startswith("="):
        return Formula(text[1:])
    setting = machine.settings.get(key) or machine.extruder[key]
    try:
        return parse_value(setting, text)
    except BadSetting:
        return parse_literal(text)


def _find_variant(machine: Machine, nozzle_mm: float, resources: Resources) -> tuple[str, Mapping[str, str]]:
    """Find the nozzle's name and values; without profiles for nozzles, those of the definition."""
    if machine.has_variants:
        profiles = resources.read_profiles("variants", machine.model)
        available = {
            p.metadata["name"]: p.values for p in profiles if p.metadata.get("hardware_type") == "nozzle"
        }
    else:
        available = {f"{machine.nozzle_mm:g} mm": {}}
    size = f"{nozzle_mm:g}"
    hotend = next((name for name in available if name in (f"{size} mm", f"{size}mm Nozzle")), None)
    if hotend is None:
        names = ", ".join(sorted(available)) or "none"
        raise BadSetting(f"nozzle {size} mm: the {machine.name} has no such nozzle; it has {names}")
    return hotend, available[hotend]


def _read_material(machine: Machine, hotend: str, name: str, resources: Resources) -> Material:
    root = resources.read_material(name)
    if name in machine.excluded_materials:
        generic = next(pla for pla in _GENERIC_MATERIALS if pla not in machine.excluded_materials)
        raise BadSetting(f"material {name} is not for the {machine.name}; choose another one, like {generic}")
    material = read_material(root, name, machine.name, hotend)
    if name in resources.list_own_material_names():
        _check_values(machine, material, name)
    diameter_mm = float(material.values.get("material_diameter", machine.diameter_mm))
    if abs(diameter_mm - machine.diameter_mm) > _MAX_DIAMETER_DIFFERENCE_MM:
        raise BadSetting(
            f"material {name} has a diameter of {diameter_mm:g} mm; the {machine.name} needs "
            f"{machine.diameter_mm:g} mm"
        )
    return material


def _find_qualities(
    machine: Machine, hotend: str, material: str, kind: str, quality: str, resources: Resources
) -> tuple[Profile, Profile]:
    """Find the global and the extruder's profile of a quality; a material may use those of its kind."""
    profiles = resources.read_profiles("quality", machine.quality_definition)
    global_profiles = {
        p.metadata["quality_type"]: p for p in profiles if p.metadata.get("global_quality") == "True"
    }
    candidates = global_profiles
    if machine.has_materials:
        nozzle_profiles = [p for p in profiles if p.metadata.get("variant") == hotend]
        matching = [p for p in nozzle_profiles if p.metadata.get("material") == material]
        kinds = (
            [kind, RELATED_KINDS.get(kind, kind)]
            if material in resources.list_own_material_names()
            else [kind]
        )
        for material_kind in kinds:
            matching = matching or [
                p for p in nozzle_profiles if _is_kind(p.metadata.get("material"), material_kind, resources)
            ]
        candidates = {p.metadata["quality_type"]: p for p in matching}
    available = sorted(candidates.keys() & global_profiles.keys())
    bases = FARM_QUALITIES[quality].bases if quality in FARM_QUALITIES else (quality,)
    base = next((base for base in bases if base in available), None)
    if base is None:
        available += [
            name for name, farm_quality in FARM_QUALITIES.items() if {*farm_quality.bases} & {*available}
        ]
        context = f"{material} and a nozzle of {hotend} on the {machine.name}"
        offer = f"available: {', '.join(available)}" if available else "choose another material or nozzle"
        advice = suggest_names(quality, available) or f"; {offer}"
        raise BadSetting(f"quality {quality}: there is none for {context}{advice}")
    return global_profiles[base], candidates[base]


def _is_kind(material: str | None, kind: str, resources: Resources) -> bool:
    """Check whether a quality's material is of a kind, such as PLA."""
    return material is not None and resources.read_material_kind(material) == kind
