"""Settings of plates, resolved from Cura's real files."""

import math
from dataclasses import replace

import pytest

from printers.slicing_printers import PRINTERS, UM2_PLUS
from slicing.errors import BadSetting, EngineMissing, ResourcesMissing
from slicing.settings import (
    FARM_QUALITIES,
    PartSettings,
    SettingsRequest,
    find_engine,
    find_resources,
    resolve_settings,
)


def compute_brim_mm(settings, width_mm):
    """Return the width in mm of the narrowest brim of whole lines that has at least this width."""
    keys = ("skirt_brim_line_width", "initial_layer_line_width_factor")
    line_mm, percent = (float(settings.extruder[key]) for key in keys)
    line_mm *= percent / 100.0
    return math.ceil(round(width_mm / line_mm, 6)) * line_mm


def test_quality_paper_has_the_settings_of_the_paper(resources, make_settings):
    if "material_shrinkage_percentage_xy" in resources.read_machine("ultimaker2_plus").settings:
        pytest.skip("the figures are those of Cura 4.13")
    settings = make_settings("paper")
    # The extruder has its own 457 settings, and support_enable.
    assert (len(settings.global_), len(settings.extruder)) == (575, 458)
    assert (settings.layer_height_mm, settings.layer_height_0_mm, settings.line_width_mm) == (
        0.25,
        0.27,
        0.35,
    )
    assert (
        settings.wall_count,
        settings.top_layers,
        settings.bottom_layers,
        settings.infill_line_distance_mm,
    ) == (2, 3, 3, 7.0)
    assert (settings.speed_wall_0_mm_s, settings.speed_wall_x_mm_s, settings.speed_infill_mm_s) == (
        40.0,
        50.0,
        60.0,
    )
    assert (settings.speed_topbottom_mm_s, settings.speed_support_mm_s, settings.speed_layer_0_mm_s) == (
        30.0,
        40.0,
        30.0,
    )
    assert settings.support_line_distance_mm == pytest.approx(7 / 3)
    assert settings.brim_width_mm == pytest.approx(23 * 0.35)
    assert (settings.nozzle_c, settings.bed_c, settings.density_g_cm3, settings.filament_diameter_mm) == (
        200.0,
        50.0,
        1.24,
        2.85,
    )
    assert settings.global_["support_enable"] == settings.extruder["support_enable"] == "True"
    assert settings.extruder["brim_line_count"] == "23"


@pytest.mark.parametrize("quality", ["fast", "normal", "high", *FARM_QUALITIES])
@pytest.mark.parametrize(
    ("model", "height"), [("ultimaker2_plus", "205"), ("ultimaker2_extended_plus", "305")]
)
def test_every_quality_resolves_for_every_printer(make_settings, quality, model, height):
    settings = make_settings(quality, model)
    assert settings.global_["machine_height"] == height
    assert settings.global_["machine_gcode_flavor"] == "RepRap (Marlin/Sprinter)"
    assert 0.05 < settings.layer_height_mm < 0.3


def test_model_without_its_own_qualities_uses_those_of_all_machines(resources):
    printer = replace(PRINTERS["creality_ender3"], name="prusa_i3_mk3")
    settings = resolve_settings(SettingsRequest(printer, "draft", material="generic_pla_175"), resources)
    assert (settings.layer_height_mm, settings.filament_diameter_mm) == (0.2, 1.75)


@pytest.mark.parametrize(("quality", "is_optimized"), [("glue", "True"), ("glue-strong", "False")])
def test_only_glue_prints_all_walls_of_a_hole_in_succession(make_settings, quality, is_optimized):
    assert make_settings(quality).extruder["optimize_wall_printing_order"] == is_optimized


@pytest.mark.parametrize(
    ("quality", "bed_layers", "top_layers"),
    [("paper", 3, 3), ("paper-hidden", 1, 2), ("glue", 2, 3), ("glue-strong", 4, 4)],
)
def test_hidden_faces_get_fewer_solid_layers(resources, make_settings, quality, bed_layers, top_layers):
    request = SettingsRequest(UM2_PLUS, quality)
    settings = make_settings(quality)
    assert (settings.hidden_layers.bed_layers, settings.hidden_layers.top_layers) == (bed_layers, top_layers)
    hidden_settings = resolve_settings(
        request, resources, PartSettings(bed_face_hidden=True, tops_hidden=True)
    )
    assert (hidden_settings.extruder["initial_bottom_layers"], hidden_settings.extruder["top_layers"]) == (
        str(bed_layers),
        str(top_layers),
    )
    # Faces that are not on the bed keep their layers, and so does a part without hidden faces.
    assert (
        hidden_settings.extruder["bottom_layers"]
        == settings.extruder["initial_bottom_layers"]
        == str(settings.bottom_layers)
    )
    kept_settings = replace(
        hidden_settings,
        extruder=settings.extruder,
        global_={**hidden_settings.global_, "retraction_combing": "no_outer_surfaces"},
    )
    assert kept_settings == settings
    assert make_settings("paper-hidden").extruder == make_settings("paper").extruder


@pytest.mark.parametrize(
    ("request_changes", "skin_mm_s", "roof_mm_s"),
    [
        ({}, 60.0, 30.0),
        ({"quality": "paper"}, 30.0, 30.0),
        ({"nozzle_mm": 0.8}, 40.0, 20.0),  # infill is slower than inner walls
        ({"material": "generic_abs"}, 60.0, 30.0),  # twice Cura's speed, less than that of inner walls
        ({"material": "generic_tpu"}, 40.0, 35.0),
        ({"printer": PRINTERS["ultimaker2"]}, 60.0, 30.0),
        ({"printer": PRINTERS["creality_ender3"], "material": "generic_pla_175"}, 31.25, 25.0),
        ({"overrides": {"speed_topbottom": "20"}}, 20.0, 20.0),
        ({"overrides": {"speed_roofing": "25"}}, 60.0, 25.0),
        ({"overrides": {"speed_wall_x": "50"}}, 50.0, 30.0),
    ],
)
def test_skins_are_as_fast_as_inner_walls_and_roofs_keep_the_speed_of_cura(
    resources, request_changes, skin_mm_s, roof_mm_s
):
    settings = resolve_settings(SettingsRequest(**{"printer": UM2_PLUS, **request_changes}), resources)
    assert (settings.speed_topbottom_mm_s, float(settings.extruder["speed_roofing"])) == (
        skin_mm_s,
        roof_mm_s,
    )


def test_only_visible_tops_have_a_roof(resources):
    def count_roofs(part, **overrides):
        settings = resolve_settings(SettingsRequest(UM2_PLUS, overrides=overrides), resources, part)
        return int(settings.extruder["roofing_layer_count"])

    assert count_roofs(PartSettings()) == count_roofs(PartSettings(bed_face_hidden=True)) == 1
    assert count_roofs(PartSettings(tops_hidden=True)) == 0
    assert count_roofs(PartSettings(), top_layers="1") == 0


def test_only_visible_tops_of_glue_have_lines_in_even_order_without_scratches(resources, make_settings):
    def read(part, quality="glue", **overrides):
        settings = resolve_settings(SettingsRequest(UM2_PLUS, quality, overrides=overrides), resources, part)
        keys = ("skin_monotonic", "roofing_monotonic")
        return [settings.extruder[key] for key in keys], settings.global_["retraction_combing"]

    assert read(PartSettings()) == (["False", "True"], "no_outer_surfaces")
    assert read(PartSettings(tops_hidden=True)) == (["False", "True"], "all")
    sloped_part = PartSettings(flat_tops_visible=False)
    assert read(sloped_part) == (["False", "False"], "no_outer_surfaces")
    assert read(sloped_part, roofing_monotonic="True")[0] == ["False", "True"]
    assert read(sloped_part, "paper")[0] == ["True", "True"]
    assert read(PartSettings(tops_hidden=True), "paper-hidden") == (["True", "True"], "no_outer_surfaces")
    assert read(PartSettings(), roofing_layer_count="0") == (["True", "True"], "no_outer_surfaces")
    assert read(PartSettings(tops_hidden=True), retraction_combing="noskin")[1] == "noskin"
    # Cura's profile of the Ender-3 has no such order.
    ender_request = SettingsRequest(PRINTERS["creality_ender3"], material="generic_pla_175")
    ender_settings = resolve_settings(ender_request, resources)
    assert (
        ender_settings.extruder["skin_monotonic"] == ender_settings.extruder["roofing_monotonic"] == "False"
    )


def test_quality_glue_closes_its_tops_at_any_layer_height(make_settings):
    assert make_settings("glue").top_layers >= 4
    assert make_settings("glue", layer_height="0.3").top_layers == 4
    assert make_settings("glue").support_enabled


def test_infill_of_glue_is_wider_than_walls_up_to_the_flow_of_the_paper(make_settings):
    def read_infill(**overrides):
        settings = make_settings("glue", **overrides)
        width_mm = float(settings.extruder["infill_line_width"])
        return width_mm, width_mm * settings.layer_height_mm * settings.speed_infill_mm_s

    assert read_infill() == pytest.approx((0.44, 5.28))
    assert read_infill(layer_height="0.208") == pytest.approx((0.44, 5.4912))
    assert read_infill(layer_height="0.25")[1] == pytest.approx(5.5)
    assert read_infill(speed_infill="75")[1] == pytest.approx(5.5)
    assert read_infill(speed_infill="120")[0] == 0.35
    assert float(make_settings("paper").extruder["infill_line_width"]) == 0.35


def test_skin_of_glue_is_wide_except_for_visible_tops(make_settings):
    def read_widths_mm(quality="glue", **overrides):
        extruder = make_settings(quality, **overrides).extruder
        return float(extruder["skin_line_width"]), float(extruder["roofing_line_width"])

    assert read_widths_mm() == pytest.approx((0.44, 0.35))
    assert read_widths_mm(speed_topbottom="75") == pytest.approx((5.5 / 0.2 / 75.0, 0.35))
    assert read_widths_mm(skin_line_width="0.4") == pytest.approx((0.4, 0.35))
    assert read_widths_mm("paper") == (0.35, 0.35)


def test_skin_of_glue_is_connected_also_on_the_bed_and_at_tops(make_settings):
    def read_patterns(quality, **overrides):
        extruder = make_settings(quality, **overrides).extruder
        return {extruder[key] for key in ("top_bottom_pattern", "top_bottom_pattern_0", "roofing_pattern")}

    assert read_patterns("glue") == {"zigzag"}
    assert read_patterns("glue", top_bottom_pattern="lines") == read_patterns("paper") == {"lines"}


@pytest.mark.parametrize("key", ["infill_line_width", "skin_line_width"])
@pytest.mark.parametrize("nozzle_mm", [0.25, 0.6, 0.8])
def test_infill_and_skin_of_other_nozzles_are_as_wide_as_walls(resources, nozzle_mm, key):
    settings = resolve_settings(SettingsRequest(PRINTERS["ultimaker2_plus"], nozzle_mm=nozzle_mm), resources)
    assert float(settings.extruder[key]) == pytest.approx(settings.line_width_mm)


def test_override_changes_dependent_settings(make_settings):
    settings = make_settings("paper", infill_sparse_density="20", brim_width="4", support_enable="false")
    line_mm = float(settings.extruder["infill_line_width"])
    assert float(settings.extruder["infill_line_distance"]) == pytest.approx(line_mm * 100 / 20)
    assert settings.brim_width_mm == pytest.approx(compute_brim_mm(settings, 4.0))
    assert (
        settings.support_line_distance_mm,
        settings.extruder["support_enable"],
        settings.global_["support_enable"],
    ) == (
        0.0,
        "False",
        "False",
    )


def test_line_distance_counts_all_lines_of_a_crossing_pattern(make_settings):
    zigzag_settings, crossed_settings = (
        make_settings("paper", infill_pattern=pattern) for pattern in ("zigzag", "grid")
    )
    assert float(crossed_settings.extruder["infill_line_distance"]) == 2 * float(
        zigzag_settings.extruder["infill_line_distance"]
    )
    assert crossed_settings.infill_line_distance_mm == zigzag_settings.infill_line_distance_mm


def test_start_code_contains_the_temperatures(make_settings):
    start_code = make_settings("paper", material_print_temperature="215").global_["machine_start_gcode"]
    assert "M109 S215" in start_code
    assert "M190 S50" in start_code
    assert "{" not in start_code


@pytest.mark.parametrize("material", ["generic_pla", "generic_tpu", "generic_nylon", "generic_pc"])
def test_quality_glue_keeps_its_brim_if_the_profile_of_cura_counts_lines(resources, material):
    overrides = {"default_material_print_temperature": "240"}
    request = SettingsRequest(UM2_PLUS, material=material, overrides=overrides)
    settings = resolve_settings(request, resources)
    assert settings.brim_width_mm == pytest.approx(compute_brim_mm(settings, 8.0))
    narrow_settings = resolve_settings(request, resources, PartSettings(brim_width_mm=3.0))
    assert narrow_settings.brim_width_mm == pytest.approx(compute_brim_mm(narrow_settings, 3.0))


def test_width_of_brim_and_skirt_follows_the_adhesion_type(make_settings):
    assert make_settings(adhesion_type="none").brim_width_mm == 0.0
    assert make_settings(adhesion_type="skirt").brim_width_mm > 0.0


@pytest.mark.parametrize("nozzle_mm", [0.25, 0.6, 0.8])
def test_nozzle_size_is_passed_to_the_engine(resources, nozzle_mm):
    settings = resolve_settings(SettingsRequest(UM2_PLUS, nozzle_mm=nozzle_mm), resources)
    assert settings.extruder["machine_nozzle_size"] == f"{nozzle_mm}"


def test_brand_uses_the_profiles_of_its_kind(resources):
    settings = resolve_settings(SettingsRequest(UM2_PLUS, "paper", "ultimaker_pla_blue"), resources)
    assert settings.layer_height_mm == 0.25


def test_abs_has_a_higher_temperature_than_pla(resources):
    settings = resolve_settings(SettingsRequest(UM2_PLUS, "fast", "generic_abs"), resources)
    assert settings.nozzle_c > 220
    assert settings.density_g_cm3 == pytest.approx(1.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"printer": replace(UM2_PLUS, name="ultimaker2_pluss")}, "did you mean ultimaker2_plus"),
        ({"quality": "glu"}, "did you mean glue"),
        ({"quality": "draft"}, "there is none for generic_pla"),
        ({"material": "generic_plaa"}, "did you mean generic_pla"),
        ({"material": "generic_petg"}, "not for the Ultimaker 2"),
        ({"material": "../generic_pla"}, "no such material"),
        ({"nozzle_mm": 0.5}, "it has 0.25 mm, 0.4 mm, 0.6 mm, 0.8 mm"),
        ({"nozzle_mm": 0.8, "quality": "fast"}, "there is none for generic_pla.*; available: draft, glue"),
        ({"overrides": {"layer_heigth": "0.2"}}, "did you mean layer_height"),
        ({"overrides": {"layer_height": "thick"}}, "not a value of type float"),
        ({"overrides": {"layer_height": "0"}}, "out of range"),
        ({"overrides": {"infill_pattern": "ZigZag"}}, "did you mean zigzag"),
        ({"overrides": {"adhesion_type": "raft"}}, "raft is not supported"),
        ({"overrides": {"machine_gcode_flavor": "UltiGCode"}}, "leave it out"),
        ({"overrides": {"speed_print": "=1+1"}}, "not a value"),
    ],
)
def test_unknown_name_is_refused_in_one_line(resources, change, message):
    request = {"printer": UM2_PLUS, **change}
    with pytest.raises(BadSetting, match=message) as error:
        resolve_settings(SettingsRequest(**request), resources)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("overrides", "chosen_mm", "brim_mm", "adhesion"),
    [
        ({}, 3.0, 3.0, "brim"),
        ({}, 0.0, 0.0, "none"),
        ({}, 20.0, 8.0, "brim"),
        ({"brim_width": "4"}, 1.0, 4.0, "brim"),
        ({"adhesion_type": "none"}, 3.0, 0.0, "none"),
        ({"adhesion_type": "brim"}, 3.0, 3.0, "brim"),
    ],
)
def test_brim_of_a_part_is_limited_by_that_of_its_quality(resources, overrides, chosen_mm, brim_mm, adhesion):
    request = SettingsRequest(UM2_PLUS, overrides=overrides)
    settings = resolve_settings(request, resources, PartSettings(brim_width_mm=chosen_mm))
    assert settings.brim_width_mm == pytest.approx(compute_brim_mm(settings, brim_mm))
    assert settings.global_["adhesion_type"] == adhesion


def test_first_layer_of_a_part_is_wider_or_narrower_than_the_others(resources):
    part = PartSettings(layer_0_expansion_mm=-0.2)

    def read_offsets_mm(**overrides):
        settings = resolve_settings(SettingsRequest(UM2_PLUS, overrides=overrides), resources, part)
        return float(settings.extruder["xy_offset_layer_0"]), float(settings.extruder["xy_offset"])

    for overrides in ({}, {"xy_offset": "0.1"}):
        first_mm, others_mm = read_offsets_mm(**overrides)
        assert first_mm - others_mm == pytest.approx(-0.2)
    assert read_offsets_mm(xy_offset="0.1", xy_offset_layer_0="0.3") == pytest.approx((0.3, 0.1))


def test_missing_files_are_reported(tmp_path):
    with pytest.raises(ResourcesMissing, match="FARM_CURA_RESOURCES"):
        find_resources({"FARM_CURA_RESOURCES": str(tmp_path)})
    with pytest.raises(EngineMissing, match="FARM_CURA_ENGINE"):
        find_engine({"FARM_CURA_ENGINE": str(tmp_path / "no")})
    with pytest.raises(EngineMissing, match="PATH"):
        find_engine({"PATH": str(tmp_path)})


@pytest.mark.parametrize("height_mm", [2.5, 9.99, 40.93, 123.45])
def test_skins_keep_their_thickness_with_fitted_layers(resources, height_mm):
    request = SettingsRequest(UM2_PLUS)
    default_settings = resolve_settings(request, resources)
    part = resolve_settings(request, resources, PartSettings(height_mm=height_mm))
    assert abs(part.layer_height_mm / default_settings.layer_height_mm - 1) <= 0.04
    assert part.top_layers >= 4
    for end, layers in (("top", part.top_layers), ("bottom", part.bottom_layers)):
        thickness_mm = float(part.extruder[f"{end}_thickness"])
        assert layers * part.layer_height_mm >= thickness_mm - 1e-3


@pytest.mark.parametrize(
    ("quality", "overrides"),
    [
        ("paper", {}),
        ("fast", {}),
        ("glue", {"layer_height": "0.15"}),
        ("glue", {"slicing_tolerance": "inclusive"}),
    ],
)
def test_only_quality_glue_fits_layers_unless_a_person_sets_them(resources, quality, overrides):
    request = SettingsRequest(UM2_PLUS, quality, overrides=overrides)
    part = resolve_settings(request, resources, PartSettings(height_mm=40.93))
    default_settings = resolve_settings(request, resources)
    assert (part.layer_height_mm, part.layer_height_0_mm) == (
        default_settings.layer_height_mm,
        default_settings.layer_height_0_mm,
    )
