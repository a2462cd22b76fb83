"""A lower bound on the makespan from the surface and the volume that have to be printed."""

from __future__ import annotations

import math

from decompose.print_time import MAX_INSET_SHARE, CostModel


def surface_bound_s(area_mm2: float, volume_mm3: float, printers: int, cost: CostModel) -> float:
    """Lower bound in seconds on the makespan of any partition that prints this surface and volume.

    All of the surface is at best level skin or the flattest slope that has none; cuts, supports, brims and
    least times of layers only add. The work is shared by at most `printers` parts, each with its fixed time;
    what each saves by shorter inner walls, and where its walls cover the rim of its skin, is taken off.

    Parameters
    ----------
    area_mm2, volume_mm3
        Of the original surface, and of the solid that has to be printed.
    printers
        The greatest number of parts.
    cost
        Print time of a part.

    Returns
    -------
    float
        Seconds.
    """
    slope = cost.lateral_s_mm2 * math.sqrt(max(0.0, 1.0 - cost.skin_cos**2))
    surface = area_mm2 * min(slope, cost.skin_s_mm2)
    # c S - r sqrt(S) is at least (1 - k) c S - r^2 / (4 k c), for any share k.
    rim_s = cost.skin_rim_s_mm**2 / (4.0 * MAX_INSET_SHARE * cost.skin_s_mm2) if cost.skin_s_mm2 else 0.0
    shared_s = (1.0 - MAX_INSET_SHARE) * surface + cost.volume_s_mm3 * volume_mm3
    return cost.fixed_s + max(0.0, shared_s / printers - rim_s)
