"""The Ultimaker 2 Extended: 100 mm taller than the Ultimaker 2. Pure."""

from __future__ import annotations

from dataclasses import replace

from drivers.printers.ultimaker2 import ULTIMAKER2

ULTIMAKER2_EXTENDED = replace(
    ULTIMAKER2,
    model="ultimaker2_extended",
    title="Ultimaker 2 Extended",
    height_mm=305.0,
    home_mm=(0.0, 224.5, 320.0),
    max_position_mm=(230.0, 224.5, 330.0),
    banner_suffix="ex",
)
