"""Input of CuraEngine: every value of both stacks as text, and the numbers that other packages use."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from slicing.errors import BadSetting
from slicing.printer import PrinterModel
from slicing.settings.layer_heights import LayerFit
from slicing.settings.material import NO_SHRINKAGE, find_shrinkage_factors
from slicing.settings.qualities import HiddenLayers, compute_fast_flow_mm3_s
from slicing.settings.resolver import Resolver, Scope

SHRINKAGE_KEYS = (
    "material_shrinkage_percentage",
    "material_shrinkage_percentage_xy",  # from Cura 5 on
    "material_shrinkage_percentage_z",
)
"""Cura's own settings that scale parts to compensate for shrinkage, in percent."""
# Number of directions in which a pattern has lines `infill_line_distance` apart (Cura's formula for that
# setting).
_DIRECTION_COUNTS = {
    "grid": 2,
    "tetrahedral": 2,
    "quarter_cubic": 2,
    "triangles": 3,
    "trihexagon": 3,
    "cubic": 3,
    "cubicsubdiv": 3,
}


# Fields of `EngineSettings` that are unchanged values of Cura's settings.
_KEYS = {
    "layer_height_mm": "layer_height",
    "layer_height_0_mm": "layer_height_0",
    "line_width_mm": "wall_line_width_x",
    "line_width_0_mm": "wall_line_width_0",
    "support_angle_deg": "support_angle",
    "speed_wall_0_mm_s": "speed_wall_0",
    "speed_wall_x_mm_s": "speed_wall_x",
    "speed_infill_mm_s": "speed_infill",
    "infill_line_width_mm": "infill_line_width",
    "speed_topbottom_mm_s": "speed_topbottom",
    "speed_support_mm_s": "speed_support",
    "speed_layer_0_mm_s": "speed_layer_0",
    "speed_travel_mm_s": "speed_travel",
    "nozzle_c": "material_print_temperature_layer_0",
    "filament_diameter_mm": "material_diameter",
}


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Every setting as CuraEngine reads it, and the numbers that other packages use."""

    printer: PrinterModel
    global_: dict[str, str]
    extruder: dict[str, str]
    layer_height_mm: float
    layer_height_0_mm: float
    line_width_mm: float  # of the inner walls
    line_width_0_mm: float  # of the outer wall
    wall_count: int
    top_layers: int
    bottom_layers: int
    infill_line_distance_mm: float  # mean spacing of the lines of all directions; 0 without infill
    support_enabled: bool
    support_angle_deg: float  # from the vertical
    support_line_distance_mm: float  # 0 without support
    speed_wall_0_mm_s: float
    speed_wall_x_mm_s: float
    speed_infill_mm_s: float
    infill_line_width_mm: float
    speed_topbottom_mm_s: float
    speed_support_mm_s: float
    speed_layer_0_mm_s: float
    speed_travel_mm_s: float
    brim_width_mm: float  # as printed: whole lines of brim, or the skirt with its gap
    nozzle_c: float  # of the first layer
    bed_c: float  # of the first layer
    density_g_cm3: float
    filament_diameter_mm: float
    scale_xy: float  # factors by which a part is printed larger, because it shrinks
    scale_z: float
    hidden_layers: HiddenLayers  # solid layers at the hidden faces of a part
    hidden_wall_ratio: float = 1.0  # maximum ratio of the speed of walls on hidden sides to that of others
    # Whether inner walls are left out along hidden sides, where infill supports the outer walls.
    has_single_hidden_walls: bool = False
    # Angle from the vertical up to which faces get no support if they are small; 0 to support all of them.
    small_overhang_deg: float = 0.0
    # Rule by which the layers are fitted to the height of a part; None to leave them as they are.
    layer_fit: LayerFit | None = None

    def compute_hidden_wall_speed_mm_s(self, speed_mm_s: float, line_width_mm: float) -> float:
        """Compute the speed of a wall on hidden sides, limited to the flow of infill and of faster lines.

        Parameters
        ----------
        speed_mm_s
            Usual speed of the wall.
        line_width_mm
            Width of its lines.
        """
        infill_mm_s = self.speed_infill_mm_s * self.infill_line_width_mm / line_width_mm
        max_flow_mm3_s = compute_fast_flow_mm3_s(float(self.extruder["machine_nozzle_size"]))
        max_mm_s = min(infill_mm_s, max_flow_mm3_s / (line_width_mm * self.layer_height_mm))
        return max(speed_mm_s, min(self.hidden_wall_ratio * speed_mm_s, max_mm_s))

    @property
    def filament_mm2(self) -> float:
        """Cross-section of the filament."""
        return math.pi * self.filament_diameter_mm**2 / 4


def find_shrinkage_scale(resolver: Resolver, kind: str) -> tuple[float, float]:
    """Find the factors (XY, Z) by which a part is printed larger, because it shrinks.

    Parameters
    ----------
    resolver
        Cura's settings; their own factors take precedence.
    kind
        Kind of material, such as PLA; if it is empty, none of the farm's factors is used.
    """
    keys = resolver.list_keys(Scope.GLOBAL)
    uniform, xy, z = (
        float(resolver.compute_value(Scope.GLOBAL, key)) / 100 if key in keys else None
        for key in SHRINKAGE_KEYS
    )
    scale = (xy or uniform or 1.0, z or uniform or 1.0)
    return find_shrinkage_factors(kind) if scale == NO_SHRINKAGE else scale


def build_engine_settings(
    printer: PrinterModel, resolver: Resolver, density_g_cm3: float, scale: tuple[float, float]
) -> EngineSettings:
    """Build the engine's settings: every value of both stacks as text, with start and end code.

    Parameters
    ----------
    printer
        The printer model, for its start and end code.
    resolver
        All settings.
    density_g_cm3
        Density of the material.
    scale
        Factors (XY, Z) by which parts are printed larger.

    Raises
    ------
    BadSetting
        If a raft is requested.
    """
    global_, extruder = _format_scopes(resolver)
    values = _ExtruderValues(resolver)
    brim_width_mm = _compute_brim_mm(global_["adhesion_type"], values)
    has_support = values.read_flag("support_enable")
    direction_count = _DIRECTION_COUNTS.get(extruder["infill_pattern"], 1)
    top_layers, bottom_layers = (int(values.read_number(f"{side}_layers")) for side in ("top", "bottom"))
    settings = EngineSettings(
        printer=printer,
        global_=global_,
        extruder=extruder,
        wall_count=int(values.read_number("wall_line_count")),
        top_layers=top_layers,
        bottom_layers=bottom_layers,
        infill_line_distance_mm=values.read_number("infill_line_distance") / direction_count,
        support_enabled=has_support,
        support_line_distance_mm=values.read_number("support_line_distance") if has_support else 0.0,
        brim_width_mm=brim_width_mm,
        bed_c=values.read_bed_c(),
        density_g_cm3=density_g_cm3,
        scale_xy=scale[0],
        scale_z=scale[1],
        hidden_layers=HiddenLayers(bottom_layers, top_layers),
        has_single_hidden_walls=False,
        layer_fit=None,
        **{name: values.read_number(key) for name, key in _KEYS.items()},
    )
    global_["machine_start_gcode"] = _build_start_code(settings, values.read_number("machine_nozzle_size"))
    global_["machine_end_gcode"] = _build_end_code(printer, values)
    return settings


def _build_start_code(settings: EngineSettings, nozzle_mm: float) -> str:
    """Write the start code, and the nozzle, which the engine's Marlin header does not name."""
    code = settings.printer.code.build_start_code(settings.nozzle_c, settings.bed_c, settings.filament_mm2)
    return f";NOZZLE_DIAMETER:{nozzle_mm:g}\n{code}"


def _build_end_code(printer: PrinterModel, values: _ExtruderValues) -> str:
    """Write the end code, which retracts the filament as far as the settings do."""
    retracted_mm = values.read_number("retraction_amount") if values.read_flag("retraction_enable") else 0.0
    return printer.code.build_end_code(retracted_mm)


@dataclass(frozen=True, slots=True)
class _ExtruderValues:
    """Values of the extruder's stack by Cura's keys."""

    resolver: Resolver

    def read_bed_c(self) -> float:
        """Return the bed's temperature for the first layer; 0 without a heater."""
        has_heater = self.read_flag("machine_heated_bed")
        return self.read_number("material_bed_temperature_layer_0") if has_heater else 0.0

    def read_number(self, key: str) -> float:
        """Read a number."""
        return float(self.resolver.compute_value(Scope.EXTRUDER, key))

    def read_flag(self, key: str) -> bool:
        """Read a boolean."""
        return bool(self.resolver.compute_value(Scope.EXTRUDER, key))


def _format_scopes(resolver: Resolver) -> tuple[dict[str, str], dict[str, str]]:
    """Format the settings of the global scope and of the extruder's scope as text."""
    global_ = {
        key: _format_value(resolver.compute_value(Scope.GLOBAL, key))
        for key in resolver.list_keys(Scope.GLOBAL)
    }
    extruder = {
        key: _format_value(resolver.compute_value(Scope.EXTRUDER, key))
        for key in resolver.list_keys(Scope.EXTRUDER)
    }
    # The engine reads this key in both scopes, and prints no support if it is false in either.
    extruder["support_enable"] = global_["support_enable"]
    # The mesh is scaled before it is placed, because the checks compare the printed shape.
    full_size = dict.fromkeys(SHRINKAGE_KEYS, "100.0")
    global_ |= {key: full_size[key] for key in full_size.keys() & global_.keys()}
    extruder |= {key: full_size[key] for key in full_size.keys() & extruder.keys()}
    return global_, extruder


def _compute_brim_mm(adhesion: str, values: _ExtruderValues) -> float:
    """Compute the width of a brim, or of a skirt with its gap; 0 for neither. A raft is refused."""
    width_mm = (
        values.read_number("skirt_brim_line_width")
        * values.read_number("initial_layer_line_width_factor")
        / 100
    )
    match adhesion:
        case "raft":
            raise BadSetting(
                "adhesion_type=raft: a raft is not supported; set it to brim, or choose quality glue"
            )
        case "brim":
            return round(values.read_number("brim_line_count") * width_mm, 6)
        case "skirt":
            return round(
                values.read_number("skirt_gap") + values.read_number("skirt_line_count") * width_mm, 6
            )
    return 0.0


def _format_value(value: Any) -> str:
    """Format a value as CuraEngine reads it: numbers, booleans and lists as in Python."""
    return "" if value is None else str(value)
