"""Candidate printers of a job, their slicer settings, and the usable volumes above their beds."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from drivers.printers import PROFILES, Profile, UsableVolume, list_usable_volumes
from farm.config import PrinterSection
from farm.errors import RefusedError
from farm.model import JobOptions
from farm.planning.error_translation import translate_errors
from slicing.printer import HeadShape, MachineLimits, PrintCode, PrinterModel
from slicing.settings import EngineSettings, Resources, SettingsRequest, find_resources, resolve_settings


def list_matching_printers(printers: Sequence[PrinterSection], options: JobOptions) -> list[PrinterSection]:
    """Return the enabled printers that have a job's material and colour and that its option `only` allows.

    Raises
    ------
    RefusedError
        If there is no such printer; the message says why.
    """
    enabled_sections = [section for section in printers if section.enabled]
    matching_sections = [
        section
        for section in enabled_sections
        if section.has_material(options.material)
        and options.colour in (None, section.colour)
        and (not options.only or section.name in options.only)
    ]
    if not matching_sections:
        available = sorted({_describe_filament(section) for section in enabled_sections})
        filament = " ".join(filter(None, (options.material, options.colour)))
        if options.only:
            lack = f" or lacks {filament}" if filament else ""
            raise RefusedError(
                f"{' '.join(options.only)} is disabled{lack}: send the file to the address of another printer"
            )
        raise RefusedError(
            f"no printer of the fleet has {filament}; the fleet has {', '.join(available)}"
            if available
            else "all printers of the fleet are disabled"
        )
    return matching_sections


def _describe_filament(section: PrinterSection) -> str:
    return " ".join(filter(None, (section.colour, section.material_kind or section.material)))


def build_settings_request(section: PrinterSection, quality: str) -> SettingsRequest:
    """Build the request for a printer's slicer settings.

    Supports are on, because the choice of poses assumes them.
    """
    return SettingsRequest(
        build_slicing_printer(PROFILES[section.model]),
        quality,
        section.material,
        nozzle_mm=section.nozzle_mm,
        has_support=True,
    )


def resolve_printer_settings(section: PrinterSection, quality: str, resources: Resources) -> EngineSettings:
    """Resolve the slicer's settings for a printer. Raises FarmError with code `settings`."""
    with translate_errors():
        return resolve_settings(build_settings_request(section, quality), resources)


def check_settings(printers: Sequence[PrinterSection], options: JobOptions) -> None:
    """Check that all printers that a job may use can print in its quality; runs in a worker.

    Raises
    ------
    FarmError
        With code `refused` if no printer of the fleet matches, `settings` if the quality does not exist for a
        printer, `engine` if Cura's files are missing.
    """
    with translate_errors():
        resources = find_resources()
    for section in list_matching_printers(printers, options):
        resolve_printer_settings(section, options.quality, resources)


def build_slicing_printer(profile: Profile) -> PrinterModel:
    """Convert a printer profile to the slicing package's model: limits, start and end code."""
    return PrinterModel(
        name=profile.model,
        title=profile.title,
        slicer_names=profile.slicer_names,
        limits=MachineLimits(profile.max_nozzle_c, profile.max_bed_c, profile.min_extrusion_c),
        code=PrintCode(
            flavor=profile.gcode_flavor,
            start=profile.start_code,
            end=profile.end_code,
            prime_mm3=profile.prime_mm3,
            park_retraction_mm=profile.park_retraction_mm,
            start_position_mm=profile.start_position_mm,
        ),
        head=HeadShape(*profile.head_extent_mm, underside_mm=profile.head_above_nozzle_mm),
        retraction_mm=profile.retraction_mm,
        retraction_mm_s=profile.retraction_mm_s,
    )


def find_usable_volumes(section: PrinterSection, brim_mm: float) -> tuple[UsableVolume, ...]:
    """Return the boxes that a part with a brim of `brim_mm` may fill on a printer."""
    return list_usable_volumes(PROFILES[section.model], brim_mm, section.volume_mm)


def list_max_part_sizes_mm(
    usable_volumes: tuple[UsableVolume, ...], settings: EngineSettings
) -> tuple[tuple[float, float, float], ...]:
    """Return for each volume the largest size (x, y, z) of a part in mm, before shrinkage compensation."""
    xy, z = settings.scale_xy, settings.scale_z
    return tuple((x / xy, y / xy, height / z) for x, y, height in (box.size_mm for box in usable_volumes))


@cache
def list_bed_boxes(section: PrinterSection) -> tuple[tuple[float, float, float, float, float], ...]:
    """Return the boxes in which a printer can print.

    Each box is (min_x, min_y, max_x, max_y, height), in mm from the centre of the bed.
    """
    return tuple(
        (box.rect.min_x_mm, box.rect.min_y_mm, box.rect.max_x_mm, box.rect.max_y_mm, box.height_mm)
        for box in find_usable_volumes(section, brim_mm=0.0)
    )
