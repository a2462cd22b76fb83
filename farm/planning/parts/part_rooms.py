"""Part rooms of the fleet's printers, as fleet.yaml and `drivers.printers` have them."""

from __future__ import annotations

from functools import cache

from drivers.printers import PROFILES, RoomBox, part_room
from farm.config import PrinterSection
from slicing.settings import EngineSettings


def printer_room(section: PrinterSection, brim_mm: float) -> tuple[RoomBox, ...]:
    """Return the boxes that a part with a brim of `brim_mm` may fill on a printer."""
    return part_room(PROFILES[section.model], brim_mm, section.volume_mm)


def model_sizes(
    room: tuple[RoomBox, ...], settings: EngineSettings
) -> tuple[tuple[float, float, float], ...]:
    """Return the sizes (x, y, z) in mm that a part may have in the model: it shrinks in printing."""
    xy, z = settings.scale_xy, settings.scale_z
    return tuple((x / xy, y / xy, height / z) for x, y, height in (box.size_mm for box in room))


@cache
def bed_boxes(section: PrinterSection) -> tuple[tuple[float, float, float, float, float], ...]:
    """Return the boxes that may be printed in: min_x, min_y, max_x, max_y, height in bed-centred mm."""
    return tuple(
        (box.rect.min_x_mm, box.rect.min_y_mm, box.rect.max_x_mm, box.rect.max_y_mm, box.height_mm)
        for box in printer_room(section, brim_mm=0.0)
    )
