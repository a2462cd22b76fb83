"""Inputs of a decomposition for the printers of the fleet: part sizes, speeds and the cost model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from decompose.geometry import Solid
from decompose.options import ConnectorOptions, Options
from decompose.print_time import REFERENCE_SHRINKAGE, CostModel, PrintTimeSettings, estimate_feature_shares
from decompose.printers import TargetPrinter
from farm.config import PrinterSection
from farm.model import NOMINAL_TIME_FACTORS, JobOptions, Shares, TimeFactors
from farm.planning.plate_times import compute_overhead_s
from farm.planning.printer_settings import (
    find_usable_volumes,
    list_max_part_sizes_mm,
    resolve_printer_settings,
)
from slicing.glued_parts import removes_inner_walls
from slicing.settings import FARM_QUALITIES, SMALL_OVERHANG_MM2, EngineSettings, LayerFit, Resources

REMAINING_TRAVEL_SHARE = 0.25
"""Travel that remains where an inner wall is removed, as a share of that wall's length; the print order of
the remaining wall segments avoids the other travel. Fitted to the slices of 70 parts."""

PRICED_OVERHANG_SHARE = 0.8
"""Area up to which overhangs are small for prices, as a share of the area up to which they get no support. A
plan that relied on the exact limit would get a tower of support if the slicer measured slightly more."""


def build_target_printers(
    printers: Sequence[PrinterSection],
    time_factors: Mapping[str, float],
    quality: str,
    resources: Resources,
    round_count: int = 1,
) -> tuple[list[TargetPrinter], CostModel]:
    """Return the part sizes and the speed of each printer, the fastest first, and the cost model.

    Parameters
    ----------
    printers
        The printers; parts are priced with the settings of the first.
    time_factors
        Factor of each printer's time for the parts of the model, by name (`estimate_time_factors`).
    round_count
        Number of times that each printer is repeated in the list.
    """
    settings = {section.name: resolve_printer_settings(section, quality, resources) for section in printers}
    costs = [build_printer_cost(section, settings[section.name]) for section in printers]
    time_ratios = {
        section.name: time_factors[section.name] * compute_time_ratio(cost, costs[0])
        for section, cost in zip(printers, costs, strict=True)
    }
    # Sorted without the effect of the nozzle: a coarser one is faster, but must not be preferred.
    fastest = sorted(printers, key=lambda section: time_factors[section.name])
    target_printers = [
        TargetPrinter(
            section.name, list_max_part_sizes_mm(volumes, settings[section.name]), time_ratios[section.name]
        )
        for _ in range(round_count)
        for section in fastest
        for volumes in (find_usable_volumes(section, settings[section.name].brim_width_mm),)
    ]
    return target_printers, costs[0]


def estimate_time_factors(
    printers: Sequence[PrinterSection],
    time_factors: Mapping[str, TimeFactors],
    solid: Solid,
    quality: str,
    resources: Resources,
) -> dict[str, float]:
    """Estimate the time factor of each printer for the parts of a model, before it is cut.

    The decomposition assumes one speed for each printer: its speed for the features of the whole model.

    Parameters
    ----------
    time_factors
        See `DecomposeTask`.
    solid
        The model.
    """
    factors = {section.name: time_factors.get(section.name, NOMINAL_TIME_FACTORS) for section in printers}
    shares: Shares | None = None
    if any(factor.feature_factors is not None for factor in factors.values()):
        time_settings = build_print_time_settings(
            resolve_printer_settings(printers[0], quality, resources), overhead_s=0.0
        )
        share_by_feature = estimate_feature_shares(*solid.arrays(), time_settings)
        supports = share_by_feature["supports"] + share_by_feature["brim"]
        walls, infill, skins, travel = (
            share_by_feature[name] for name in ("walls", "infill", "skins", "travel")
        )
        shares = walls, infill, skins, supports, travel
    return {name: factor.compute_factor(shares) for name, factor in factors.items()}


def build_decompose_options(options: JobOptions, printers: Sequence[PrinterSection] = ()) -> Options:
    """Return the options for the decomposition of a job's model.

    Parameters
    ----------
    printers
        The printers that may print its parts. Holes for pins get the pin fits of these printers, unless the
        job has its own.
    """
    quality = FARM_QUALITIES.get(options.quality)
    fit_first_layer = quality is not None and quality.fits_first_layer
    fits_mm = {p.name: p.pin_fit_mm for p in printers if p.pin_fit_mm is not None}
    connectors = (
        ConnectorOptions(options.pin_mm, marks=options.marks, printer_fits_mm=tuple(sorted(fits_mm.items())))
        if options.pin_fit_mm is None
        else ConnectorOptions(options.pin_mm, options.pin_fit_mm, options.marks)
    )
    return Options(
        options.engine,
        fit_first_layer=fit_first_layer,
        prove=False,  # the proof of a lower bound would keep the user waiting
        connectors=select_connectors(connectors, options.quality),
    )


def select_connectors(connectors: ConnectorOptions, quality: str) -> ConnectorOptions:
    """Return the connectors for a quality: none for qualities that print parts as in the paper."""
    return ConnectorOptions() if quality in ("paper", "paper-hidden") else connectors


@dataclass(frozen=True, slots=True)
class _PartLayerHeight:
    """Layer height of a part in mm, as a function of its height in mm before shrinkage compensation."""

    layer_fit: LayerFit
    scale_z: float

    def __call__(self, height_mm: float) -> float:
        return self.layer_fit.fit(self.scale_z * height_mm).other_layers_mm


def build_print_time_settings(settings: EngineSettings, overhead_s: float) -> PrintTimeSettings:
    """Build the settings that determine the time of a print.

    Parameters
    ----------
    overhead_s
        Seconds of a plate in addition to its layers: heat-up, start and end code.
    """
    extruder, global_settings = settings.extruder, settings.global_
    is_connected = extruder["infill_pattern"] == "zigzag" or extruder["zig_zaggify_infill"] == "True"
    layer_fit = settings.layer_fit
    return PrintTimeSettings(
        layer_height_mm=settings.layer_height_mm if layer_fit is None else layer_fit.compute_mean_layer_mm(),
        fit_layer_mm=None if layer_fit is None else _PartLayerHeight(layer_fit, settings.scale_z),
        line_width_mm=settings.line_width_mm,
        outer_line_width_mm=settings.line_width_0_mm,
        wall_count=settings.wall_count,
        skin_layer_count=(settings.top_layers + settings.bottom_layers) / 2,
        saved_bed_layer_count=settings.bottom_layers - settings.hidden_layers.bed_layers,
        saved_top_layer_count=settings.top_layers - settings.hidden_layers.top_layers,
        infill_line_distance_mm=settings.infill_line_distance_mm,
        is_infill_connected=is_connected,
        infill_step_count=int(extruder["gradual_infill_steps"]),
        infill_step_mm=float(extruder["gradual_infill_step_height"]),
        support_line_distance_mm=settings.support_line_distance_mm,
        outer_wall_mm_s=settings.speed_wall_0_mm_s,
        inner_wall_mm_s=settings.speed_wall_x_mm_s,
        infill_mm_s=settings.speed_infill_mm_s,
        hidden_outer_wall_mm_s=settings.compute_hidden_wall_speed_mm_s(
            settings.speed_wall_0_mm_s, settings.line_width_0_mm
        ),
        hidden_inner_wall_mm_s=_find_hidden_inner_wall_mm_s(settings),
        skin_line_width_mm=float(extruder["skin_line_width"]),
        skin_mm_s=settings.speed_topbottom_mm_s,
        is_skin_connected=extruder["top_bottom_pattern"] == "zigzag",
        roof_line_width_mm=float(extruder["roofing_line_width"]),
        roof_layer_count=int(extruder["roofing_layer_count"]),
        roof_mm_s=float(extruder["speed_roofing"]),
        support_mm_s=settings.speed_support_mm_s,
        support_angle_deg=settings.support_angle_deg,
        small_overhang_deg=settings.small_overhang_deg,
        small_overhang_mm2=PRICED_OVERHANG_SHARE * SMALL_OVERHANG_MM2,
        brim_mm=settings.brim_width_mm if global_settings["adhesion_type"] == "brim" else 0.0,
        brim_mm_s=settings.speed_layer_0_mm_s,
        first_line_ratio=float(extruder["initial_layer_line_width_factor"]) / 100.0,
        slow_layer_count=int(float(global_settings["speed_slowdown_layers"])),
        travel_mm_s=settings.speed_travel_mm_s,
        retraction_s=_compute_retraction_s(extruder),
        acceleration_mm_s2=float(global_settings["machine_acceleration"]),
        min_layer_s=float(extruder["cool_min_layer_time"]),
        shrinkage=settings.scale_xy - 1.0 or REFERENCE_SHRINKAGE,
        overhead_s=overhead_s,
    )


def _find_hidden_inner_wall_mm_s(settings: EngineSettings) -> float:
    """Return the speed along the inner wall of a hidden side, in mm/s.

    If that wall is removed, this is the speed at which its length takes as long as the remaining travel.
    """
    if removes_inner_walls(settings):
        return settings.speed_travel_mm_s / REMAINING_TRAVEL_SHARE
    return settings.compute_hidden_wall_speed_mm_s(settings.speed_wall_x_mm_s, settings.line_width_mm)


def _compute_retraction_s(extruder: Mapping[str, str]) -> float:
    """Compute the duration of a retraction and unretraction, in seconds; 0 if retraction is disabled."""
    if extruder["retraction_enable"] != "True":
        return 0.0
    speeds_mm_s = (float(extruder[f"retraction_{direction}_speed"]) for direction in ("retract", "prime"))
    return sum(float(extruder["retraction_amount"]) / max(speed_mm_s, 0.1) for speed_mm_s in speeds_mm_s)


def build_printer_cost(section: PrinterSection, settings: EngineSettings) -> CostModel:
    """Return the cost model of a printer, including heat-up, start and end code."""
    return CostModel.from_settings(build_print_time_settings(settings, compute_overhead_s(section, settings)))


def compute_time_ratio(cost: CostModel, reference: CostModel) -> float:
    """Return the time that one cost model estimates for a 50 mm cube, divided by that of a reference."""
    # Volume in mm3; areas of the sides, skins and slopes in mm2; volume of the supports in mm3.
    cube_features = (125_000.0, 10_000.0, 5_000.0, 0.0, 0.0)
    size_mm = (50.0, 50.0, 50.0)
    return cost.price_part_s(cube_features, size_mm) / reference.price_part_s(cube_features, size_mm)
