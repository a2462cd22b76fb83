"""Print time that connectors add to a part, fitted to sliced parts (`bench.prices.joint_costs`).

Until the places of the connectors are known, `decompose.problem.connector_cost` estimates this time from
the area of the cut faces.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from decompose.arrays import Floats
from decompose.connectors import LEVEL_SIN, Connectors
from decompose.options import THIN_FILAMENT_MM

PRICES_S = {
    "groove upright": 2.6,
    "groove top": 10.9,
    "groove bed": 8.4,
    "groove upright thin": 1.5,  # for thin filament; estimated from the others, because few were sliced
    "groove top thin": 5.0,
    "groove bed thin": 5.0,
    "hole upright": 35.0,
    "hole top": 35.0,
    "hole bed": 35.0,
    "mark upright": 4.0,
    "mark top": 5.3,
    "mark bed": 2.4,
    "gutter mm": 0.0,  # they move the seams, which changes the time by -80 to +104 s, but not in the mean
    "sliding mm": 0.6,  # length by which the groove of a sliding key exceeds the key
}
"""Seconds for each hole, mark, and groove of a key, by the face in which it is: upright, top, or on the bed.

For gutters, and for the additional groove of a key that slides, seconds per mm of length.
"""


def count_tools(connectors: Connectors, part: int, up: Floats) -> Counter[str]:
    """Count the holes, grooves, marks and gutters of a part, by their keys in `PRICES_S`.

    Gutters are counted by their length in mm. For a sliding key, the length by which its groove exceeds the
    key is counted in addition.

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
