"""Limits on settings: keys that a person must not set, and ranges of the printer and of Cura."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

from slicing.printer import PrinterModel
from slicing.settings.definitions import fits_type
from slicing.settings.resolver import Resolver, Scope

MAX_LAYER_SHARE = 0.8  # layer height, as a share of the nozzle diameter, above which Cura warns
_MAX_LINE_WIDTH_RATIO = 2.0  # ratio of line width to nozzle diameter above which Cura warns
_MAX_HOP_MM = 10.0
_MAX_FLOW_PERCENT = 150.0  # flow above which Cura warns, because a line cannot hold more
_MAX_EXTRA_PRIME_MM3 = 5.0  # extra volume at each retraction above which Cura warns

_PRINTER_REASON = "it describes the printer; choose another printer model or nozzle"
_STREAM_REASON = "set by this program, for streaming; leave it out"
_PLACE_REASON = "this program places the part; leave it out"
_FILE_REASON = "it names a file, which is not read; leave it out"
_ONE_MESH_REASON = "it is for one mesh among several, and a plate has one; leave it out"
_ONE_EXTRUDER_REASON = "it is for printers with several nozzles; leave it out"
_ONE_PART_REASON = "a plate has one part; leave it out"
_SHAPE_REASON = "it changes the shape of the part; leave it out"
_HEAT_REASON = "its temperatures are not checked; leave it out, and set material_print_temperature"
_MOTION_REASON = "accelerations depend on the printer and the material; leave it out"

_RESERVED_KEYS: Mapping[str, str] = {
    "material_diameter": _PRINTER_REASON,
    "gantry_height": _PRINTER_REASON,
    "material_guid": _PRINTER_REASON,
    **dict.fromkeys(
        (
            "machine_gcode_flavor",
            "machine_firmware_retract",
            "machine_start_gcode",
            "machine_end_gcode",
            "relative_extrusion",
            "material_bed_temp_prepend",
            "material_bed_temp_wait",
            "material_print_temp_prepend",
            "material_print_temp_wait",
            "prime_blob_enable",
            "clean_between_layers",
        ),
        _STREAM_REASON,
    ),
    "material_flow_dependent_temperature": _HEAT_REASON,
    "material_flow_temp_graph": _HEAT_REASON,
    "center_object": _PLACE_REASON,
    "cross_infill_density_image": _FILE_REASON,
    "cross_support_density_image": _FILE_REASON,
    "support_mesh": _ONE_MESH_REASON,
    "support_mesh_drop_down": _ONE_MESH_REASON,
    "support_meshes_present": _ONE_MESH_REASON,
    "anti_overhang_mesh": _ONE_MESH_REASON,
    "cutting_mesh": _ONE_MESH_REASON,
    "infill_mesh": _ONE_MESH_REASON,
    "infill_mesh_order": _ONE_MESH_REASON,
    "extruder_nr": _ONE_EXTRUDER_REASON,
    "extruders_enabled_count": _ONE_EXTRUDER_REASON,
    "ooze_shield_enabled": _ONE_EXTRUDER_REASON,
    "print_sequence": _ONE_PART_REASON,
    "mold_enabled": _SHAPE_REASON,
    "magic_spiralize": _SHAPE_REASON,
    "magic_mesh_surface_mode": _SHAPE_REASON,
    "wireframe_enabled": _SHAPE_REASON,
    "acceleration_enabled": _MOTION_REASON,
    "acceleration_travel_enabled": _MOTION_REASON,
    "jerk_enabled": _MOTION_REASON,
    "jerk_travel_enabled": _MOTION_REASON,
}
_RESERVED_PREFIXES: Mapping[str, str] = {
    "machine_": _PRINTER_REASON,
    "extruder_prime_pos_": _PRINTER_REASON,
    "nozzle_": _PRINTER_REASON,
    "mesh_": _PLACE_REASON,
    "prime_tower_": _ONE_EXTRUDER_REASON,
    "switch_extruder_": _ONE_EXTRUDER_REASON,
}


def find_reserved_reason(key: str) -> str | None:
    """Find the reason why a person must not set a key; None if it may be set."""
    if "_extruder_nr" in key:
        return _ONE_EXTRUDER_REASON
    reasons = (reason for prefix, reason in _RESERVED_PREFIXES.items() if key.startswith(prefix))
    return _RESERVED_KEYS.get(key) or next(reasons, None)


@dataclass(frozen=True, slots=True)
class Violation:
    """Value that has the wrong type, is not one of the setting's options, or is beyond a limit."""

    scope: Scope
    key: str
    value: Any
    allowed_values: str
    is_farm_limit: bool  # Cura's own profiles must not exceed it either


def find_violations(
    resolver: Resolver, printer: PrinterModel, user_keys: Collection[str] = ()
) -> Iterator[Violation]:
    """Find values beyond their limits in both stacks.

    Parameters
    ----------
    resolver
        All settings.
    printer
        The printer model, for its limits.
    user_keys
        Keys that a person has set; they are checked first, even if Cura disables them.
    """
    for scope in Scope:
        for key in {**dict.fromkeys(user_keys), **dict.fromkeys(resolver.list_keys(scope))}:
            for violation in _find_value_violations(resolver, printer, scope, key):
                if key in user_keys or violation.is_farm_limit or resolver.is_enabled(key):
                    yield violation


def _find_value_violations(
    resolver: Resolver, printer: PrinterModel, scope: Scope, key: str
) -> Iterator[Violation]:
    setting = resolver.find_setting(key)
    value = resolver.compute_value(scope, key)
    if value is None and setting.default is None:
        return
    if not fits_type(setting, value):
        allowed = (
            f"one of {', '.join(setting.options)}" if setting.options else f"a value of type {setting.type}"
        )
        yield Violation(scope, key, value, allowed, is_farm_limit=False)
        return
    if isinstance(value, bool | str) or not isinstance(value, int | float):
        return
    farm_bounds, cura_bounds = _find_farm_bounds(resolver, printer, key), resolver.compute_bounds(scope, key)
    for (minimum, maximum), is_farm_limit in ((farm_bounds, True), (cura_bounds, False)):
        low, high = (-inf if minimum is None else minimum), (inf if maximum is None else maximum)
        if not low <= value <= high:
            limits = (("at least", low), ("at most", high))
            allowed = ", ".join(f"{word} {_format_number(end)}" for word, end in limits if isfinite(end))
            yield Violation(scope, key, value, allowed, is_farm_limit)


def _find_farm_bounds(
    resolver: Resolver, printer: PrinterModel, key: str
) -> tuple[float | None, float | None]:
    nozzle_mm = float(resolver.compute_value(Scope.EXTRUDER, "machine_nozzle_size"))
    match key:
        case "layer_height" | "layer_height_0":
            return None, MAX_LAYER_SHARE * nozzle_mm
        case "retraction_amount":
            return 0.0, printer.code.park_retraction_mm
        case "retraction_extra_prime_amount" | "wipe_retraction_extra_prime_amount":
            return -_MAX_EXTRA_PRIME_MM3, _MAX_EXTRA_PRIME_MM3
        case "retraction_hop" | "wipe_hop_amount":
            return 0.0, _MAX_HOP_MM
        case _ if "line_width" in key and not key.endswith("_factor"):
            return None, _MAX_LINE_WIDTH_RATIO * nozzle_mm
        case "infill_overlap_mm" | "skin_overlap_mm" | "magic_fuzzy_skin_thickness":
            return None, _MAX_LINE_WIDTH_RATIO * nozzle_mm  # wider ones would lie outside the part
        case _ if key.endswith("_line_distance") and resolver.compute_value(Scope.EXTRUDER, key) > 0:
            return nozzle_mm / 2, None  # closer lines would lie on top of each other
        case _ if "material_flow" in key or key == "ironing_flow":
            return None, _MAX_FLOW_PERCENT
        case _ if "bed_temperature" in key:
            return 0.0, printer.limits.max_bed_c
        case _ if "print_temperature" in key or key == "material_standby_temperature":
            return 0.0, printer.limits.max_nozzle_c
    return None, None


def _format_number(number: float) -> str:
    return f"{number:.4g}"
