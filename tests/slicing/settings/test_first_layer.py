"""Width of the lines of the first layer, and of the brim, in quality `glue`."""

from dataclasses import replace

import pytest

from printers.slicing_printers import PRINTERS
from slicing.settings import PartSettings, SettingsRequest, resolve_settings


def test_lines_of_the_first_layer_are_wide_within_the_flow_of_infill(make_settings):
    def read_factor(quality="glue", **overrides):
        return float(make_settings(quality, **overrides).extruder["initial_layer_line_width_factor"])

    assert read_factor() == 120.0
    assert read_factor(speed_print_layer_0="32") == read_factor(speed_slowdown_layers="0") == 100.0
    assert read_factor("paper") == 100.0
    assert read_factor(initial_layer_line_width_factor="150") == 150.0


@pytest.mark.parametrize(
    "overrides", [{}, {"speed_layer_0": "38"}, {"initial_layer_line_width_factor": "150"}]
)
@pytest.mark.parametrize("printer", ["ultimaker2", "ultimaker2_plus"])
def test_brim_of_glue_is_as_wide_as_with_narrow_lines_for_any_height(resources, printer, overrides):
    request = SettingsRequest(PRINTERS[printer], overrides=overrides)
    narrow_request = replace(request, overrides={"initial_layer_line_width_factor": "100"})
    expected_mm = resolve_settings(narrow_request, resources).brim_width_mm
    for height_mm in (None, 0.6, 1.1, 2.9, 4.7, 12.0, 37.3):
        settings = resolve_settings(request, resources, PartSettings(height_mm))
        assert settings.brim_width_mm == pytest.approx(expected_mm)
