"""The part room of a printer of the fleet: the drivers' one function, with what `fleet.yaml` says of it."""

from __future__ import annotations

from drivers.profiles import PROFILES, RoomBox, part_room
from farm.config import PrinterSection


def printer_room(section: PrinterSection, brim_mm: float) -> tuple[RoomBox, ...]:
    """The boxes that a part with a brim of `brim_mm` may fill on this printer."""
    return part_room(PROFILES[section.model], brim_mm, section.volume_mm)


def printer_height_mm(section: PrinterSection) -> float:
    """The height of its part room."""
    height_mm = PROFILES[section.model].height_mm
    return min(height_mm, section.volume_mm[2]) if section.volume_mm else height_mm
