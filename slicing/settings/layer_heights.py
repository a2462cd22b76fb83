"""Layer heights that give a printed part its exact height.

CuraEngine keeps layer heights in whole micrometres and prints the layers whose middle lies in the part
(measured with 4.13), so a part can be up to half a layer too high or too low. With heights near the
requested ones, one for the first layer and one for all others, the print ends at the part's height. Of the
heights that do so, the largest print the part in the least time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

MAX_HEIGHT_ERROR_MM = 0.02
"""Maximum error of the printed height, guaranteed for parts of `MIN_EXACT_LAYERS` layers or more."""
MIN_EXACT_LAYERS = 6
_MAX_CHANGE = 0.04  # maximum change, as a share of the layer height
FIRST_LAYER_CHANGES = (_MAX_CHANGE, 0.25)
"""Shares by which the first layer may differ. The larger share is used only where the smaller one does not
reach the height. The first layer levels out the bed anyway, and without such changes some heights cannot be
reached in whole micrometres."""
_FIRST_LAYER_WEIGHT = 0.1  # weight of the first layer's change, which is low because it is one layer of many
_SAMPLED_HEIGHTS_MM = tuple(20.0 + 1.37 * i for i in range(100))  # heights of usual parts
_SLACK_UM = 1  # tolerance for rounding


@dataclass(frozen=True, slots=True)
class LayerHeights:
    """Heights of the first layer and of every other one, in mm, both in whole micrometres."""

    first_layer_mm: float
    other_layers_mm: float


def compute_printed_height_mm(height_mm: float, heights: LayerHeights) -> float:
    """Compute the top of the last layer that CuraEngine prints of a part with a flat top.

    Parameters
    ----------
    height_mm
        Height of the part.
    heights
        Heights of its layers.

    Returns
    -------
    float
        Height in mm; 0 if no layer is printed.
    """
    first_um, other_um = _round_um(heights.first_layer_mm), _round_um(heights.other_layers_mm)
    height_um = 1000 * height_mm
    if height_um <= first_um / 2:
        return 0.0
    layers_above = max(0, _round_down((height_um - first_um) / other_um + 0.5))
    return (first_um + layers_above * other_um) / 1000


def fit_heights(
    height_mm: float, nominal_heights: LayerHeights, *, max_first_layer_mm: float
) -> LayerHeights:
    """Find the largest layer heights, within limits, that give a part its exact height.

    Parameters
    ----------
    height_mm
        Height of the part.
    nominal_heights
        Heights of the quality. Layers differ from them by 4 % at most, the first one by the least of
        `FIRST_LAYER_CHANGES` that is enough.
    max_first_layer_mm
        Maximum height of the first layer; 0 to leave it as it is.
    """
    nominal_first_um = _round_um(nominal_heights.first_layer_mm)
    nominal_other_um = _round_um(nominal_heights.other_layers_mm)
    height_um, tolerance_um = 1000 * height_mm, 1000 * MAX_HEIGHT_ERROR_MM - _SLACK_UM
    max_change_um = _round_down(nominal_other_um * _MAX_CHANGE)

    def list_candidates(min_first_um: int, max_first_um: int) -> Iterator[tuple[float, float, int, int]]:
        """Yield candidates: error (um), weighted relative loss, and both heights (um)."""
        for other_um in range(nominal_other_um - max_change_um, nominal_other_um + max_change_um + 1):
            layers_above = max(0, _round_down((height_um - nominal_first_um) / other_um))
            for count in (layers_above, layers_above + 1):
                exact_um = height_um - count * other_um  # height of the first layer without an error
                nearest_um = round(
                    min(max(nominal_first_um, exact_um - tolerance_um), exact_um + tolerance_um)
                )
                first_um = min(max(nearest_um, min_first_um), max_first_um)
                error_um = max(0.0, abs(first_um - exact_um) - tolerance_um - 0.5)
                loss = (
                    -other_um / nominal_other_um
                    + _FIRST_LAYER_WEIGHT * abs(first_um - nominal_first_um) / nominal_first_um
                )
                yield error_um, loss, first_um, other_um

    for max_share in FIRST_LAYER_CHANGES if max_first_layer_mm > 0 else (0.0,):
        low_um = math.ceil(nominal_first_um * (1 - max_share))
        high_um = max(
            low_um, min(_round_down(nominal_first_um * (1 + max_share)), _round_um(max_first_layer_mm))
        )
        best_error_um, _, first_um, other_um = min(list_candidates(low_um, high_um))
        if best_error_um == 0:
            break
    return LayerHeights(first_um / 1000, other_um / 1000)


@dataclass(frozen=True, slots=True)
class LayerFit:
    """Rule by which layers are fitted to parts: the arguments of `fit_heights`."""

    nominal_heights: LayerHeights
    max_first_layer_mm: float

    def fit(self, height_mm: float) -> LayerHeights:
        """Fit the layers to the height of a part; see `fit_heights`."""
        return fit_heights(height_mm, self.nominal_heights, max_first_layer_mm=self.max_first_layer_mm)

    def compute_mean_layer_mm(self) -> float:
        """Compute the mean height of the layers of parts of usual heights."""
        return _compute_mean_layer_mm(self)


@lru_cache(maxsize=64)
def _compute_mean_layer_mm(layer_fit: LayerFit) -> float:
    """Compute the mean height of the layers of `_SAMPLED_HEIGHTS_MM`."""
    return sum(layer_fit.fit(mm).other_layers_mm for mm in _SAMPLED_HEIGHTS_MM) / len(_SAMPLED_HEIGHTS_MM)


def _round_um(length_mm: float) -> int:
    """Round to whole micrometres as CuraEngine does: half a micrometre up."""
    return _round_down(1000 * length_mm + 0.5)


def _round_down(number: float) -> int:
    return int(number // 1)
