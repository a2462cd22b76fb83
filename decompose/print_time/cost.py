"""Price of a part: its estimated print time in seconds, from features that need no slicing.

Two kinds of feature. The additive ones (`ADDITIVE`) are integrals over volume and surface: the sum over the
cells of a grid is that of a part, cut faces being ordinary faces, so that `grid.boxes` prices any box
from tables. The rest follows from the sums (`skin_rim_mm`) and from the extents of a part.

The time of each term is the length of its lines over their speed. Travel, acceleration and retraction, which
these leave out, are in factors that were measured: `FACTORS`, by bench/print_time_model.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np

from decompose.arrays import Floats
from decompose.jit import jit
from decompose.print_time.recipe import FACTORS, FEATURES, Recipe, time_terms

Prices = np.void
"""A record of `CostModel.prices`: compiled code reads its fields by name."""
Additive = tuple[float, float, float, float, float]
Extents = tuple[float, float, float]

MAX_INSET_SHARE = 0.1
"""Maximum share of the walls that insets take off: beyond it they are as thick as the part."""


@dataclass(frozen=True, slots=True)
class CostModel:
    """Coefficients of the print time, in seconds per unit of a feature, and limits of the features.

    ``t = fixed + max(volume V + lateral L - inset H, least H) + skin S - rim sqrt(S) + slope X + overhang O
    + brim B``; see `ADDITIVE` for V, L, S, X and O. B is the ring of the brim about the part's rectangle in
    mm2, H the height in mm. Where a part's columns are known, `support_price_s` takes the place of O.

    Held out by model, over parts that the decomposition makes, a part with its own supports errs by 1.5 % on
    average, and in each of five settings by 2.3 % at most, also where three of them are not fitted on; the
    tables, with supports down to the bed, by 2.8 % (bench/print_time_model.py, bench/print_time.csv).
    """

    fixed_s: float
    volume_s_mm3: float
    lateral_s_mm2: float
    skin_s_mm2: float
    slope_s_mm2: float
    overhang_s_mm3: float
    brim_s_mm2: float
    min_s_mm: float  # the least time of the layers in a mm of height
    brim_mm: float
    supported_deg: float = 45.0  # faces that lean out further from the vertical get support
    skin_cos: float = 0.7  # faces with a larger |n| get skin
    inset_s_mm: float = 0.0
    skin_rim_s_mm: float = 0.0
    support_s_mm3: float = 0.0
    support_side_s_mm2: float = 0.0
    tower_s_mm: float = 0.0
    island_s_mm: float = 0.0
    hidden_bed_share: float = 0.0  # of the skin of a hidden face on the bed, saved; see `hidden_faces`
    hidden_top_share: float = 0.0  # of that of hidden tops
    shrinkage: float = 0.007  # decides the width of a brim against warping; not part of the price

    @property
    def overhang_cos(self) -> float:
        """Downward part of a face's unit normal above which it gets support."""
        return math.sin(math.radians(self.supported_deg))

    @classmethod
    def from_recipe(cls, recipe: Recipe, factors: Mapping[str, float] = FACTORS) -> CostModel:
        """Build the cost of print settings: their terms, each times its factor."""
        per_mm = sum(
            (factors[name] * vector for name, vector in time_terms(recipe).items()), np.zeros(len(FEATURES))
        )
        seconds = dict(zip(FEATURES, per_mm.tolist(), strict=True))
        return cls(
            fixed_s=recipe.prelude_s,
            volume_s_mm3=seconds["volume_mm3"],
            lateral_s_mm2=max(0.0, seconds["lateral_mm2"]),
            skin_s_mm2=max(0.0, seconds["skin_mm2"]),
            slope_s_mm2=seconds["slope_mm2"],
            overhang_s_mm3=seconds["column_mm3"],
            brim_s_mm2=seconds["brim_mm2"],
            min_s_mm=recipe.min_layer_s / recipe.layer_height_mm,
            brim_mm=recipe.brim_mm,
            supported_deg=recipe.supported_deg,
            shrinkage=recipe.shrinkage,
            skin_cos=recipe.skin_cos,
            inset_s_mm=max(0.0, -seconds["height_mm"]),
            skin_rim_s_mm=max(0.0, -seconds["skin_rim_mm"]),
            support_s_mm3=seconds["support_mm3"],
            support_side_s_mm2=seconds["support_side_mm2"],
            tower_s_mm=seconds["towers_mm"],
            island_s_mm=seconds["islands_mm"],
            hidden_bed_share=recipe.bed_layers_saved / max(recipe.skin_layers, 1.0),
            hidden_top_share=recipe.top_layers_saved / max(recipe.skin_layers, 1.0),
        )

    def support_price_s(
        self, support_mm3: float, side_mm2: float, towers_mm: float = 0.0, islands_mm: float = 0.0
    ) -> float:
        """Price a support by its volume, its upright sides, and the height of its towers and islands."""
        support = self.support_s_mm3 * support_mm3 + self.support_side_s_mm2 * side_mm2
        return support + self.tower_s_mm * towers_mm + self.island_s_mm * islands_mm

    def inset_price_s(self, lateral_mm2: float, height_mm: float, bodies_mm: float) -> float:
        """Compute the saving by shorter inner walls in all but one body of a layer, which `price` omits."""
        most_s = MAX_INSET_SHARE * self.lateral_s_mm2 * lateral_mm2
        one_s = min(self.inset_s_mm * height_mm, most_s)
        return min(self.inset_s_mm * (height_mm + bodies_mm), most_s) - one_s

    def prices(self) -> Prices:
        """Return the coefficients as a record for compiled code, one float64 a field, by their names."""
        record: Prices = np.array([astuple(self)], dtype=_PRICES)[0]
        return record

    def price_s(self, additive: Sequence[float] | Floats, extents_mm: Sequence[float] | Floats) -> float:
        """Price a part in one pose by its `ADDITIVE` features (5,) and width, depth, height (3,) in mm."""
        volume, lateral, skin, slope, column = map(float, additive)
        width, depth, height = map(float, extents_mm)
        return float(price(self.prices(), (volume, lateral, skin, slope, column), (width, depth, height)))


_PRICES = np.dtype([(item.name, np.float64) for item in fields(CostModel)])


@jit
def price(prices: Prices, additive: Additive, extents_mm: Extents) -> float:
    """Price a part in one pose: one formula for tables and parts.

    Parameters
    ----------
    prices
        Of `CostModel.prices`.
    additive
        `ADDITIVE` features, in mm3, mm2, mm2, mm2 and mm3.
    extents_mm
        Width, depth and height.

    Returns
    -------
    float
        Seconds.
    """
    volume, lateral, skin, slope, column = additive
    width, depth, height = extents_mm
    ring = prices["brim_mm"] * (2.0 * (width + depth) + np.pi * prices["brim_mm"])
    inset = min(prices["inset_s_mm"] * height, MAX_INSET_SHARE * prices["lateral_s_mm2"] * lateral)
    lines = prices["volume_s_mm3"] * volume + prices["lateral_s_mm2"] * lateral - inset
    body = max(lines, prices["min_s_mm"] * height)
    flat = max(0.0, prices["skin_s_mm2"] * skin - prices["skin_rim_s_mm"] * np.sqrt(skin))
    seconds: float = (
        prices["fixed_s"]
        + body
        + flat
        + prices["slope_s_mm2"] * slope
        + prices["overhang_s_mm3"] * column
        + prices["brim_s_mm2"] * ring
    )
    return seconds
