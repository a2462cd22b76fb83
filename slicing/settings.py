"""From a printer model, a quality, a material and a person's overrides to what CuraEngine is told."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from slicing.definitions import Layer, Resolver, Scope, parse_value
from slicing.errors import BadSetting, nearest
from slicing.formula import Formula
from slicing.material import Material, read_material
from slicing.qualities import DEFAULT_QUALITY, OURS
from slicing.resources import Machine, Profile, Resources
from slicing.startcode import FLAVOR, end_code, start_code

# What a file that is streamed needs; a person's setting must not undo it.
_FIXED: Mapping[str, Any] = {
    "machine_gcode_flavor": FLAVOR,
    "machine_firmware_retract": False,
    "machine_center_is_zero": False,
    "material_bed_temp_prepend": False,
    "material_print_temp_prepend": False,
    "relative_extrusion": False,
}
_RESERVED = frozenset(
    {*_FIXED, "machine_start_gcode", "machine_end_gcode", "material_diameter", "extruder_nr"}
)
# Directions in which a pattern lays its lines `infill_line_distance` apart (Cura's formula for that setting).
_DIRECTIONS = {
    "grid": 2,
    "tetrahedral": 2,
    "quarter_cubic": 2,
    "triangles": 3,
    "trihexagon": 3,
    "cubic": 3,
    "cubicsubdiv": 3,
}


@dataclass(frozen=True, slots=True)
class SettingsRequest:
    """How to print, in the user's words. `printer_model` is Cura's definition id."""

    printer_model: str
    quality: str = DEFAULT_QUALITY
    material: str = "generic_pla"
    nozzle_mm: float = 0.4
    overrides: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PartSettings:
    """What is chosen for one part; None: as the quality has it. A user's own settings win over it.

    Parameters
    ----------
    height_mm
        How high the print is to be.
    brim_width_mm
        Its brim, 0 for none; never wider than the quality's, for which the part room is computed.
    layer_0_expansion_mm
        How much wider the first layer is on each side than those above; negative against an elephant's foot.
    """

    height_mm: float | None = None
    brim_width_mm: float | None = None
    layer_0_expansion_mm: float | None = None


ANY_PART = PartSettings()


@dataclass(frozen=True, slots=True)
class Settings:
    """Every setting as CuraEngine reads it, and the numbers that others need."""

    printer_model: str
    global_: dict[str, str]
    extruder: dict[str, str]
    layer_height_mm: float
    layer_height_0_mm: float
    line_width_mm: float  # the inner walls'
    line_width_0_mm: float  # the outer wall's
    wall_count: int
    top_layers: int
    bottom_layers: int
    infill_line_distance_mm: float  # mean spacing, all directions together; 0 without infill
    support_enabled: bool
    support_angle_deg: float  # from the vertical
    support_line_distance_mm: float  # 0 without support
    speed_wall_0_mm_s: float
    speed_wall_x_mm_s: float
    speed_infill_mm_s: float
    speed_topbottom_mm_s: float
    speed_support_mm_s: float
    speed_layer_0_mm_s: float
    speed_travel_mm_s: float
    brim_width_mm: float  # as printed: whole lines of brim, or the skirt with its gap
    nozzle_c: float  # of the first layer
    bed_c: float  # of the first layer
    density_g_cm3: float
    filament_diameter_mm: float

    @property
    def filament_mm2(self) -> float:
        """The filament's cross-section in mm2."""
        return math.pi * self.filament_diameter_mm**2 / 4


def resolve_settings(
    request: SettingsRequest, resources: Resources, part: PartSettings = ANY_PART
) -> Settings:
    """Resolve a request against Cura's files, for any part or for one; the last ones are kept in memory.

    Raises
    ------
    BadSetting
        Where the model, quality, material, nozzle or an override does not exist or does not fit.
    ResourcesMissing, DefinitionError
        Where Cura's files are not as expected.
    """
    overrides = tuple(sorted((key, str(raw)) for key, raw in request.overrides.items()))
    words = (request.printer_model, request.quality, request.material, request.nozzle_mm)
    settings = _resolve(resources, part, words, overrides)
    if settings.brim_width_mm > _resolve(resources, ANY_PART, words, overrides).brim_width_mm:
        return _resolve(resources, replace(part, brim_width_mm=None), words, overrides)
    return settings


@lru_cache(maxsize=256)
def _resolve(
    resources: Resources,
    part: PartSettings,
    words: tuple[str, str, str, float],
    overrides: tuple[tuple[str, str], ...],
) -> Settings:
    request = SettingsRequest(*words, overrides=dict(overrides))
    machine = resources.machine(request.printer_model)
    hotend = f"{request.nozzle_mm:g} mm"
    variant = _variant(machine, hotend, resources)
    material = _material(request, machine, hotend, resources)
    global_quality, quality = _qualities(request, machine, hotend, material, resources)
    ours = OURS[request.quality].changes if request.quality in OURS else {}

    def layer(values: Mapping[str, str]) -> Layer:
        return {key: _written(machine, key, text) for key, text in values.items() if _known(machine, key)}

    user: dict[str, Any] = {}
    on_top = (user, _FIXED, _part_layer(part), ours)
    global_layers = (*on_top, layer(global_quality.values))
    extruder_layers = (*on_top, layer(quality.values), layer(material.values), layer(variant.values))
    resolver = Resolver(machine.settings, machine.extruder, global_layers, extruder_layers)
    for key, raw in request.overrides.items():
        setting = resolver.setting(key)
        if key in _RESERVED:
            raise BadSetting(f"{key}: set by this program, for streaming; leave it out")
        user[key] = parse_value(setting, raw)
    for key in user:
        resolver.check_range(key)
    return _settings(request.printer_model, resolver, material.density_g_cm3)


def _part_layer(part: PartSettings) -> Layer:
    layer: dict[str, Any] = {}
    if part.brim_width_mm is not None:
        layer["adhesion_type"] = "brim" if part.brim_width_mm > 0 else "none"
        layer["brim_width"] = part.brim_width_mm
    if part.layer_0_expansion_mm is not None:
        layer["xy_offset_layer_0"] = Formula(f"xy_offset + ({part.layer_0_expansion_mm!r})")
    return layer


def _settings(model: str, resolver: Resolver, density_g_cm3: float) -> Settings:
    global_ = {key: _text(resolver.value(Scope.GLOBAL, key)) for key in resolver.keys(Scope.GLOBAL)}
    extruder = {key: _text(resolver.value(Scope.EXTRUDER, key)) for key in resolver.keys(Scope.EXTRUDER)}
    # The engine reads it in both places, and prints no support where either says no.
    extruder["support_enable"] = global_["support_enable"]

    def number(key: str) -> float:
        return float(resolver.value(Scope.EXTRUDER, key))

    def flag(key: str) -> bool:
        return bool(resolver.value(Scope.EXTRUDER, key))

    if global_["adhesion_type"] == "raft":
        raise BadSetting("adhesion_type=raft: a raft is not supported; take brim, skirt or none")
    diameter_mm = number("material_diameter")
    filament_mm2 = math.pi * diameter_mm**2 / 4
    nozzle_c = number("material_print_temperature_layer_0")
    bed_c = number("material_bed_temperature_layer_0")
    global_["machine_start_gcode"] = start_code(nozzle_c, bed_c, filament_mm2)
    global_["machine_end_gcode"] = end_code(number("retraction_amount") if flag("retraction_enable") else 0.0)
    directions = _DIRECTIONS.get(extruder["infill_pattern"], 1)
    support = flag("support_enable")
    return Settings(
        printer_model=model,
        global_=global_,
        extruder=extruder,
        layer_height_mm=number("layer_height"),
        layer_height_0_mm=number("layer_height_0"),
        line_width_mm=number("wall_line_width_x"),
        line_width_0_mm=number("wall_line_width_0"),
        wall_count=int(number("wall_line_count")),
        top_layers=int(number("top_layers")),
        bottom_layers=int(number("bottom_layers")),
        infill_line_distance_mm=number("infill_line_distance") / directions,
        support_enabled=support,
        support_angle_deg=number("support_angle"),
        support_line_distance_mm=number("support_line_distance") if support else 0.0,
        speed_wall_0_mm_s=number("speed_wall_0"),
        speed_wall_x_mm_s=number("speed_wall_x"),
        speed_infill_mm_s=number("speed_infill"),
        speed_topbottom_mm_s=number("speed_topbottom"),
        speed_support_mm_s=number("speed_support"),
        speed_layer_0_mm_s=number("speed_layer_0"),
        speed_travel_mm_s=number("speed_travel"),
        brim_width_mm=_brim_mm(global_["adhesion_type"], number),
        nozzle_c=nozzle_c,
        bed_c=bed_c,
        density_g_cm3=density_g_cm3,
        filament_diameter_mm=diameter_mm,
    )


def _brim_mm(adhesion: str, number: Any) -> float:
    line_mm = number("skirt_brim_line_width") * number("initial_layer_line_width_factor") / 100
    match adhesion:
        case "brim":
            return round(float(number("brim_line_count") * line_mm), 6)
        case "skirt":
            return round(float(number("skirt_gap") + number("skirt_line_count") * line_mm), 6)
    return 0.0


def _text(value: Any) -> str:
    """As CuraEngine reads it: Python's own words for numbers, booleans and lists."""
    return "" if value is None else str(value)


def _known(machine: Machine, key: str) -> bool:
    return key in machine.settings or key in machine.extruder


def _written(machine: Machine, key: str, text: str) -> Any:
    """A profile's value: a formula where it starts with an equals sign."""
    if text.startswith("="):
        return Formula(text[1:])
    return parse_value(machine.settings.get(key) or machine.extruder[key], text)


def _variant(machine: Machine, hotend: str, resources: Resources) -> Profile:
    variants = {
        profile.metadata["name"]: profile for profile in resources.profiles("variants", machine.model)
    }
    if hotend not in variants:
        have = ", ".join(sorted(variants)) or "none"
        raise BadSetting(f"nozzle {hotend}: the {machine.name} has no such nozzle; it has {have}")
    return variants[hotend]


def _material(request: SettingsRequest, machine: Machine, hotend: str, resources: Resources) -> Material:
    root = resources.material(request.material)
    if request.material in machine.excluded_materials:
        raise BadSetting(f"material {request.material} is not for the {machine.name}")
    return read_material(root, request.material, machine.name, hotend)


def _qualities(
    request: SettingsRequest, machine: Machine, hotend: str, material: Material, resources: Resources
) -> tuple[Profile, Profile]:
    """The global profile and the extruder's; a brand's material without its own takes the generic one's."""
    profiles = resources.profiles("quality", machine.quality_definition)
    shared = {p.metadata["quality_type"]: p for p in profiles if p.metadata.get("global_quality") == "True"}
    own: dict[str, Profile] = {}
    for name in (f"generic_{material.kind.lower()}", request.material):  # the later one wins
        own |= dict(_of(profiles, name, hotend))
    have = sorted(own.keys() & shared.keys())
    bases = OURS[request.quality].bases if request.quality in OURS else (request.quality,)
    base = next((base for base in bases if base in have), None)
    if base is None:
        have += [name for name, quality in OURS.items() if {*quality.bases} & {*have}]
        where = f"{request.material} and a nozzle of {hotend} on the {machine.name}"
        offer = nearest(request.quality, have) or (f"; there is {', '.join(have)}" if have else "")
        raise BadSetting(f"quality {request.quality}: there is none for {where}{offer}")
    return shared[base], own[base]


def _of(profiles: tuple[Profile, ...], material: str, hotend: str) -> Iterator[tuple[str, Profile]]:
    for profile in profiles:
        data = profile.metadata
        if data.get("material") == material and data.get("variant") == hotend:
            yield data["quality_type"], profile
