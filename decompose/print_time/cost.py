"""Price of a part: its estimated print time in seconds, from features that need no slicing.

Two kinds of feature. The additive ones (`ADDITIVE`) are integrals over volume and surface: the sum over the
cells of a grid is that of a part, cut faces being ordinary faces, so that `grid.boxes` prices any box
from tables. The rest follows from the sums (`skin_rim_mm`) and from the extents of a part.

The time of each term is the length of its lines over their speed. Travel, acceleration and retraction, which
these omit, are in measured factors: `FACTORS`, by bench/prices/model.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import lru_cache

import numpy as np

from decompose.arrays import Floats
from decompose.jit import jit
from decompose.print_time.contours import Contours
from decompose.print_time.recipe import FACTORS, FEATURES, Recipe, time_terms
from decompose.print_time.thin_walls import ThinWalls

Prices = np.void
"""A record of `CostModel.prices`: compiled code reads its fields by name."""
Additive = tuple[float, float, float, float, float]
Extents = tuple[float, float, float]

MAX_INSET_SHARE = 0.1
"""Maximum share of the walls that insets save: beyond it the walls are as thick as the part."""


@dataclass(frozen=True, slots=True)
class CostModel:
    """Coefficients of the print time, in seconds per unit of a feature, and limits of the features.

    ``t = fixed + max(volume V + lateral L - inset H, least H) + skin S - rim sqrt(S) + slope X + overhang O
    + brim B``; see `ADDITIVE` for V, L, S, X and O. B is the ring of the brim about the part's rectangle in
    mm2, H the height in mm. Where a part's columns are known, `support_price_s` takes the place of O.

    On parts that the decomposition makes, each model held out from the fit, the mean error of a part with its
    own supports is 1.5 %, and 2.3 % at most in each of five settings, even if the fit uses only two of them;
    that of the tables, with supports down to the bed, is 2.8 % (bench/prices/model.py,
    bench/prices/print_time.csv).
    """

    fixed_s: float
    volume_s_mm3: float
    lateral_s_mm2: float
    skin_s_mm2: float
    slope_s_mm2: float
    overhang_s_mm3: float
    brim_s_mm2: float
    min_s_mm: float  # minimum time of the layers in a mm of height
    brim_mm: float
    supported_deg: float = 45.0  # faces at a larger angle from the vertical get support
    skin_cos: float = 0.7  # faces with a larger |n| get skin
    inset_s_mm: float = 0.0
    skin_rim_s_mm: float = 0.0
    support_s_mm3: float = 0.0
    support_side_s_mm2: float = 0.0
    tower_s_mm: float = 0.0
    island_s_mm: float = 0.0
    island_path_s_mm2: float = 0.0
    hole_s_mm: float = 0.0
    hole_path_s_mm2: float = 0.0
    rim_s_mm: float = 0.0
    rim_end_s_mm: float = 0.0
    ring_s_mm2: float = 0.0
    steep_top_s_mm2: float = 0.0
    bare_s_mm2: float = 0.0
    gap_s_mm2: float = 0.0
    full_s_mm2: float = 0.0
    overlap_s_mm3: float = 0.0
    line_mm: float = 0.0
    layer_mm: float = 1.0
    outer_walls_mm: float = 0.0  # width of the outer wall on both sides of a thin part
    walls_mm: float = 0.0  # width of all walls on both sides
    skins_mm: float = 0.0  # height of the skin on both sides of a sheet
    ring_cos: float = 1.0  # slopes with a larger n have denser infill below them
    hidden_bed_share: float = 0.0  # saved share of the skin of a hidden face on the bed; see `hidden_faces`
    hidden_top_share: float = 0.0  # saved share of the skin of hidden tops
    hidden_bed_mm: float = 0.0  # saved height of the skin of a hidden face on the bed
    hidden_top_mm: float = 0.0  # saved height of the skin of hidden tops
    hidden_side_share: float = 0.0  # saved share of the walls of a hidden upright side
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
            island_path_s_mm2=seconds["island_paths_mm2"],
            hole_s_mm=seconds["holes_mm"],
            hole_path_s_mm2=seconds["hole_paths_mm2"],
            rim_s_mm=max(0.0, -seconds["rim_mm"]),
            rim_end_s_mm=seconds["rim_ends_mm"],
            ring_s_mm2=seconds["ring_mm2"],
            steep_top_s_mm2=seconds["steep_top_mm2"],
            bare_s_mm2=seconds["bare_mm2"],
            gap_s_mm2=seconds["gap_mm2"],
            full_s_mm2=seconds["full_mm2"],
            overlap_s_mm3=seconds["overlap_mm3"],
            line_mm=recipe.line_width_mm,
            layer_mm=recipe.layer_height_mm,
            outer_walls_mm=2.0 * recipe.outer_line_width_mm,
            walls_mm=2.0 * recipe.walls_mm,
            skins_mm=2.0 * recipe.skin_layers * recipe.layer_height_mm,
            ring_cos=recipe.ring_cos,
            hidden_bed_share=recipe.hidden_bed_share,
            hidden_top_share=recipe.hidden_top_share,
            hidden_bed_mm=recipe.bed_layers_saved * recipe.layer_height_mm,
            hidden_top_mm=recipe.top_layers_saved * recipe.layer_height_mm,
            hidden_side_share=_divide(recipe.hidden_wall_s_mm2, seconds["lateral_mm2"]),
        )

    def price_support_s(
        self, support_mm3: float, side_mm2: float, towers_mm: float = 0.0, islands_mm: float = 0.0
    ) -> float:
        """Price a support by its volume, its upright sides, and the height of its towers and islands."""
        support = self.support_s_mm3 * support_mm3 + self.support_side_s_mm2 * side_mm2
        return support + self.tower_s_mm * towers_mm + self.island_s_mm * islands_mm

    def price_paths_s(self, islands_mm2: float, holes_mm: float, holes_mm2: float) -> float:
        """Price travel to islands and holes by height times distance, and to holes also by their height."""
        holes_s = self.hole_s_mm * holes_mm + self.hole_path_s_mm2 * holes_mm2
        return self.island_path_s_mm2 * islands_mm2 + holes_s

    def price_brim_s(self, brim_mm2: float, extents_mm: Floats) -> float:
        """Compute by how much a brim's price exceeds that of the rectangular brim that `price` assumes."""
        width, depth = extents_mm[:2]
        ring_mm2 = self.brim_mm * (2.0 * (width + depth) + math.pi * self.brim_mm)
        return float(self.brim_s_mm2 * (brim_mm2 - ring_mm2))

    def price_contours_s(self, contours: Contours, skin_mm2: float) -> float:
        """Price the contours of a part; its rims replace those of a single face, which `price` assumes."""
        skin_s = self.skin_s_mm2 * skin_mm2
        assumed_s = max(0.0, skin_s - self.skin_rim_s_mm * math.sqrt(max(0.0, skin_mm2)))
        rims_s = max(0.0, skin_s - self.rim_s_mm * contours.rim_mm) - assumed_s
        rings_s = self.ring_s_mm2 * contours.ring_mm2 + self.steep_top_s_mm2 * contours.steep_top_mm2
        return rims_s + self.rim_end_s_mm * contours.ends_mm + rings_s

    def price_thin_walls_s(self, thin: ThinWalls) -> float:
        """Compute the difference in price of thin walls and sheets to thick ones."""
        walls_s = self.bare_s_mm2 * thin.bare_mm2 + self.gap_s_mm2 * thin.gap_mm2
        return walls_s + self.full_s_mm2 * thin.full_mm2 + self.overlap_s_mm3 * thin.overlap_mm3

    def price_insets_s(self, lateral_mm2: float, height_mm: float, bodies_mm: float) -> float:
        """Compute the saving by shorter inner walls in all but one body of a layer, which `price` omits.

        Inner walls around a hole are longer: a hole counts as a negative body.
        """
        max_s = MAX_INSET_SHARE * self.lateral_s_mm2 * lateral_mm2
        body_s = min(self.inset_s_mm * height_mm, max_s)
        return min(self.inset_s_mm * (height_mm + bodies_mm), max_s) - body_s

    def prices(self) -> Prices:
        """Return the coefficients as a record for compiled code, one float64 a field, by their names."""
        return _make_record(self)

    def price_s(self, additive: Sequence[float] | Floats, extents_mm: Sequence[float] | Floats) -> float:
        """Price a part in one pose by its `ADDITIVE` features (5,) and width, depth, height (3,) in mm."""
        volume, lateral, skin, slope, column = map(float, additive)
        width, depth, height = map(float, extents_mm)
        return float(price(self.prices(), (volume, lateral, skin, slope, column), (width, depth, height)))


def _divide(saved_s: float, price_s: float) -> float:
    """Return the saved share of a price; 0 of no price."""
    return saved_s / price_s if price_s > 0.0 else 0.0


_PRICES = np.dtype([(item.name, np.float64) for item in fields(CostModel)])


@lru_cache(maxsize=64)
def _make_record(cost: CostModel) -> Prices:
    """Make the record of a cost; cached, because it takes as long as many prices."""
    record: Prices = np.array([astuple(cost)], dtype=_PRICES)[0]
    record.setflags(write=False)
    return record


@jit
def price(prices: Prices, additive: Additive, extents_mm: Extents) -> float:
    """Price a part in one pose: one formula for tables and parts.

    Parameters
    ----------
    prices
        Record of `CostModel.prices`.
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
