"""Speeds of a plate by its quality: those that a person sets, and the flow of the nozzle."""

from dataclasses import replace

import pytest

from printers.slicing_printers import PRINTERS, UM2_PLUS
from slicing.errors import BadSetting
from slicing.settings import SettingsRequest, resolve_settings


@pytest.mark.parametrize(
    ("material", "plain_quality"),
    [("generic_pla", "fast"), ("generic_abs", "fast"), ("generic_tpu", "normal")],
)
def test_slower_printing_slows_all_lines_as_with_cura(resources, material, plain_quality):
    """Compare with a quality that does not change speeds."""

    def resolve(quality, **overrides):
        return resolve_settings(SettingsRequest(UM2_PLUS, quality, material, overrides=overrides), resources)

    slow, plain = resolve("glue", speed_print="20"), resolve(plain_quality, speed_print="20")
    assert slow.speed_wall_x_mm_s == plain.speed_wall_x_mm_s
    assert slow.speed_topbottom_mm_s == plain.speed_topbottom_mm_s
    slow, plain = resolve("glue", speed_wall="20"), resolve(plain_quality, speed_wall="20")
    assert slow.speed_wall_x_mm_s == plain.speed_wall_x_mm_s


@pytest.mark.parametrize("nozzle_mm", [0.25, 0.4, 0.6, 0.8])
@pytest.mark.parametrize("printer", [UM2_PLUS, PRINTERS["creality_ender3"]])
@pytest.mark.parametrize("material", ["generic_pla", "generic_nylon", "generic_tpu"])
def test_faster_lines_have_a_flow_that_is_melted(resources, printer, nozzle_mm, material):
    try:
        request = SettingsRequest(printer, nozzle_mm=nozzle_mm, material=material)
        settings = resolve_settings(request, resources)
    except BadSetting as refusal:
        pytest.skip(str(refusal))
    hidden_mm_s = settings.compute_hidden_wall_speed_mm_s(
        settings.speed_wall_0_mm_s, settings.line_width_0_mm
    )
    max_flow_mm3_s = min(8.5, 5.5 * max(1.0, nozzle_mm / 0.4)) + 1e-6
    hidden_flow_mm3_s = hidden_mm_s * settings.line_width_0_mm * settings.layer_height_mm
    assert hidden_mm_s == settings.speed_wall_0_mm_s or hidden_flow_mm3_s <= max_flow_mm3_s
    overrides = {"speed_print": settings.extruder["speed_print"]}  # with it, Cura's formulas apply
    cura_mm_s = resolve_settings(replace(request, overrides=overrides), resources).speed_wall_x_mm_s
    inner_flow_mm3_s = settings.speed_wall_x_mm_s * settings.line_width_mm * settings.layer_height_mm
    assert settings.speed_wall_x_mm_s == cura_mm_s or inner_flow_mm3_s <= max_flow_mm3_s
