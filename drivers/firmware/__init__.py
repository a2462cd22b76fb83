"""Firmwares of printers: one module per firmware."""

from drivers.firmware.firmware import Firmware, Identity
from drivers.firmware.marlin2 import MARLIN2
from drivers.firmware.ultimaker2 import ULTIMAKER2

__all__ = ["MARLIN2", "ULTIMAKER2", "Firmware", "Identity"]
