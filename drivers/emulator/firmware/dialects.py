"""Emulated firmwares by the title of the firmware, listed here."""

from drivers.emulator.firmware.dialect import Dialect
from drivers.emulator.firmware.ultimaker2 import ULTIMAKER2
from drivers.firmware import ULTIMAKER2 as ULTIMAKER2_FIRMWARE

DIALECTS: dict[str, Dialect] = {
    ULTIMAKER2_FIRMWARE.title: ULTIMAKER2,
}
