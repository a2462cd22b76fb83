"""Formula of the price of a part, for compiled code that also prices the boxes of a grid."""

from __future__ import annotations

import numpy as np

from decompose.arrays import Floats
from decompose.jit import jit

Prices = np.void
"""A record from `CostModel.build_prices`: compiled code reads its fields by name."""
AdditiveFeatures = tuple[float, float, float, float, float]
Extents = tuple[float, float, float]

MAX_INSET_SHARE = 0.1
"""Maximum time that is saved because inner walls are shorter than the outline, as a share of the time for
walls. A greater estimate is reduced to this share."""


@jit
def compute_price_s(prices: Prices, additive_features: AdditiveFeatures, extents_mm: Extents) -> float:
    """Compute the price of a part in one pose; tables of box prices use the same formula.

    Parameters
    ----------
    prices
        Record from `CostModel.build_prices`.
    additive_features
        `ADDITIVE_FEATURES`, in mm3, mm2, mm2, mm2 and mm3.
    extents_mm
        Width, depth and height.

    Returns
    -------
    float
        Price in seconds.
    """
    volume_mm3, lateral_mm2, skin_mm2, slope_mm2, column_mm3 = additive_features
    width_mm, depth_mm, height_mm = extents_mm
    brim_mm2 = prices["brim_mm"] * (2.0 * (width_mm + depth_mm) + np.pi * prices["brim_mm"])
    max_inset_s = MAX_INSET_SHARE * prices["lateral_s_per_mm2"] * lateral_mm2
    inset_s = min(prices["inset_s_per_mm"] * height_mm, max_inset_s)
    lines_s = prices["volume_s_per_mm3"] * volume_mm3 + prices["lateral_s_per_mm2"] * lateral_mm2 - inset_s
    skin_s = prices["skin_s_per_mm2"] * skin_mm2 - prices["skin_rim_s_per_mm"] * np.sqrt(skin_mm2)
    seconds: float = (
        prices["fixed_s"]
        + max(lines_s, prices["min_s_per_mm"] * height_mm)
        + max(0.0, skin_s)
        + prices["slope_s_per_mm2"] * slope_mm2
        + prices["overhang_s_per_mm3"] * column_mm3
        + prices["brim_s_per_mm2"] * brim_mm2
    )
    return seconds


@jit
def compute_prices_s(prices: Prices, additive_features: Floats, extents_mm: Floats) -> Floats:
    """Compute the prices (k,) of a part in k poses; see `CostModel.price_poses_s`."""
    seconds = np.zeros(len(extents_mm))
    for i in range(len(extents_mm)):
        f, e = additive_features[i], extents_mm[i]
        seconds[i] = compute_price_s(prices, (f[0], f[1], f[2], f[3], f[4]), (e[0], e[1], e[2]))
    return seconds
