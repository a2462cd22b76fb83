"""Printer models: one module per model, listed here."""

from drivers.firmware import ULTIMAKER2 as ULTIMAKER2_FIRMWARE
from drivers.firmware import Firmware
from drivers.printers.ender3 import ENDER3
from drivers.printers.profile import HeaterModel, Profile, Rect
from drivers.printers.ultimaker2 import ULTIMAKER2
from drivers.printers.ultimaker2_extended import ULTIMAKER2_EXTENDED
from drivers.printers.ultimaker2_extended_plus import ULTIMAKER2_EXTENDED_PLUS
from drivers.printers.ultimaker2_go import ULTIMAKER2_GO
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS
from drivers.printers.usable_volumes import (
    FIT_TOLERANCE_MM,
    Placement,
    UsableVolume,
    list_usable_volumes,
    place_part,
)

__all__ = [
    "FIT_TOLERANCE_MM",
    "PROFILES",
    "SLICING_PROFILES",
    "HeaterModel",
    "Placement",
    "Profile",
    "Rect",
    "UsableVolume",
    "find_firmware",
    "list_usable_volumes",
    "place_part",
]

PROFILES: dict[str, Profile] = {
    profile.model: profile
    for profile in (ULTIMAKER2_PLUS, ULTIMAKER2_EXTENDED_PLUS, ULTIMAKER2, ULTIMAKER2_EXTENDED, ENDER3)
}
"""Printer models that can be driven."""

SLICING_PROFILES: dict[str, Profile] = {**PROFILES, ULTIMAKER2_GO.model: ULTIMAKER2_GO}
"""Printer models that can be sliced for."""


def find_firmware(model: str) -> Firmware:
    """Find the firmware of a model; the most common one for an unknown model, which must be stoppable."""
    profile = SLICING_PROFILES.get(model)
    return ULTIMAKER2_FIRMWARE if profile is None else profile.firmware
