"""The Ultimaker 2 Go: parts can be sliced for it, but it cannot be driven. Pure.

A session confirms that the heaters of nozzle and bed are off, but this bed has no heater. The answers of its
firmware are unknown.
"""

from __future__ import annotations

from dataclasses import replace

from drivers.printers.profile import Rect
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS

ULTIMAKER2_GO = replace(
    ULTIMAKER2_PLUS,
    model="ultimaker2_go",
    family="ultimaker2_go",
    title="Ultimaker 2 Go",
    bed_mm=(120.0, 120.0),
    height_mm=115.0,
    clips=(
        Rect(-60.0, 52.0, -33.0, 60.0),
        Rect(33.0, 52.0, 60.0, 60.0),
        Rect(-60.0, -60.0, -33.0, -52.0),
        Rect(33.0, -60.0, 60.0, -52.0),
    ),
)
