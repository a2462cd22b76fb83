"""The Ultimaker 2, the predecessor of the 2+. Pure.

It is [assumed] that its firmware has the serial code of the 2+ and marks an Extended in the same way. Its
feeder differs from that of the 2+; the firmware accounts for this.
"""

from __future__ import annotations

from dataclasses import replace

from drivers.printers.profile import Rect
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS

ULTIMAKER2 = replace(
    ULTIMAKER2_PLUS,
    model="ultimaker2",
    family="ultimaker2",
    title="Ultimaker 2",
    clips=(
        Rect(-115.0, 102.5, -82.0, 112.5),
        Rect(108.0, 102.5, 115.0, 112.5),
        Rect(-115.0, -112.5, -82.0, -104.5),
        Rect(108.0, -112.5, 115.0, -104.5),
    ),
    home_mm=(0.0, 224.5, 220.0),
    max_position_mm=(230.0, 224.5, 230.0),
)
