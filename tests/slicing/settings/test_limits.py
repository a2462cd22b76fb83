"""Settings that are reserved or out of range, and the messages about them."""

from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from printers.slicing_printers import UM2_PLUS
from slicing.errors import BadSetting
from slicing.settings import SettingsRequest, resolve_settings
from slicing.settings.definitions import SettingType
from slicing.settings.limits import find_reserved_reason

LIMITS = UM2_PLUS.limits


def read_refusal(resources, overrides, **other_fields):
    with pytest.raises(BadSetting) as error:
        resolve_settings(SettingsRequest(UM2_PLUS, overrides=overrides, **other_fields), resources)
    message = str(error.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("machine_gcode_flavor", "UltiGCode", "for streaming"),
        ("machine_start_gcode", "M502", "for streaming"),
        ("machine_end_gcode", "M104 S250", "for streaming"),
        ("relative_extrusion", "true", "for streaming"),
        ("material_print_temp_wait", "false", "for streaming"),
        ("material_flow_dependent_temperature", "true", "not checked"),
        ("material_flow_temp_graph", "[[0.1, 300], [10, 350]]", "not checked"),
        ("machine_width", "500", "describes the printer"),
        ("machine_nozzle_size", "0.8", "describes the printer"),
        ("machine_extruder_count", "2", "describes the printer"),
        ("material_diameter", "1.75", "describes the printer"),
        ("extruder_prime_pos_x", "400", "describes the printer"),
        ("extruders_enabled_count", "2", "several nozzles"),
        ("infill_extruder_nr", "0", "several nozzles"),
        ("prime_tower_enable", "true", "several nozzles"),
        ("support_extruder_nr_layer_0", "0", "several nozzles"),
        ("cross_infill_density_image", "/etc/passwd", "names a file"),
        ("mesh_position_x", "50", "places the part"),
        ("mesh_rotation_matrix", "[[1,0,0],[0,1,0],[0,0,1]]", "places the part"),
        ("center_object", "true", "places the part"),
        ("infill_mesh", "true", "one mesh among several"),
        ("anti_overhang_mesh", "true", "one mesh among several"),
        ("print_sequence", "one_at_a_time", "one part"),
        ("magic_spiralize", "true", "changes the shape"),
        ("magic_mesh_surface_mode", "surface", "changes the shape"),
        ("mold_enabled", "true", "changes the shape"),
        ("acceleration_enabled", "true", "accelerations"),
        ("jerk_enabled", "true", "accelerations"),
    ],
)
def test_reserved_settings_are_refused_with_the_reason(resources, key, value, reason):
    message = read_refusal(resources, {key: value})
    assert message.startswith(f"{key}: ")
    assert reason in message


def test_only_two_settings_of_qualities_are_reserved(resources):
    keys = {
        key for quality in resources.read_profiles("quality", "ultimaker2_plus") for key in quality.values
    }
    assert {key for key in keys if find_reserved_reason(key)} == {"acceleration_enabled", "jerk_enabled"}


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"material_print_temperature": "300"}, "=300 is out of range; at least 0, at most 260"),
        ({"default_material_print_temperature": "262"}, "temperature=262 is out of range"),
        ({"material_initial_print_temperature": "-5"}, "is out of range; at least 0"),
        ({"material_bed_temperature": "120"}, "=120 is out of range; at least 0, at most 115"),
        ({"material_bed_temperature_layer_0": "116"}, "at most 115"),
        ({"layer_height": "5"}, "layer_height=5 is out of range; at most 0.32"),
        ({"layer_height": "0"}, "layer_height=0 is out of range; at least 0.001"),
        ({"layer_height_0": "0.33"}, "at most 0.32"),
        ({"line_width": "0"}, "line_width=0 is out of range; at least 0.001"),
        ({"wall_line_width_0": "0.9"}, "at most 0.8"),
        ({"retraction_amount": "25"}, "at most 20"),
        ({"retraction_hop": "100"}, "at most 10"),
        ({"material_flow": "1000"}, "material_flow=1000 is out of range; at most 150"),
        ({"material_flow_layer_0": "500"}, "at most 150"),
        ({"retraction_extra_prime_amount": "100"}, "at least -5, at most 5"),
        ({"infill_line_distance": "0.05"}, "infill_line_distance=0.05 is out of range; at least 0.2"),
        (
            {"infill_overlap": "5000"},
            "infill_overlap_mm=19.75 follows from infill_overlap and is out of range",
        ),
        ({"skin_overlap_mm": "30"}, "at most 0.8"),
        ({"magic_fuzzy_skin_enabled": "true", "magic_fuzzy_skin_thickness": "30"}, "at most 0.8"),
        ({"brim_width": "200"}, "brim_width=200 is out of range; at least 0, at most 111.5"),
        ({"infill_sparse_density": "-3"}, "at least 0"),
        ({"speed_print": "1000"}, "speed_print=1000 is out of range"),
        ({"retraction_speed": "80"}, "at most 45"),
        ({"layer_height": "thick"}, "not a value of type float; use a number like 0.2"),
        ({"support_enable": "perhaps"}, "true or false"),
        ({"top_layers": "2.5"}, "a whole number"),
        ({"infill_angles": "diagonal"}, "a list like"),
        ({"infill_pattern": "honey"}, "one of grid, lines"),
        ({"adhesion_type": "brimm"}, "did you mean brim"),
        ({"layer_heigth": "0.2"}, "did you mean layer_height"),
    ],
)
def test_bad_value_is_refused_with_the_allowed_range(resources, overrides, message):
    assert message in read_refusal(resources, overrides)


def test_derived_invalid_value_is_refused_with_its_cause(resources):
    message = read_refusal(
        resources, {"default_material_print_temperature": "259", "material_initial_print_temperature": "261"}
    )
    assert message.startswith("material_initial_print_temperature=261 is out of range")
    message = read_refusal(resources, {"infill_sparse_density": "1000"})
    assert message.startswith(
        "infill_line_distance=0.044 follows from infill_sparse_density and is out of range"
    )


def test_no_infill_and_full_infill_are_within_the_limits(resources):
    for percent in ("0", "100"):
        request = SettingsRequest(UM2_PLUS, overrides={"infill_sparse_density": percent})
        assert resolve_settings(request, resources).extruder["infill_sparse_density"] == f"{percent}.0"


def test_disabled_setting_is_not_a_violation(resources):
    """Accept a value out of range for the zigzag of supports, because the supports have no infill."""
    request = SettingsRequest(UM2_PLUS, overrides={"support_infill_rate": "0"})
    assert resolve_settings(request, resources).extruder["support_zag_skip_count"] == "0"


def test_material_too_hot_for_the_printer_is_refused_unless_it_is_printed_colder(resources):
    message = read_refusal(resources, {}, material="generic_pc")
    assert "default_material_print_temperature=270, from glue with generic_pc" in message
    assert "choose another material" in message
    colder_override = {"default_material_print_temperature": "260"}
    request = SettingsRequest(UM2_PLUS, material="generic_pc", overrides=colder_override)
    assert resolve_settings(request, resources).nozzle_c == LIMITS.max_nozzle_c


def test_limits_apply_to_every_key_that_heats(resources):
    machine = resources.read_machine("ultimaker2_plus")
    numbers = (SettingType.FLOAT, SettingType.INT)
    temperature_keys = [
        s.key for s in machine.settings.values() if "temperature" in s.key and s.type in numbers
    ]
    command_keys = [
        key for key in temperature_keys if "bed" in key or "print_temp" in key or "standby" in key
    ]
    assert len(command_keys) >= 8
    for key in command_keys:
        max_c = LIMITS.max_bed_c if "bed" in key else LIMITS.max_nozzle_c
        assert f"at most {max_c:g}" in read_refusal(resources, {key: f"{max_c + 1:g}"})


TEXTS = st.one_of(
    st.text(max_size=80),
    st.floats().map(str),
    st.integers().map(str),
    st.sampled_from(["true", "[1, 2]", "[" * 300, "9" * 400, "=1+1", "a\nb", "\0", "grid", "0x10"]),
)


@given(st.data())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_text_for_any_key_resolves_or_is_refused_in_one_line(resources, data):
    machine = resources.read_machine("ultimaker2_plus")
    key = data.draw(st.sampled_from(sorted({**machine.settings, **machine.extruder})))
    request = SettingsRequest(UM2_PLUS, overrides={key: data.draw(TEXTS)})
    try:
        resolved_settings = resolve_settings(request, resources)
    except BadSetting as error:
        assert str(error).isprintable()
        assert len(str(error)) < 400
    else:
        assert 0 <= resolved_settings.nozzle_c <= LIMITS.max_nozzle_c
        assert 0 <= resolved_settings.bed_c <= LIMITS.max_bed_c
        assert 0 < resolved_settings.layer_height_mm <= 0.32
        assert resolved_settings.global_["machine_gcode_flavor"] == "RepRap (Marlin/Sprinter)"


def test_limits_follow_the_printer_model(resources):
    cooler_printer = replace(UM2_PLUS, limits=replace(LIMITS, max_nozzle_c=230.0))
    request = SettingsRequest(cooler_printer, overrides={"material_print_temperature": "231"})
    with pytest.raises(BadSetting, match="at most 230"):
        resolve_settings(request, resources)
