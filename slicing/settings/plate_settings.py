"""CuraEngine's settings for a printer model, a quality, a material and a person's overrides."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from slicing.errors import BadSetting, DefinitionError
from slicing.printer import PrinterModel
from slicing.settings.definitions import parse_value
from slicing.settings.engine_settings import (
    SHRINKAGE_KEYS,
    EngineSettings,
    build_engine_settings,
    find_shrinkage_scale,
)
from slicing.settings.formula import Formula
from slicing.settings.layer_heights import LayerFit, LayerHeights
from slicing.settings.limits import MAX_LAYER_SHARE, Violation, find_reserved_reason, find_violations
from slicing.settings.qualities import (
    DEFAULT_QUALITY,
    DEPENDENT_SPEEDS,
    FARM_QUALITIES,
    SUPPORT_VALUES,
    HiddenLayers,
    Quality,
)
from slicing.settings.resolver import ProfileIndex, ProfileValues, Resolver
from slicing.settings.resources import Resources
from slicing.settings.stacks import Stacks, find_stacks

# Values that a streamed file needs.
_STREAMED_VALUES: Mapping[str, Any] = {
    "machine_firmware_retract": False,
    "machine_center_is_zero": False,
    "material_bed_temp_prepend": False,
    "material_print_temp_prepend": False,
    "relative_extrusion": False,
}


_COMBING = "retraction_combing"
_SKIN_COMBING = "no_outer_surfaces"  # the head retracts before it travels over the uppermost skin
_WALL_KEYS = {"wall_line_count", "wall_thickness"}  # if a user sets one, inner walls are kept on all sides


@dataclass(frozen=True, slots=True)
class SettingsRequest:
    """Choice of printer model, quality, material, nozzle and overrides.

    With `has_support`, supports are printed even with Cura's own qualities, which have none. `overrides` take
    precedence.
    """

    printer: PrinterModel
    quality: str = DEFAULT_QUALITY
    material: str = "generic_pla"
    nozzle_mm: float = 0.4
    overrides: Mapping[str, Any] = field(default_factory=dict)
    has_support: bool = False


@dataclass(frozen=True, slots=True)
class PartSettings:
    """Settings of one part; None keeps the value of the quality. A user's own settings override them.

    Attributes
    ----------
    height_mm
        Height of the print.
    brim_width_mm
        Width of its brim; 0 for none. It is never wider than that of the quality, from which the
        usable build volume is computed.
    layer_0_expansion_mm
        Horizontal expansion of the first layer on each side; negative to compensate for elephant's foot.
    bed_face_hidden, tops_hidden
        Whether the faces on the bed, and all top faces, are hidden once the parts are glued. Hidden faces get
        the layers of `Quality.hidden_layers`, and hidden tops get no slow uppermost layer.
    flat_tops_visible
        Whether flat tops remain visible. If not, the lines of the uppermost layer of tops are not printed in
        the order of their positions (`Quality.orders_only_flat_tops`).
    support_angle_deg
        Angle from the vertical above which its faces get support.
    """

    height_mm: float | None = None
    brim_width_mm: float | None = None
    layer_0_expansion_mm: float | None = None
    bed_face_hidden: bool = False
    tops_hidden: bool = False
    flat_tops_visible: bool = True
    support_angle_deg: float | None = None


DEFAULT_PART = PartSettings()


def resolve_settings(
    request: SettingsRequest, resources: Resources, part: PartSettings = DEFAULT_PART
) -> EngineSettings:
    """Resolve a request against Cura's files, for any part or for a given one; recent results are cached.

    Parameters
    ----------
    request
        Printer model, quality, material, nozzle and overrides.
    resources
        Cura's files.
    part
        Settings of one part.

    Raises
    ------
    BadSetting
        If the model, quality, material, nozzle or an override does not exist or does not fit.
    ResourcesMissing, DefinitionError
        If Cura's files are not as expected.
    """
    request_key = _RequestKey.from_request(request)
    default_settings = _resolve_settings(resources, request_key, DEFAULT_PART, None)
    layer_fit = _find_layer_fit(request, default_settings)
    heights = None if layer_fit is None or part.height_mm is None else layer_fit.fit(part.height_mm)
    part = replace(part, height_mm=None)
    settings = _resolve_settings(resources, request_key, part, heights)
    if settings.brim_width_mm > default_settings.brim_width_mm:
        settings = _resolve_settings(resources, request_key, replace(part, brim_width_mm=None), heights)
    return replace(settings, layer_fit=layer_fit)


def _find_layer_fit(request: SettingsRequest, settings: EngineSettings) -> LayerFit | None:
    """Find the rule that fits layers to parts; None if the quality or the user sets their height."""
    quality = FARM_QUALITIES.get(request.quality)
    if quality is None or not quality.fits_layers or _has_user_heights(request):
        return None
    return LayerFit(
        LayerHeights(settings.layer_height_0_mm, settings.layer_height_mm),
        0.0 if "layer_height_0" in request.overrides else MAX_LAYER_SHARE * request.nozzle_mm,
    )


def _has_user_heights(request: SettingsRequest) -> bool:
    """Check whether the user has set layer heights, or which layers are printed."""
    return not request.overrides.keys().isdisjoint(
        ("layer_height", "adaptive_layer_height_enabled", "slicing_tolerance")
    )


@dataclass(frozen=True, slots=True)
class _RequestKey:
    """Request as a key of a cache."""

    printer: PrinterModel
    quality: str
    material: str
    nozzle_mm: float
    overrides: tuple[tuple[str, str], ...]
    has_support: bool

    @classmethod
    def from_request(cls, request: SettingsRequest) -> _RequestKey:
        overrides = tuple(sorted((key, str(raw)) for key, raw in request.overrides.items()))
        return cls(
            printer=request.printer,
            quality=request.quality,
            material=request.material,
            nozzle_mm=request.nozzle_mm,
            overrides=overrides,
            has_support=request.has_support,
        )


@lru_cache(maxsize=64)
def _resolve_settings(
    resources: Resources, request_key: _RequestKey, part: PartSettings, heights: LayerHeights | None
) -> EngineSettings:
    stacks = find_stacks(
        resources, request_key.printer.name, request_key.nozzle_mm, request_key.material, request_key.quality
    )
    resolver = _build_resolver(stacks, request_key, part, heights)
    user_keys = [key for key, _ in request_key.overrides]
    try:
        for violation in find_violations(resolver, request_key.printer, user_keys=user_keys):
            if violation.is_farm_limit or not _is_cura_value(violation, resources, request_key):
                raise BadSetting(_describe_refusal(violation, request_key))
    except DefinitionError as error:
        if not user_keys:
            raise
        raise BadSetting(f"with the given {', '.join(user_keys)}: {error}") from error
    quality = FARM_QUALITIES.get(request_key.quality)
    compensates_shrinkage = (
        quality is not None and quality.compensates_shrinkage and {*SHRINKAGE_KEYS}.isdisjoint(user_keys)
    )
    scale = find_shrinkage_scale(resolver, stacks.material.kind if compensates_shrinkage else "")
    settings = build_engine_settings(request_key.printer, resolver, stacks.material.density_g_cm3, scale)
    if quality is None:
        return settings
    settings = replace(
        settings,
        hidden_wall_ratio=quality.hidden_wall_ratio,
        has_single_hidden_walls=quality.has_single_hidden_walls and _WALL_KEYS.isdisjoint(user_keys),
        small_overhang_deg=_find_small_overhang_deg(settings, quality, user_keys),
    )
    if quality.orders_only_flat_tops and not part.flat_tops_visible and "roofing_monotonic" not in user_keys:
        settings = replace(settings, extruder={**settings.extruder, "roofing_monotonic": "False"})
    return _reduce_hidden_layers(settings, quality.hidden_layers, part, user_keys)


def _find_small_overhang_deg(settings: EngineSettings, quality: Quality, user_keys: Collection[str]) -> float:
    """Find the angle up to which small overhangs get no support; 0 to support all of them."""
    has_full_fan = float(settings.extruder["cool_fan_speed"]) >= 100.0
    return quality.small_overhang_deg if has_full_fan and "support_angle" not in user_keys else 0.0


def _reduce_hidden_layers(
    settings: EngineSettings,
    hidden_layers: HiddenLayers | None,
    part: PartSettings,
    user_keys: Collection[str],
) -> EngineSettings:
    """Reduce the number of solid layers at the hidden faces of a part, and retractions on hidden tops.

    CuraEngine takes `initial_bottom_layers` from the bed up; undersides above it keep `bottom_layers`.
    Scratches do not matter on hidden tops, so the head may travel over them without a retraction.
    """
    if hidden_layers is None:
        return settings
    reduced_layers = HiddenLayers(
        min(hidden_layers.bed_layers, settings.bottom_layers),
        min(hidden_layers.top_layers, settings.top_layers),
    )
    changes: dict[str, str] = {}
    if part.bed_face_hidden:
        changes["initial_bottom_layers"] = str(reduced_layers.bed_layers)
    if part.tops_hidden:
        changes |= {"top_layers": str(reduced_layers.top_layers), "roofing_layer_count": "0"}
        is_monotonic = settings.extruder["skin_monotonic"] == "True"  # Cura's own formula is the same
        if not is_monotonic and settings.global_[_COMBING] == _SKIN_COMBING and _COMBING not in user_keys:
            settings = replace(settings, global_={**settings.global_, _COMBING: "all"})
    return replace(settings, hidden_layers=reduced_layers, extruder={**settings.extruder, **changes})


def _is_cura_value(violation: Violation, resources: Resources, request_key: _RequestKey) -> bool:
    """Check whether a value beyond Cura's limits comes from Cura's own profiles, which Cura accepts."""
    default_key = replace(request_key, overrides=())
    stacks = find_stacks(
        resources, request_key.printer.name, request_key.nozzle_mm, request_key.material, request_key.quality
    )
    if (
        request_key.material in resources.list_own_material_names()
        and violation.key in stacks.material.values
    ):
        return False
    return bool(
        _build_resolver(stacks, default_key, DEFAULT_PART, None).compute_value(violation.scope, violation.key)
        == violation.value
    )


def _describe_refusal(violation: Violation, request_key: _RequestKey) -> str:
    value = f"{violation.value:.6g}" if isinstance(violation.value, float) else violation.value
    keys = [key for key, _ in request_key.overrides]
    cause = "" if violation.key in keys else f" follows from {', '.join(keys)} and"
    if keys:
        return f"{violation.key}={value}{cause} is out of range; {violation.allowed_values}"
    source = f"{request_key.quality} with {request_key.material}"
    return (
        f"{violation.key}={value}, from {source}, is out of range; {violation.allowed_values}: choose "
        "another material or quality (only `farm slice` can set another value, "
        f"with --set {violation.key}=VALUE)"
    )


def _build_resolver(
    stacks: Stacks, request_key: _RequestKey, part: PartSettings, heights: LayerHeights | None
) -> Resolver:
    """Add the user's profile to the stacks: values of quality, part and streaming, and overrides."""
    user_values: dict[str, Any] = dict(SUPPORT_VALUES) if request_key.has_support else {}
    quality = FARM_QUALITIES.get(request_key.quality)
    if quality is not None:
        user_keys = {key for key, _ in request_key.overrides}
        user_values |= {
            key: value
            for key, value in quality.changes.items()
            if user_keys.isdisjoint(DEPENDENT_SPEEDS.get(key, ()))
        }
    user_values |= {
        **_build_part_values(part, heights),
        **_STREAMED_VALUES,
        "machine_gcode_flavor": request_key.printer.code.flavor,
    }
    profiles = {
        scope: {ProfileIndex.USER: user_values, **scope_profiles}
        for scope, scope_profiles in stacks.profiles.items()
    }
    resolver = Resolver(stacks.machine.settings, stacks.machine.extruder, profiles)
    for key, raw in request_key.overrides:
        setting = resolver.find_setting(key)
        reason = find_reserved_reason(key)
        if reason is not None:
            raise BadSetting(f"{key}: {reason}")
        user_values[key] = parse_value(setting, raw)
    return resolver


def _build_part_values(part: PartSettings, heights: LayerHeights | None) -> ProfileValues:
    values: dict[str, Any] = {}
    if heights is not None:
        values |= {"layer_height": heights.other_layers_mm, "layer_height_0": heights.first_layer_mm}
    if part.brim_width_mm is not None:
        values["adhesion_type"] = "brim" if part.brim_width_mm > 0 else "none"
        values["brim_width"] = part.brim_width_mm
    if part.support_angle_deg is not None:
        values["support_angle"] = part.support_angle_deg
    if part.layer_0_expansion_mm is not None:
        values["xy_offset_layer_0"] = Formula(f"xy_offset + ({part.layer_0_expansion_mm!r})")
    return values
