"""All printer models, nozzles, materials and qualities, which are resolved or refused with alternatives."""

from collections import Counter

import pytest

from printers.slicing_printers import PRINTERS, UM2_PLUS
from slicing.errors import BadSetting
from slicing.settings import FARM_QUALITIES, SettingsRequest, resolve_settings
from slicing.settings.limits import find_violations
from slicing.settings.material import find_shrinkage_factors
from slicing.settings.resolver import Resolver
from slicing.settings.stacks import find_stacks

MODELS = ("ultimaker2_plus", "ultimaker2_extended_plus", "ultimaker2", "ultimaker2_extended", "ultimaker2_go")
BASE_MODELS = ("ultimaker2_plus", "ultimaker2")  # the other models have the profiles of these
NOZZLES_MM = (0.25, 0.4, 0.6, 0.8)
QUALITIES = ("high", "normal", "fast", "draft", "slightlycoarse", "coarse", "extracoarse", *FARM_QUALITIES)
# The generic materials, some of brands in both diameters, and one that is too hot.
BRANDS = (
    "ultimaker_pla_blue",
    "ultimaker_cpe_plus_black",
    "ultimaker_petg_red",
    "dsm_arnitel2045_175",
    "basf_pla",
)
REASONS = (
    "has no such nozzle; it has",
    "is not for the",
    "has a diameter of",
    "there is none for",
    "out of range; at",
    "a raft is not supported; set it to",
)
# Cura's own profiles violate its definitions here, for example by a speed that exceeds the feeder's.
CURA_VIOLATIONS = {
    "material_anti_ooze_retraction_speed",
    "material_break_preparation_speed",
    "material_break_speed",
    "retraction_hop_enabled",  # the value for TPU is 0.2
}


def list_materials(resources):
    names = {path.name.partition(".")[0] for path in (resources.root / "materials").iterdir()}
    return sorted(name for name in names if name.startswith("generic_") or name in BRANDS)


@pytest.mark.parametrize("nozzle_mm", NOZZLES_MM)
@pytest.mark.parametrize("model", MODELS)
def test_every_combination_of_printer_and_quality_resolves(resources, model, nozzle_mm):
    outcomes = Counter()
    for material in list_materials(resources):
        for quality in QUALITIES if model in BASE_MODELS else ("fast", "glue"):
            try:
                settings = resolve_settings(
                    SettingsRequest(PRINTERS[model], quality, material, nozzle_mm), resources
                )
            except BadSetting as error:
                message = str(error)
                assert any(reason in message for reason in REASONS), message
                assert "\n" not in message
                outcomes["refused"] += 1
                continue
            outcomes["resolved"] += 1
            assert float(settings.extruder["machine_nozzle_size"]) == nozzle_mm
            assert 0.05 < settings.layer_height_mm <= 0.8 * nozzle_mm
            assert 180 <= settings.nozzle_c <= 260
            assert 0 <= settings.bed_c <= 115
            assert settings.bed_c == 0 or model != "ultimaker2_go"
            assert settings.filament_diameter_mm == 2.85
    assert outcomes["refused"] > 0
    # The plain models have one nozzle; the others have profiles for all four.
    assert (outcomes["resolved"] > 0) == (model.endswith("plus") or nozzle_mm == 0.4)


@pytest.mark.parametrize("model", BASE_MODELS)
def test_violations_by_profiles_of_cura_are_listed(resources, model):
    violations = set()
    for nozzle_mm in NOZZLES_MM if model.endswith("plus") else (0.4,):
        for material in list_materials(resources):
            for quality in ("fast", "draft"):
                try:
                    stacks = find_stacks(resources, model, nozzle_mm, material, quality)
                except BadSetting:
                    continue
                resolver = Resolver(stacks.machine.settings, stacks.machine.extruder, stacks.profiles)
                violations |= {
                    item.key for item in find_violations(resolver, PRINTERS[model]) if not item.is_farm_limit
                }
    assert violations <= CURA_VIOLATIONS


def test_brand_without_qualities_uses_those_of_its_kind(resources):
    brand_settings, generic_settings = (
        resolve_settings(SettingsRequest(UM2_PLUS, "glue", material), resources)
        for material in ("ultimaker_cpe_plus_black", "generic_cpe_plus")
    )
    assert brand_settings.speed_wall_0_mm_s == generic_settings.speed_wall_0_mm_s
    assert brand_settings.layer_height_mm == generic_settings.layer_height_mm


def test_unheated_bed_has_no_target(resources):
    settings = resolve_settings(SettingsRequest(PRINTERS["ultimaker2_go"]), resources)
    start_code = settings.global_["machine_start_gcode"]
    assert "M109 S" in start_code
    assert "M140" not in start_code
    assert "M190" not in start_code


@pytest.mark.parametrize(
    ("quality", "material", "overrides", "scale"),
    [
        ("glue", "generic_abs", {}, find_shrinkage_factors("ABS")),
        ("glue", "generic_pla", {}, (1.002, 1.001)),
        ("paper", "generic_abs", {}, (1.0, 1.0)),
        ("fast", "generic_abs", {}, (1.0, 1.0)),
        ("glue", "generic_abs", {"material_shrinkage_percentage": "101"}, (1.01, 1.01)),
        ("glue", "generic_abs", {"material_shrinkage_percentage": "100"}, (1.0, 1.0)),
        ("fast", "generic_abs", {"material_shrinkage_percentage": "102"}, (1.02, 1.02)),
    ],
)
def test_parts_are_enlarged_by_their_shrinkage_once(resources, quality, material, overrides, scale):
    request = SettingsRequest(UM2_PLUS, quality, material, overrides=overrides)
    settings = resolve_settings(request, resources)
    assert (settings.scale_xy, settings.scale_z) == pytest.approx(scale)
    for scope in (settings.global_, settings.extruder):
        assert all(float(value) == 100 for key, value in scope.items() if "shrinkage" in key)
    assert "material_shrinkage_percentage" in settings.global_
