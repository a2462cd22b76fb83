"""The Ultimaker 2 Extended+: 100 mm taller than the 2+. Pure."""

from __future__ import annotations

from dataclasses import replace

from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS

ULTIMAKER2_EXTENDED_PLUS = replace(
    ULTIMAKER2_PLUS,
    model="ultimaker2_extended_plus",
    title="Ultimaker 2 Extended+",
    height_mm=305.0,
    home_mm=(0.0, 224.5, 315.0),
    max_position_mm=(230.0, 224.5, 325.0),
    banner_suffix="ex",
)
