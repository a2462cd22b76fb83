"""A person's own material files: reading, refusal, and effect on the settings."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from printers.slicing_printers import UM2_PLUS
from slicing.errors import BadSetting, SlicingError
from slicing.settings import OWN_MATERIALS_VARIABLE, SettingsRequest, find_resources, resolve_settings

MATERIAL_FILE = """<?xml version="1.0" encoding="UTF-8"?>
<fdmmaterial version="1.3"
  xmlns="http://www.ultimaker.com/material" xmlns:cura="http://www.ultimaker.com/cura">
  <metadata><name><brand>Own</brand><material>PETG</material><color>Black</color></name></metadata>
  <properties><density>1.27</density><diameter>2.85</diameter></properties>
  <settings>
    <setting key="print temperature">233</setting>
    <setting key="heated bed temperature">77</setting>
    <cura:setting key="retraction_speed">31</cura:setting>
  </settings>
</fdmmaterial>
"""
REQUEST = SettingsRequest(UM2_PLUS, material="my_petg")


@pytest.fixture
def write_material(tmp_path, monkeypatch):
    """Return a function that writes a person's material file and returns the resources with it."""
    monkeypatch.setenv(OWN_MATERIALS_VARIABLE, str(tmp_path))

    def write_file(text, name="my_petg"):
        data = text if isinstance(text, bytes) else text.encode()
        (tmp_path / f"{name}.xml.fdm_material").write_bytes(data)
        try:
            resources = find_resources()
        except SlicingError as error:
            pytest.skip(str(error))
        _clear_caches()
        return resources

    yield write_file
    _clear_caches()


def _clear_caches():
    """Clear the caches, because a process reads each file only once."""
    from slicing.settings import plate_settings, resources

    for function in (
        resources._list_own_materials,
        resources._read_material,
        plate_settings._resolve_settings,
    ):
        function.cache_clear()


def test_settings_of_an_own_material_are_used(write_material):
    result = resolve_settings(REQUEST, write_material(MATERIAL_FILE))
    assert (result.nozzle_c, result.bed_c) == (233.0, 77.0)
    assert float(result.extruder["retraction_speed"]) == 31.0
    assert result.density_g_cm3 == 1.27


def test_kind_of_material_without_a_profile_uses_that_of_a_related_kind(write_material):
    resources = write_material(MATERIAL_FILE)
    cpe_settings = resolve_settings(SettingsRequest(UM2_PLUS, material="generic_cpe"), resources)
    assert (
        resolve_settings(REQUEST, resources).extruder["speed_print"] == cpe_settings.extruder["speed_print"]
    )
    with pytest.raises(BadSetting, match="there is none for my_petg"):
        resolve_settings(REQUEST, write_material(MATERIAL_FILE.replace("PETG", "Wood")))


BOMB = '<!DOCTYPE lolz [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'
REFUSALS = {
    "bomb": (MATERIAL_FILE.replace("<fdmmaterial", f"{BOMB}<fdmmaterial", 1), "a DOCTYPE is not allowed"),
    "entity": (
        MATERIAL_FILE.replace("<fdmmaterial", '<!DOCTYPE a SYSTEM "file:///etc/passwd"><fdmmaterial', 1),
        "DOCTYPE",
    ),
    "huge": (MATERIAL_FILE + " " * 300_000, "is larger than 256 KiB"),
    "binary": (b"\x00\x01\xff", "is not XML"),
    "encoding": ('<?xml version="1.0" encoding="klingon"?><a/>', "is not XML"),
    "other": ("<html/>", "its first element is not `fdmmaterial`"),
    "truncated": (MATERIAL_FILE[:200], "is not XML"),
    "kind": (MATERIAL_FILE.replace("PETG", "\n"), "needs its kind"),
    "density": (
        MATERIAL_FILE.replace("1.27", "nan"),
        "properties/density must be a number from 0.1 to 20, not 'nan'",
    ),
    "diameter": (MATERIAL_FILE.replace("2.85", "thick"), "properties/diameter must be a number"),
    "start code": (
        MATERIAL_FILE.replace("retraction_speed", "machine_start_gcode"),
        "machine_start_gcode: set by this program",
    ),
    "formula": (MATERIAL_FILE.replace(">31<", ">=9**9<"), "retraction_speed: formulas are not read"),
    "Cura formula": (MATERIAL_FILE.replace(">233<", ">=233<"), "print temperature: formulas are not read"),
    "hot": (MATERIAL_FILE.replace(">233<", ">400<"), "material_print_temperature=400"),
    "word": (MATERIAL_FILE.replace(">233<", ">warm<"), "warm"),
    "speed": (MATERIAL_FILE.replace(">31<", ">-5<"), "retraction_speed=-5"),
    "thin": (MATERIAL_FILE.replace("2.85", "1.75"), "has a diameter of 1.75 mm"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_invalid_material_file_is_refused_with_the_reason(write_material, case):
    text, expected_text = REFUSALS[case]
    with pytest.raises(BadSetting) as error:
        resolve_settings(REQUEST, write_material(text))
    assert expected_text in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_own_material_does_not_replace_a_material_of_cura(write_material):
    with pytest.raises(BadSetting, match="Cura has a material generic_pla of its own; rename the file"):
        resolve_settings(SettingsRequest(UM2_PLUS), write_material(MATERIAL_FILE, "generic_pla"))


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(position=st.integers(0, len(MATERIAL_FILE)), junk=st.binary(max_size=8), length=st.integers(0, 40))
def test_damaged_file_is_refused_or_a_valid_material(write_material, position, junk, length):
    data = MATERIAL_FILE.encode()
    try:
        resolve_settings(REQUEST, write_material(data[:position] + junk + data[position + length :]))
    except SlicingError as error:
        assert len(str(error).splitlines()) == 1
