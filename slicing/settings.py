"""From a printer model, a quality, a material and a person's overrides to what CuraEngine is told."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from slicing.definitions import parse_value
from slicing.errors import BadSetting, DefinitionError
from slicing.formula import Formula
from slicing.heights import LayerHeights, fit_heights
from slicing.limits import Violation, violations, why_reserved
from slicing.material import Material
from slicing.qualities import DEFAULT_QUALITY, OURS
from slicing.resolver import Layer, Place, Resolver, Scope
from slicing.resources import Resources
from slicing.shrinkage import NONE, compensation
from slicing.stacks import Stacks, find_stacks
from slicing.startcode import FLAVOR, end_code, start_code

# What a file that is streamed needs.
_FIXED: Mapping[str, Any] = {
    "machine_gcode_flavor": FLAVOR,
    "machine_firmware_retract": False,
    "machine_center_is_zero": False,
    "material_bed_temp_prepend": False,
    "material_print_temp_prepend": False,
    "relative_extrusion": False,
}
_SHRINKAGE = (
    "material_shrinkage_percentage",
    "material_shrinkage_percentage_xy",  # from Cura 5 on
    "material_shrinkage_percentage_z",
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
    scale_xy: float  # a part is printed larger by these, because it shrinks
    scale_z: float

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
    words = _Words.of(request)
    quality = OURS.get(request.quality)
    every = _resolve(resources, words, ANY_PART, None)
    heights = None
    if part.height_mm is not None and quality and quality.exact_height and not _has_own_heights(request):
        wanted = LayerHeights(every.layer_height_0_mm, every.layer_height_mm)
        fixed = "layer_height_0" in request.overrides
        heights = fit_heights(part.height_mm, wanted, fixed_first=fixed)
    part = replace(part, height_mm=None)
    settings = _resolve(resources, words, part, heights)
    if settings.brim_width_mm > every.brim_width_mm:
        return _resolve(resources, words, replace(part, brim_width_mm=None), heights)
    return settings


def _has_own_heights(request: SettingsRequest) -> bool:
    """Whether the user says how high layers are, or which of them are printed."""
    return not request.overrides.keys().isdisjoint(
        ("layer_height", "adaptive_layer_height_enabled", "slicing_tolerance")
    )


@dataclass(frozen=True, slots=True)
class _Words:
    """A request that can be looked up."""

    printer_model: str
    quality: str
    material: str
    nozzle_mm: float
    overrides: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, request: SettingsRequest) -> _Words:
        overrides = tuple(sorted((key, str(raw)) for key, raw in request.overrides.items()))
        return cls(request.printer_model, request.quality, request.material, request.nozzle_mm, overrides)


@lru_cache(maxsize=256)
def _resolve(
    resources: Resources, words: _Words, part: PartSettings, heights: LayerHeights | None
) -> Settings:
    stacks = find_stacks(resources, words.printer_model, words.nozzle_mm, words.material, words.quality)
    resolver = _resolver(stacks, words, part, heights)
    user_keys = [key for key, _ in words.overrides]
    try:
        for found in violations(resolver, chosen=user_keys):
            if found.ours or not _is_cura_s(found, resources, words):
                raise BadSetting(_refusal(found, words))
    except DefinitionError as error:
        if not user_keys:
            raise
        raise BadSetting(f"{', '.join(user_keys)}: with this {error}") from error
    quality = OURS.get(words.quality)
    ours = quality is not None and quality.compensates_shrinkage and {*_SHRINKAGE}.isdisjoint(user_keys)
    scale = _scale(resolver, stacks.material.kind if ours else "")
    return _settings(words.printer_model, resolver, stacks.material, scale)


def _scale(resolver: Resolver, kind: str) -> tuple[float, float]:
    """Factors (XY, Z) by which a part is printed larger: Cura's; where it has none, a material kind's."""
    known = resolver.keys(Scope.GLOBAL)
    both, xy, z = (
        float(resolver.value(Scope.GLOBAL, key)) / 100 if key in known else None for key in _SHRINKAGE
    )
    scale = (xy or both or 1.0, z or both or 1.0)
    return compensation(kind) if scale == NONE else scale


def _is_cura_s(found: Violation, resources: Resources, words: _Words) -> bool:
    """Whether Cura's own profiles go beyond the limits of its definitions here: it prints all the same."""
    bare = replace(words, overrides=())
    stacks = find_stacks(resources, words.printer_model, words.nozzle_mm, words.material, words.quality)
    return bool(_resolver(stacks, bare, ANY_PART, None).value(found.scope, found.key) == found.value)


def _refusal(found: Violation, words: _Words) -> str:
    value = f"{found.value:.6g}" if isinstance(found.value, float) else found.value
    chosen = [key for key, _ in words.overrides]
    cause = "" if found.key in chosen else f" follows from {', '.join(chosen)} and"
    if chosen:
        return f"{found.key}={value}{cause} is out of range; {found.allowed}"
    where = f"{words.quality} with {words.material}"
    return f"{found.key}={value}, from {where}, is out of range; {found.allowed}: take another, or set it"


def _resolver(stacks: Stacks, words: _Words, part: PartSettings, heights: LayerHeights | None) -> Resolver:
    """The stacks under a user's layer: a person's settings, ours for streaming, the part's, the quality's."""
    user: dict[str, Any] = {}
    quality = OURS.get(words.quality)
    if quality is not None:
        user |= quality.changes
    user |= {**_part_layer(part, heights), **_FIXED}
    layers = {scope: {Place.USER: user, **profiles} for scope, profiles in stacks.layers.items()}
    resolver = Resolver(stacks.machine.settings, stacks.machine.extruder, layers)
    for key, raw in words.overrides:
        setting = resolver.setting(key)
        why = why_reserved(key)
        if why is not None:
            raise BadSetting(f"{key}: {why}")
        user[key] = parse_value(setting, raw)
    return resolver


def _part_layer(part: PartSettings, heights: LayerHeights | None) -> Layer:
    layer: dict[str, Any] = {}
    if heights is not None:
        layer |= {"layer_height": heights.other_mm, "layer_height_0": heights.first_mm}
    if part.brim_width_mm is not None:
        layer["adhesion_type"] = "brim" if part.brim_width_mm > 0 else "none"
        layer["brim_width"] = part.brim_width_mm
    if part.layer_0_expansion_mm is not None:
        layer["xy_offset_layer_0"] = Formula(f"xy_offset + ({part.layer_0_expansion_mm!r})")
    return layer


def _settings(model: str, resolver: Resolver, material: Material, scale: tuple[float, float]) -> Settings:
    global_ = {key: _text(resolver.value(Scope.GLOBAL, key)) for key in resolver.keys(Scope.GLOBAL)}
    extruder = {key: _text(resolver.value(Scope.EXTRUDER, key)) for key in resolver.keys(Scope.EXTRUDER)}
    # The engine reads it in both places, and prints no support where either says no.
    extruder["support_enable"] = global_["support_enable"]
    # The mesh is scaled before it is placed, so that the checks see what is printed.
    told = dict.fromkeys(_SHRINKAGE, "100.0")
    global_ |= {key: told[key] for key in told.keys() & global_.keys()}
    extruder |= {key: told[key] for key in told.keys() & extruder.keys()}

    def number(key: str) -> float:
        return float(resolver.value(Scope.EXTRUDER, key))

    def flag(key: str) -> bool:
        return bool(resolver.value(Scope.EXTRUDER, key))

    if global_["adhesion_type"] == "raft":
        raise BadSetting("adhesion_type=raft: a raft is not supported; set it to brim, or take quality glue")
    diameter_mm = number("material_diameter")
    filament_mm2 = math.pi * diameter_mm**2 / 4
    nozzle_c = number("material_print_temperature_layer_0")
    bed_c = number("material_bed_temperature_layer_0") if flag("machine_heated_bed") else 0.0
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
        density_g_cm3=material.density_g_cm3,
        filament_diameter_mm=diameter_mm,
        scale_xy=scale[0],
        scale_z=scale[1],
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
