"""Dialects of emulated firmwares, by title."""

from drivers.emulator.firmware.dialects.dialect import Dialect
from drivers.emulator.firmware.dialects.marlin2 import MARLIN2
from drivers.emulator.firmware.dialects.ultimaker2 import ULTIMAKER2
from drivers.firmware import MARLIN2 as MARLIN2_FIRMWARE
from drivers.firmware import ULTIMAKER2 as ULTIMAKER2_FIRMWARE

DIALECTS: dict[str, Dialect] = {
    ULTIMAKER2_FIRMWARE.title: ULTIMAKER2,
    MARLIN2_FIRMWARE.title: MARLIN2,
}
