"""Layer heights that give a printed part its exact height.

CuraEngine prints the layers whose middle lies in the part (measured with 4.13), so a part can be up to half a
layer too high or too low. With heights near the requested ones, one for the first layer and one for all
others, the print ends at the part's height. Of these heights, the largest print the part in the least time.
`slicing.layer_scale` prints layers whose height is not a whole number of micrometres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

MAX_HEIGHT_ERROR_MM = 0.001
"""Maximum error of the printed height, guaranteed for parts of `MIN_EXACT_LAYERS` layers or more whose first
layer may change."""
MIN_EXACT_LAYERS = 12
MAX_CHANGE = 0.04  # maximum change of a layer, as a share of its height
MAX_FIRST_LAYER_CHANGE = 0.25
"""Maximum change of the first layer, as a share of its height. A change above `MAX_CHANGE` is only for parts
with so few layers that changes up to `MAX_CHANGE` do not give them their height. It does little harm, because
an uneven bed changes the thickness of the first layer anyway."""
_SAMPLED_HEIGHTS_MM = tuple(20.0 + 1.37 * i for i in range(100))  # heights of usual parts
_DIGITS_MM = 7  # decimal places of a layer height, so that thousands of layers have no error


@dataclass(frozen=True, slots=True)
class LayerHeights:
    """Heights of the first layer and of each of the others, in mm; the first is in whole micrometres."""

    first_layer_mm: float
    other_layers_mm: float


def compute_printed_height_mm(height_mm: float, heights: LayerHeights) -> float:
    """Compute the top of the last layer that is printed of a part with a flat top.

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
    if height_mm <= heights.first_layer_mm / 2:
        return 0.0
    layers_above = max(0, math.floor((height_mm - heights.first_layer_mm) / heights.other_layers_mm + 0.5))
    return heights.first_layer_mm + layers_above * heights.other_layers_mm


def fit_heights(
    height_mm: float, nominal_heights: LayerHeights, *, max_first_layer_mm: float
) -> LayerHeights:
    """Find the heights of the fewest layers, within limits, that give a part its exact height.

    Parameters
    ----------
    height_mm
        Height of the part.
    nominal_heights
        Heights of the quality, from which layers differ by `MAX_CHANGE` at most. If such layers do not reach
        the height, the first one differs by `MAX_FIRST_LAYER_CHANGE` at most.
    max_first_layer_mm
        Maximum height of the first layer; 0 to leave it as it is.
    """
    nominal_first_mm = round(nominal_heights.first_layer_mm, 3)
    low_mm, high_mm = (
        nominal_heights.other_layers_mm * (1.0 + change) for change in (-MAX_CHANGE, MAX_CHANGE)
    )
    count = max(0, math.ceil((height_mm - nominal_first_mm) / high_mm - 1e-9))

    def fit_first_layer(count: int) -> LayerHeights:
        """Fit the height of `count` layers above the first one, and that of the first one if necessary."""
        least_mm, most_mm = nominal_first_mm, nominal_first_mm
        if max_first_layer_mm > 0.0:
            least_mm = math.ceil(1000.0 * nominal_first_mm * (1.0 - MAX_FIRST_LAYER_CHANGE)) / 1000.0
            max_mm = min(nominal_first_mm * (1.0 + MAX_FIRST_LAYER_CHANGE), max_first_layer_mm)
            most_mm = max(least_mm, math.floor(1000.0 * max_mm + 1e-6) / 1000.0)
        nearest_mm = min(max(nominal_first_mm, height_mm - count * high_mm), height_mm - count * low_mm)
        first_mm = min(max(round(nearest_mm, 3), least_mm), most_mm)
        other_mm = (height_mm - first_mm) / count if count else nominal_heights.other_layers_mm
        return LayerHeights(first_mm, round(min(max(other_mm, low_mm), high_mm), _DIGITS_MM))

    def rank_candidate(heights: LayerHeights) -> tuple[float, float, float]:
        """Rank by error, by the first layer's change beyond `MAX_CHANGE`, and by the layers' height."""
        error_mm = abs(compute_printed_height_mm(height_mm, heights) - height_mm)
        change_mm = abs(heights.first_layer_mm - nominal_first_mm) - MAX_CHANGE * nominal_first_mm
        return max(0.0, error_mm - MAX_HEIGHT_ERROR_MM), max(0.0, change_mm), -heights.other_layers_mm

    return min(map(fit_first_layer, (count, max(0, count - 1))), key=rank_candidate)


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
