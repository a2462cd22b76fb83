"""What a part costs: its print time in seconds, from features that need no slicing.

Two kinds of feature. The additive ones (`ADDITIVE`) are integrals over volume and surface: the sum over the
cells of a grid is that of a part, cut faces being ordinary faces, so that `decompose.boxes` prices any box
from tables. The rest follows from the sums (`skin_rim_mm`) and from the extents of a part.

The time of each term is the length of its lines over their speed. What lengths and speeds leave out (travel,
acceleration, retraction) is measured: `FACTORS`, by bench/print_time_model.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from decompose.arrays import Floats
from decompose.jit import jit
from decompose.print_time.recipe import FACTORS, FEATURES, Recipe, time_terms

MAX_INSET_SHARE = 0.1
"""Share of the walls that is lost so at most: beyond it they are as thick as the part."""


@dataclass(frozen=True, slots=True)
class CostModel:
    """Coefficients of the print time, in seconds for each unit of a feature, and what the features depend on.

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
    least_s_mm: float  # the least time of the layers in a mm of height
    brim_mm: float
    supported_deg: float = 45.0  # faces that lean out further from the vertical get support
    skin_cos: float = 0.7  # faces with a larger |n| get skin
    inset_s_mm: float = 0.0
    skin_rim_s_mm: float = 0.0
    support_s_mm3: float = 0.0
    support_side_s_mm2: float = 0.0
    tower_s_mm: float = 0.0
    island_s_mm: float = 0.0
    shrinkage: float = 0.007  # how wide a brim has to be against warping; no part of the price

    @property
    def overhang_cos(self) -> float:
        """Faces whose normal points down by more than this get support."""
        return math.sin(math.radians(self.supported_deg))

    @classmethod
    def from_recipe(cls, recipe: Recipe, factors: Mapping[str, float] = FACTORS) -> CostModel:
        """The terms of the settings, each times its factor."""
        each = sum(
            (factors[name] * vector for name, vector in time_terms(recipe).items()), np.zeros(len(FEATURES))
        )
        seconds = dict(zip(FEATURES, each.tolist(), strict=True))
        return cls(
            fixed_s=recipe.prelude_s,
            volume_s_mm3=seconds["volume_mm3"],
            lateral_s_mm2=max(0.0, seconds["lateral_mm2"]),
            skin_s_mm2=max(0.0, seconds["skin_mm2"]),
            slope_s_mm2=seconds["slope_mm2"],
            overhang_s_mm3=seconds["column_mm3"],
            brim_s_mm2=seconds["brim_mm2"],
            least_s_mm=recipe.least_layer_s / recipe.layer_height_mm,
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
        )

    def support_price_s(
        self, support_mm3: float, side_mm2: float, towers_mm: float = 0.0, islands_mm: float = 0.0
    ) -> float:
        """The time of a support of this volume and these upright sides, with towers and islands this high."""
        support = self.support_s_mm3 * support_mm3 + self.support_side_s_mm2 * side_mm2
        return support + self.tower_s_mm * towers_mm + self.island_s_mm * islands_mm

    def coefficients(self) -> Floats:
        """The coefficients in the order of the fields, for compiled code."""
        return np.array([getattr(self, f.name) for f in fields(self)], dtype=np.float64)

    def price_s(self, additive: Sequence[float] | Floats, extents: Sequence[float] | Floats) -> float:
        """The print time for one pose: `ADDITIVE` features (5,), and width, depth and height in mm."""
        c = self.coefficients()
        return float(price(c, *map(float, additive), *map(float, extents)))


@jit
def price(
    c: Floats,
    volume: float,
    lateral: float,
    skin: float,
    slope: float,
    column: float,
    width: float,
    depth: float,
    height: float,
) -> float:
    """Seconds, by `CostModel.coefficients`: one formula for tables and parts."""
    ring = c[8] * (2.0 * (width + depth) + np.pi * c[8])
    inset = min(c[11] * height, MAX_INSET_SHARE * c[2] * lateral)
    body = max(c[1] * volume + c[2] * lateral - inset, c[7] * height)
    flat = max(0.0, c[3] * skin - c[12] * np.sqrt(skin))
    seconds: float = c[0] + body + flat + c[4] * slope + c[5] * column + c[6] * ring
    return seconds
