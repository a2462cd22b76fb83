"""Price of a part: its estimated print time in seconds, from features that do not need slicing.

`ADDITIVE_FEATURES` are integrals over volume and surface. Cut faces count as ordinary faces, so these
features of a part are sums over the cells of a grid, and `grid.boxes` prices any box from tables. Of the
other features, `skin_rim_mm` follows from these sums, and the height and the brim follow from the extents of
the part. The rest are measured on a part in a pose.

The time of each term is the length of its lines over their speed. Measured factors (`FACTORS`, by
bench/prices/model.py) account for travel, acceleration and retraction, which these terms omit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from decompose.arrays import Floats
from decompose.print_time.contours import Contours
from decompose.print_time.hidden_faces import SIDE_END_MM
from decompose.print_time.price_formula import MAX_INSET_SHARE, Prices, compute_prices_s
from decompose.print_time.surfaces import Surfaces
from decompose.print_time.thin_walls import ThinWalls
from decompose.print_time.time_settings import (
    FACTORS,
    FEATURES,
    LayerFitter,
    PrintTimeSettings,
    compute_time_terms,
)


@dataclass(frozen=True, slots=True)
class CostModel:
    """Coefficients of the print time, in seconds per unit of a feature, and limits of the features.

    ``t = fixed + max(volume V + lateral L - inset H, min H) + skin S - rim sqrt(S) + slope X + overhang O
    + brim B``. The words are coefficients. V, L, S, X and O are the `ADDITIVE_FEATURES` in their order. B is
    the area in mm2 of the brim around the part's bounding rectangle, and H is the height in mm. If the
    supports of a part are measured in its pose, `price_support_s` replaces the term of O. The inset term is
    the time that is saved because inner walls are shorter than the outline.

    The errors were measured on parts that the decomposition makes, with each model held out from the fit. If
    the supports of a part are measured in its pose, the mean error is 1.5 %. In each of five settings, it is
    at most 2.3 %, even if only two of the settings are used for the fit. Prices from tables assume supports
    down to the bed; their mean error is 3.7 % (bench/prices/model.py, bench/prices/print_time.csv).
    """

    fixed_s: float
    volume_s_per_mm3: float
    lateral_s_per_mm2: float
    skin_s_per_mm2: float
    slope_s_per_mm2: float
    overhang_s_per_mm3: float
    brim_s_per_mm2: float
    min_s_per_mm: float  # minimum time of the layers in a mm of height
    brim_mm: float  # width of the brim
    effective_support_angle_deg: float = 45.0  # see `PrintTimeSettings`; faces at a larger angle get support
    effective_small_overhang_deg: float = 0.0  # faces up to this angle get no support if their area is small
    small_overhang_mm2: float = 0.0  # faces between the two angles get support if they have this area
    skin_cos: float = 0.7  # faces with a larger |n| get skin; n is the upward component of the unit normal
    inset_s_per_mm: float = 0.0
    skin_rim_s_per_mm: float = 0.0
    support_s_per_mm3: float = 0.0
    support_side_s_per_mm2: float = 0.0
    tower_s_per_mm: float = 0.0
    island_s_per_mm: float = 0.0
    island_path_s_per_mm2: float = 0.0
    hole_s_per_mm: float = 0.0
    rim_s_per_mm: float = 0.0
    rim_end_s_per_mm: float = 0.0
    ring_s_per_mm2: float = 0.0
    steep_top_s_per_mm2: float = 0.0
    single_wall_s_per_mm2: float = 0.0
    gap_s_per_mm2: float = 0.0
    solid_wall_s_per_mm2: float = 0.0
    overlap_s_per_mm3: float = 0.0
    line_width_mm: float = 0.0
    layer_height_mm: float = 1.0
    outer_walls_mm: float = 0.0  # width of the outer wall lines on both sides of a thin wall together
    walls_mm: float = 0.0  # width of all wall lines on both sides together
    skins_mm: float = 0.0  # height of the skins on both sides of a sheet together
    ring_cos: float = 1.0  # slopes with a larger n have denser infill below them
    hidden_bed_share: float = 0.0  # share of a skin's time saved at a hidden face on the bed (`hidden_faces`)
    hidden_top_share: float = 0.0  # share of a skin's time saved at hidden tops
    hidden_bed_mm: float = 0.0  # height of skin saved at a hidden face on the bed
    hidden_top_mm: float = 0.0  # height of skin saved at hidden tops
    hidden_side_share: float = 0.0  # share of the time of walls saved at a hidden upright side
    connector_side_s_per_mm2: float = 0.0  # marks and pins in upright cut faces
    connector_level_s_per_mm2: float = 0.0  # marks and pins in other cut faces
    shrinkage: float = 0.007  # decides the width of a brim against warping; not part of the price
    fit_layer_mm: LayerFitter | None = None  # returns the layer height for a height of a part

    @property
    def overhang_cos(self) -> float:
        """Downward component of a face's unit normal above which the face gets support."""
        return math.sin(math.radians(self.effective_support_angle_deg))

    @property
    def table_overhang_cos(self) -> float:
        """The same component for tables of box prices, where it is not known whether overhangs are small."""
        return max(self.overhang_cos, math.sin(math.radians(self.effective_small_overhang_deg)))

    def find_overhang_cos(self, surfaces: Surfaces, up: Floats) -> float:
        """Find the downward component of unit normals above which the faces of a part get support in a pose.

        Parameters
        ----------
        surfaces
            Faces of the part.
        up
            (3,) unit vector that points up.
        """
        small_cos = self.table_overhang_cos
        if small_cos == self.overhang_cos:
            return small_cos
        down = -surfaces.normals @ up
        is_between = (down > self.overhang_cos) & (down <= small_cos)
        is_small = float(surfaces.areas_mm2[is_between].sum()) < self.small_overhang_mm2
        return small_cos if is_small else self.overhang_cos

    @classmethod
    def from_settings(cls, settings: PrintTimeSettings, factors: Mapping[str, float] = FACTORS) -> CostModel:
        """Build the cost model for print settings from the terms of the print time, each times its factor.

        Parameters
        ----------
        settings
            Settings of the slicer.
        factors
            Factor of each term.
        """
        vector = sum(
            (factors[name] * term for name, term in compute_time_terms(settings).items()),
            np.zeros(len(FEATURES)),
        )
        seconds = dict(zip(FEATURES, vector.tolist(), strict=True))
        return cls(
            fixed_s=settings.overhead_s,
            volume_s_per_mm3=seconds["volume_mm3"],
            lateral_s_per_mm2=max(0.0, seconds["lateral_mm2"]),
            skin_s_per_mm2=max(0.0, seconds["skin_mm2"]),
            slope_s_per_mm2=seconds["slope_mm2"],
            overhang_s_per_mm3=seconds["column_mm3"],
            brim_s_per_mm2=seconds["brim_mm2"],
            min_s_per_mm=settings.min_layer_s / settings.layer_height_mm,
            brim_mm=settings.brim_mm,
            effective_support_angle_deg=settings.effective_support_angle_deg,
            effective_small_overhang_deg=settings.effective_small_overhang_deg,
            small_overhang_mm2=settings.small_overhang_mm2,
            shrinkage=settings.shrinkage,
            fit_layer_mm=settings.fit_layer_mm,
            skin_cos=settings.skin_cos,
            inset_s_per_mm=max(0.0, -seconds["height_mm"]),
            skin_rim_s_per_mm=max(0.0, -seconds["skin_rim_mm"]),
            support_s_per_mm3=seconds["support_mm3"],
            support_side_s_per_mm2=seconds["support_side_mm2"],
            tower_s_per_mm=seconds["towers_mm"],
            island_s_per_mm=seconds["islands_mm"],
            island_path_s_per_mm2=seconds["island_paths_mm2"],
            hole_s_per_mm=seconds["holes_mm"],
            rim_s_per_mm=max(0.0, -seconds["rim_mm"]),
            rim_end_s_per_mm=seconds["rim_ends_mm"],
            ring_s_per_mm2=seconds["ring_mm2"],
            steep_top_s_per_mm2=seconds["steep_top_mm2"],
            single_wall_s_per_mm2=seconds["single_wall_mm2"],
            gap_s_per_mm2=seconds["gap_mm2"],
            solid_wall_s_per_mm2=seconds["solid_wall_mm2"],
            overlap_s_per_mm3=seconds["overlap_mm3"],
            line_width_mm=settings.line_width_mm,
            layer_height_mm=settings.layer_height_mm,
            outer_walls_mm=2.0 * settings.outer_line_width_mm,
            walls_mm=2.0 * settings.wall_thickness_mm,
            skins_mm=2.0 * settings.skin_layer_count * settings.layer_height_mm,
            ring_cos=settings.ring_cos,
            hidden_bed_share=settings.hidden_bed_share,
            hidden_top_share=settings.hidden_top_share,
            hidden_bed_mm=settings.saved_bed_layer_count * settings.layer_height_mm,
            hidden_top_mm=settings.saved_top_layer_count * settings.layer_height_mm,
            hidden_side_share=_compute_saved_share(settings.hidden_wall_s_per_mm2, seconds["lateral_mm2"]),
        )

    def fit_layers(self, height_mm: float) -> CostModel:
        """Return the cost model of a part whose layers are fitted to its height.

        Parameters
        ----------
        height_mm
            Height of the part.
        """
        if self.fit_layer_mm is None:
            return self
        layer_height_mm = self.fit_layer_mm(height_mm)
        ratio = self.layer_height_mm / layer_height_mm
        scaled_prices = {name: ratio * getattr(self, name) for name in _LAYER_PRICE_NAMES}
        return replace(self, layer_height_mm=layer_height_mm, fit_layer_mm=None, **scaled_prices)

    def price_support_s(
        self, support_mm3: float, side_mm2: float, towers_mm: float = 0.0, islands_mm: float = 0.0
    ) -> float:
        """Price a support by its volume, its upright sides, and the height of its towers and islands.

        Parameters
        ----------
        support_mm3, side_mm2, towers_mm, islands_mm
            Values of `Columns`.
        """
        support_s = self.support_s_per_mm3 * support_mm3 + self.support_side_s_per_mm2 * side_mm2
        return support_s + self.tower_s_per_mm * towers_mm + self.island_s_per_mm * islands_mm

    def price_paths_s(self, island_paths_mm2: float, holes_mm: float) -> float:
        """Price the travel from island to island, and that to holes.

        Parameters
        ----------
        island_paths_mm2, holes_mm
            Values of `Columns`.
        """
        return self.island_path_s_per_mm2 * island_paths_mm2 + self.hole_s_per_mm * holes_mm

    def price_brim_s(self, brim_mm2: float, extents_mm: Floats) -> float:
        """Compute the extra price of a brim, compared with the rectangular one in `compute_price_s`.

        Parameters
        ----------
        brim_mm2
            Area of the brim.
        extents_mm
            (3,) extents of the part.
        """
        width_mm, depth_mm = extents_mm[:2]
        assumed_mm2 = self.brim_mm * (2.0 * (width_mm + depth_mm) + math.pi * self.brim_mm)
        return float(self.brim_s_per_mm2 * (brim_mm2 - assumed_mm2))

    def price_contours_s(self, contours: Contours, skin_mm2: float) -> float:
        """Price the contours of a part; its rims replace the rim that `compute_price_s` assumes.

        Parameters
        ----------
        contours
            Contours of the part.
        skin_mm2
            Area of its skin, one of its `ADDITIVE_FEATURES`.
        """
        skin_s = self.skin_s_per_mm2 * skin_mm2
        assumed_s = max(0.0, skin_s - self.skin_rim_s_per_mm * math.sqrt(max(0.0, skin_mm2)))
        rims_s = max(0.0, skin_s - self.rim_s_per_mm * contours.rim_mm) - assumed_s
        rings_s = self.ring_s_per_mm2 * contours.ring_mm2 + self.steep_top_s_per_mm2 * contours.steep_top_mm2
        return rims_s + self.rim_end_s_per_mm * contours.rim_ends_mm + rings_s

    def price_thin_walls_s(self, thin_walls: ThinWalls) -> float:
        """Compute by how much the price of thin walls and sheets differs from that of thick ones."""
        walls_s = (
            self.single_wall_s_per_mm2 * thin_walls.single_wall_mm2 + self.gap_s_per_mm2 * thin_walls.gap_mm2
        )
        walls_s += self.solid_wall_s_per_mm2 * thin_walls.solid_wall_mm2
        return walls_s + self.overlap_s_per_mm3 * thin_walls.overlap_mm3

    def price_insets_s(self, lateral_mm2: float, height_mm: float, bodies_mm: float) -> float:
        """Compute the time that shorter inner walls save in all islands of each layer except one.

        An island is a connected region of a layer. `compute_price_s` counts one island in each layer. Inner
        walls around a hole are longer than its outline, so a hole counts as a negative island.

        Parameters
        ----------
        lateral_mm2
            One of the part's `ADDITIVE_FEATURES`.
        height_mm
            Height of the part.
        bodies_mm
            `Columns.bodies_mm` minus `Columns.holes_mm` times `HOLE_INSET_SHARE` of `poses.pose`.
        """
        max_s = MAX_INSET_SHARE * self.lateral_s_per_mm2 * lateral_mm2
        body_s = min(self.inset_s_per_mm * height_mm, max_s)
        return min(self.inset_s_per_mm * (height_mm + bodies_mm), max_s) - body_s

    def price_side_ends_s(self, cut_side_mm2: float, ends_mm: float) -> float:
        """Compute the time that `hidden_side_share` wrongly counts as saved at the ends of hidden sides.

        Parameters
        ----------
        cut_side_mm2
            Area of the hidden sides.
        ends_mm
            Total height of the edges at which the hidden sides end, from `sum_side_ends_mm`.
        """
        saved_s_per_mm2 = self.hidden_side_share * self.lateral_s_per_mm2
        return saved_s_per_mm2 * min(cut_side_mm2, SIDE_END_MM * ends_mm)

    def price_connectors_s(self, side_mm2: float, cut_mm2: float) -> float:
        """Price the pins and marks that cut faces will get.

        Parameters
        ----------
        side_mm2, cut_mm2
            Area of the upright cut faces, and of all cut faces.
        """
        level_s = self.connector_level_s_per_mm2 * (cut_mm2 - side_mm2)
        return self.connector_side_s_per_mm2 * side_mm2 + level_s

    def build_prices(self) -> Prices:
        """Build the record of the coefficients, with a float64 field for each, for compiled code."""
        return _make_record(self)

    def price_part_s(
        self, additive_features: Sequence[float] | Floats, extents_mm: Sequence[float] | Floats
    ) -> float:
        """Price a part in one pose, in seconds.

        Parameters
        ----------
        additive_features
            (5,) `ADDITIVE_FEATURES`.
        extents_mm
            (3,) width, depth and height.
        """
        features, extents = (np.array([values], np.float64) for values in (additive_features, extents_mm))
        return float(self.price_poses_s(features, extents)[0])

    def price_poses_s(self, additive_features: Floats, extents_mm: Floats) -> Floats:
        """Price a part in each of k poses, in seconds (k,).

        Parameters
        ----------
        additive_features
            (k, 5) `ADDITIVE_FEATURES`.
        extents_mm
            (k, 3) width, depth and height.
        """
        return compute_prices_s(self.build_prices(), additive_features, extents_mm)


def _compute_saved_share(saved_s: float, price_s: float) -> float:
    """Compute the share of a price that is saved; 0 if the price is 0."""
    return saved_s / price_s if price_s > 0.0 else 0.0


_PRICE_NAMES = tuple(item.name for item in fields(CostModel) if item.name != "fit_layer_mm")
_SKIN_PRICE_NAMES = frozenset(
    ("skin_s_per_mm2", "skin_rim_s_per_mm", "rim_s_per_mm", "rim_end_s_per_mm", "brim_s_per_mm2")
)
_LAYER_PRICE_NAMES = tuple(
    name for name in _PRICE_NAMES if "_s_per_mm" in name and name not in _SKIN_PRICE_NAMES
)
"""Names of the coefficients that are proportional to the number of layers of a part. Those of skins and of
the brim are not, because these have a fixed number of layers."""
_PRICES_DTYPE = np.dtype([(name, np.float64) for name in _PRICE_NAMES])


@lru_cache(maxsize=64)
def _make_record(cost: CostModel) -> Prices:
    """Make the record of a cost model; cached, because this takes much longer than computing a price."""
    record: Prices = np.array([tuple(getattr(cost, name) for name in _PRICE_NAMES)], dtype=_PRICES_DTYPE)[0]
    record.setflags(write=False)
    return record
