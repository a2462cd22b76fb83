"""Print time that connectors add to a part, fitted to slices of parts (`bench.prices.joint_costs`)."""

from __future__ import annotations

from collections import Counter

import numpy as np

from decompose.arrays import Floats
from decompose.connectors import LEVEL_SIN, Connectors
from decompose.options import THIN_FILAMENT_MM

PRICES_S = {
    "groove upright": 1.8,
    "groove top": 16.0,
    "groove bed": 29.0,
    "groove upright thin": 1.0,  # for thin filament; estimated from the others, because few were sliced
    "groove top thin": 5.0,
    "groove bed thin": 25.0,
    "hole upright": 35.0,
    "hole top": 35.0,
    "hole bed": 35.0,
    "mark upright": 2.4,
    "mark top": 8.5,
    "mark bed": 16.0,
    "gutter mm": 0.03,
    "sliding mm": 0.6,  # groove of a key that slides, beyond the length of the key
}
"""Seconds for each tool, by its kind and its face; for gutters and the grooves of keys that slide, per mm."""


def count_tools(connectors: Connectors, part: int, up: Floats) -> Counter[str]:
    """Count the tools of a part by the names of their prices.

    Gutters, and the grooves of keys that slide, are counted by their length in mm.

    Parameters
    ----------
    connectors
        Connectors of all parts.
    part
        Number of the part.
    up
        (3,) upward direction of the bed in the part's pose.
    """

    def name_price(kind: str, inward_normal: Floats, suffix: str = "") -> str:
        rise = float(inward_normal @ up)
        place = "upright" if abs(rise) < LEVEL_SIN else "bed" if rise > 0.0 else "top"
        return f"{kind} {place}{suffix}"

    amounts = Counter(
        name_price("hole", hole.inward_normal)
        if pin.key_direction is None
        else name_price("groove", hole.inward_normal, " thin" if pin.diameter_mm <= THIN_FILAMENT_MM else "")
        for pin in connectors.pins
        for hole in pin.holes
        if hole.part == part
    )
    amounts.update(
        name_price("mark", mark.grooves[0].inward_normal) for mark in connectors.marks if mark.part == part
    )
    length_mm = sum(
        float(np.linalg.norm(np.diff(gutter.line_mm, axis=0)))
        for gutter in connectors.gutters
        if gutter.part == part
    )
    sliding_mm = sum(
        float(np.ptp(hole.points_mm @ pin.rod_axis)) - pin.length_mm
        for pin in connectors.pins
        for hole in pin.holes
        if hole.part == part and hole.exit_direction is not None
    )
    return amounts + Counter({"gutter mm": round(length_mm), "sliding mm": round(sliding_mm)})


def price_connectors(connectors: Connectors, part: int, up: Floats) -> float:
    """Price the connectors of a part, in seconds of print time; the parameters are those of `count_tools`."""
    return sum(PRICES_S[name] * amount for name, amount in count_tools(connectors, part, up).items())
