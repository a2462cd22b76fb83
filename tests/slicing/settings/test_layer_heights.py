"""Layer heights that are fitted so that parts reach their height, for all heights and in real slices."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
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
def test_first_layer_changes_by_over_4_percent_only_if_the_others_cannot_reach_the_height(height_mm, case):
    nozzle_mm, heights = case
    first_mm, other_mm = heights.first_layer_mm, heights.other_layers_mm
    result = fit_layer_heights(height_mm, nozzle_mm, heights)
    assert fit_heights(height_mm, heights, max_first_layer_mm=0.0).first_layer_mm == first_mm
    counts = (height_mm - first_mm) / (1.04 * other_mm), (height_mm - first_mm) / (0.96 * other_mm)
    if np.ceil(counts[0] + 1e-6) <= counts[1] - 1e-6:
        assert abs(result.first_layer_mm - first_mm) <= 0.04 * first_mm + 1e-9


@given(st.floats(1.0, MAX_HEIGHT_MM), cases)
def test_no_lower_number_of_layers_reaches_the_height(height_mm, case):
    nozzle_mm, heights = case
    result = fit_layer_heights(height_mm, nozzle_mm, heights)
    if result.first_layer_mm == heights.first_layer_mm:
        count = round((height_mm - result.first_layer_mm) / result.other_layers_mm)
        lower_mm = heights.first_layer_mm + (count - 1) * 1.04 * heights.other_layers_mm
        assert lower_mm < height_mm + MAX_HEIGHT_ERROR_MM


def test_layers_of_tall_parts_change_little_with_the_height():
    """Compare parts whose heights differ by hundredths of a mm: their times must not jump."""
    layers_mm = [
        fit_layer_heights(85.0 + 0.01 * i, 0.4, REQUESTED_HEIGHTS[0.4]).other_layers_mm for i in range(300)
    ]
    assert max(layers_mm) == pytest.approx(0.208, abs=1e-5)
    assert min(layers_mm) > 0.2074


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
    assert layer_fit.compute_mean_layer_mm() > 1.035 * 0.2


# The heights of 1.6 and 3.0 mm need another first layer.
@pytest.mark.parametrize("height_mm", [1.6, 3.0, 7.77, 25.4, 40.93, 61.13])
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
    assert printed_mm == pytest.approx(compute_printed_height_mm(height_mm, heights), abs=0.00051)
