"""Firmwares of printers: one module a firmware."""

from drivers.firmware.firmware import Firmware, Identity
from drivers.firmware.ultimaker2 import ULTIMAKER2

__all__ = ["ULTIMAKER2", "Firmware", "Identity"]
