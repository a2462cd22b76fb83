"""Layer heights that are fitted so that parts reach their height, for all heights and in real slices."""

import numpy as np
import pytest
import trimesh
from hypothesis import example, given
from hypothesis import strategies as st

from printers.slicing_printers import UM2_PLUS
from slicing.plate import slice_plate
from slicing.settings import PartSettings, SettingsRequest, resolve_settings
from slicing.settings.layer_heights import (
    MAX_HEIGHT_ERROR_MM,
    MIN_EXACT_LAYERS,
    LayerFit,
    LayerHeights,
    compute_printed_height_mm,
    fit_heights,
)

MAX_HEIGHT_MM = 320.0
# Quality glue has layers of half the nozzle and Cura's first layer; the Ultimaker 2 has another one.
REQUESTED_HEIGHTS = {
    nozzle: LayerHeights(round(nozzle / 1.5, 2), round(nozzle / 2, 2)) for nozzle in (0.25, 0.4, 0.6, 0.8)
}
CASES = [*REQUESTED_HEIGHTS.items(), (0.4, LayerHeights(0.3, 0.2))]
cases = st.sampled_from(CASES)


def fit_layer_heights(height_mm, nozzle_mm, heights):
    return fit_heights(height_mm, heights, max_first_layer_mm=0.8 * nozzle_mm)


@given(st.floats(0.2, MAX_HEIGHT_MM), cases)
def test_layers_change_by_4_percent_at_most_and_the_first_stays_printable(height_mm, case):
    nozzle_mm, heights = case
    result = fit_layer_heights(height_mm, nozzle_mm, heights)
    assert abs(result.other_layers_mm / heights.other_layers_mm - 1) <= 0.04 + 1e-9
    assert 0.75 * heights.first_layer_mm - 1e-3 <= result.first_layer_mm <= 0.8 * nozzle_mm + 1e-9
    assert result.first_layer_mm <= 1.25 * heights.first_layer_mm + 1e-3


@given(st.floats(0.0, 1.0), cases)
def test_every_part_of_enough_layers_is_printed_to_its_height(share, case):
    nozzle_mm, heights = case
    lowest_mm = MIN_EXACT_LAYERS * heights.other_layers_mm
    height_mm = lowest_mm + share * (MAX_HEIGHT_MM - lowest_mm)
    assert (
        abs(
            compute_printed_height_mm(height_mm, fit_layer_heights(height_mm, nozzle_mm, heights)) - height_mm
        )
        <= MAX_HEIGHT_ERROR_MM
    )


@given(st.floats(1.0, MAX_HEIGHT_MM), cases)
@example(156.94921875, (0.4, LayerHeights(0.3, 0.2)))  # the first layer changes by 4 % exactly
def test_first_layer_changes_by_over_4_percent_only_if_less_cannot_reach_the_height(height_mm, case):
    nozzle_mm, heights = case
    result = fit_layer_heights(height_mm, nozzle_mm, heights)
    assert fit_heights(height_mm, heights, max_first_layer_mm=0.0).first_layer_mm == heights.first_layer_mm
    if abs(result.first_layer_mm / heights.first_layer_mm - 1) > 0.04 + 1e-9:
        assert compute_error_um(height_mm, heights, list_first_layers_um(heights)) > 17


@given(st.floats(1.0, MAX_HEIGHT_MM), cases)
def test_layers_are_the_largest_that_reach_the_height(height_mm, case):
    nozzle_mm, heights = case
    result = fit_layer_heights(height_mm, nozzle_mm, heights)
    if abs(result.first_layer_mm / heights.first_layer_mm - 1) > 0.04 + 1e-9:
        return
    # A change of the first layer by 4 % counts as much as one of the other layers by 0.4 %.
    smallest_um = 1000 * (result.other_layers_mm + 0.004 * heights.other_layers_mm) + 1
    larger_um = [layer_um for layer_um in list_layers_um(heights) if layer_um > smallest_um]
    assert compute_error_um(height_mm, heights, list_first_layers_um(heights), larger_um) > 17


def list_first_layers_um(heights):
    first_um = round(1000 * heights.first_layer_mm)
    return range(int(np.ceil(0.96 * first_um)), int(1.04 * first_um) + 1)


def list_layers_um(heights):
    other_um = round(1000 * heights.other_layers_mm)
    return range(int(np.ceil(0.96 * other_um)), int(1.04 * other_um) + 1)


def compute_error_um(height_mm, heights, first_layers_um, layers_um=None):
    """Return the least error in um with these first layers and layers; all within 4 % if None."""
    if layers_um is None:
        layers_um = list_layers_um(heights)
    pairs = [(first_um, layer_um) for first_um in first_layers_um for layer_um in layers_um]
    remainders_um = [((1000 * height_mm - first_um) % layer_um, layer_um) for first_um, layer_um in pairs]
    return min((min(mm, layer_um - mm) for mm, layer_um in remainders_um), default=np.inf)


@pytest.mark.parametrize(("nozzle_mm", "heights"), CASES)
def test_every_height_is_fitted_or_reported(nozzle_mm, heights):
    """Check every whole micrometre from a few layers up to the height of the tallest printer."""
    first_um = round(1000 * heights.first_layer_mm)
    low_um, high_um = round(0.75 * first_um), min(round(1.25 * first_um), round(800 * nozzle_mm))
    assert find_reached_heights(heights, low_um, high_um).all()
    assert not find_reached_heights(heights, first_um, first_um).all()


def find_reached_heights(heights, low_um, high_um):
    """Return for each height in um whether a first layer within the limits reaches it to within 20 um."""
    other_um, count = round(1000 * heights.other_layers_mm), int(1000 * MAX_HEIGHT_MM)
    is_reached = np.zeros(count + 1, dtype=bool)
    for layer_um in range(int(np.ceil(0.96 * other_um)), int(1.04 * other_um) + 1):
        for top_um in range(0, count, layer_um):
            is_reached[max(0, top_um + low_um - 20) : top_um + high_um + 21] = True
    return is_reached[MIN_EXACT_LAYERS * other_um :]


@given(st.floats(0.01, MAX_HEIGHT_MM), cases)
def test_fitting_never_increases_the_height_error(height_mm, case):
    nozzle_mm, heights = case
    plain_error_mm = abs(compute_printed_height_mm(height_mm, heights) - height_mm)
    assert abs(
        compute_printed_height_mm(height_mm, fit_layer_heights(height_mm, nozzle_mm, heights)) - height_mm
    ) <= max(plain_error_mm, MAX_HEIGHT_ERROR_MM)


def test_mean_layer_is_that_of_fitted_parts():
    layer_fit = LayerFit(REQUESTED_HEIGHTS[0.4], 0.32)
    mean_mm = np.mean(
        [layer_fit.fit(mm).other_layers_mm for mm in np.random.default_rng(1).uniform(20, 150, 2000)]
    )
    assert layer_fit.compute_mean_layer_mm() == pytest.approx(mean_mm, rel=0.005)
    assert layer_fit.compute_mean_layer_mm() > 1.02 * 0.2


# The height of 40.93 mm also needs another first layer; 3.0 mm has few layers.
@pytest.mark.parametrize("height_mm", [3.0, 7.77, 25.4, 40.93, 61.13])
def test_real_slice_has_the_height_of_the_part(make_request, resources, height_mm):
    part = PartSettings(height_mm=height_mm)
    settings = resolve_settings(SettingsRequest(UM2_PLUS), resources, part)
    box = trimesh.creation.box((8, 8, height_mm))
    assert slice_plate(make_request(box, settings=settings)).height_mm == pytest.approx(
        height_mm, abs=MAX_HEIGHT_ERROR_MM
    )


@pytest.mark.parametrize(
    ("height_mm", "layer_height"),
    [(10.05, "0.2"), (7.0, "0.1996"), (7.0, "0.2004"), (2.31, "0.15"), (0.3, "0.2")],
)
def test_height_of_a_real_slice_equals_the_predicted_height(
    make_request, make_settings, height_mm, layer_height
):
    settings = make_settings(layer_height=layer_height)
    heights = LayerHeights(settings.layer_height_0_mm, settings.layer_height_mm)
    box = trimesh.creation.box((8, 8, height_mm))
    printed_mm = slice_plate(make_request(box, settings=settings)).height_mm
    assert printed_mm == pytest.approx(compute_printed_height_mm(height_mm, heights), abs=1e-6)
