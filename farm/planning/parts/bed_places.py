"""Places of parts on the beds of their printers, as `slice_part` will choose them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from decompose.export import PlaceFinder
from decompose.printers import BedPlace
from decompose.results import Part
from drivers.printers import PROFILES, UsableVolume, place_part
from farm.config import PrinterSection
from farm.planning.printer_settings import find_usable_volumes, resolve_printer_settings
from slicing.settings import EngineSettings, Resources


@dataclass(frozen=True, slots=True)
class Bed:
    """Bed of a printer: width and depth in mm, boxes that a part may fill, and settings of the slicer."""

    size_mm: tuple[float, float]
    usable_volumes: tuple[UsableVolume, ...]
    settings: EngineSettings

    def place(self, part: Part) -> BedPlace | None:
        """Place a part as `slice_part` does; None if it does not fit."""
        scale = np.array((self.settings.scale_xy, self.settings.scale_xy, self.settings.scale_z))
        width_mm, depth_mm, height_mm = map(float, np.ptp(part.build_printing_mesh()[0], axis=0) * scale)
        placement = place_part((width_mm, depth_mm, height_mm), self.usable_volumes)
        if placement is None:
            return None
        return BedPlace(self.size_mm, (placement.x_mm, placement.y_mm), placement.is_rotated)


def find_beds(printers: Sequence[PrinterSection], quality: str, resources: Resources) -> dict[str, Bed]:
    """Return the bed of each printer, by the name of the printer."""
    beds = {}
    for section in printers:
        settings = resolve_printer_settings(section, quality, resources)
        usable_volumes = find_usable_volumes(section, settings.brim_width_mm)
        beds[section.name] = Bed(PROFILES[section.model].bed_mm, usable_volumes, settings)
    return beds


def make_place_finder(beds: Mapping[str, Bed]) -> PlaceFinder:
    """Make a function that finds the place of a part on its bed, or None if the bed is unknown."""

    def find_place(part: Part) -> BedPlace | None:
        bed = beds.get(part.printer)
        return None if bed is None else bed.place(part)

    return find_place
