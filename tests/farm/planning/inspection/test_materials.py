"""Materials by the names that people use."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.printers import PROFILES
from farm.config import FieldError, FleetSection, PrinterSection
from farm.errors import RefusedError
from farm.model import JobOptions
from farm.planning.inspection import complete_section, resolve_filament
from farm.planning.inspection.materials import NamedMaterial, choose_material, parse_material
from farm.planning.printer_settings import build_slicing_printer
from farm.scheduling.matching import Requirements
from farm.scheduling.situation_builder import describe_capabilities
from slicing.errors import BadSetting, SlicingError
from slicing.settings import find_resources

KINDS = {
    "generic_pla": "PLA",
    "ultimaker_pla_black": "PLA",
    "generic_cpe_plus": "CPE+",
    "generic_cpe": "CPE",
    "generic_tpu": "TPU 95A",
    "fiberlogy_tpu": "TPU",
    "generic_tough_pla": "Tough PLA",
}


@pytest.fixture(scope="module")
def resources():
    try:
        return find_resources()
    except SlicingError as error:
        pytest.skip(str(error))


def find_material(text, resources, model="ultimaker2_plus"):
    material = choose_material(text, build_slicing_printer(PROFILES[model]), 0.4, resources)
    return material.name, material.kind, material.colour


@pytest.mark.parametrize(
    ("text", "expected_fields"),
    [
        ("PLA", ("PLA", "PLA", None)),
        ("pla", ("PLA", "PLA", None)),
        ("black PLA", ("PLA", "PLA", "black")),
        ("PLA light blue", ("PLA", "PLA", "light blue")),
        ("tough-pla", ("Tough PLA", "Tough PLA", None)),
        ("red tough PLA", ("Tough PLA", "Tough PLA", "red")),
        ("CPE+", ("CPE+", "CPE+", None)),
        ("cpe", ("CPE", "CPE", None)),
        ("TPU", ("TPU 95A", "TPU 95A", None)),
        ("generic_pla", ("generic_pla", "PLA", None)),
        ("Ultimaker_PLA_black", ("ultimaker_pla_black", "PLA", None)),
        ("generic_cpe clear", ("generic_cpe", "CPE", "clear")),
    ],
)
def test_material_is_found_by_kind_or_file_with_its_colour(text, expected_fields):
    assert parse_material(text, KINDS) == NamedMaterial(*expected_fields)


@given(st.text(max_size=30))
def test_any_text_is_resolved_to_a_material_or_none(text):
    result = parse_material(text, KINDS)
    assert result is None or result.kind in KINDS.values()


def test_kind_selects_the_generic_material_for_the_printer(resources):
    assert find_material("PLA", resources) == ("generic_pla", "PLA", None)
    assert find_material("white ABS", resources) == ("generic_abs", "ABS", "white")
    assert find_material("PETG", resources, "creality_ender3")[0] == "generic_petg_175"


@pytest.mark.parametrize("text", ["PETG", "unobtainium"])
def test_refusal_lists_the_materials_of_the_printer(resources, text):
    with pytest.raises(BadSetting) as error:
        find_material(text, resources)
    assert "it prints ABS, CPE, CPE+, Nylon, PLA, PP, TPU 95A, and others with a material file" in str(
        error.value
    )


def make_section(**values):
    base_fields = {"name": "a", "model": "ultimaker2_plus", "port": "/dev/a"}
    return PrinterSection.model_validate({**base_fields, **values})


def test_section_of_a_printer_has_file_kind_and_colour(resources):
    result = complete_section(make_section(material="black PLA"), FleetSection())
    assert (result.material, result.material_kind, result.colour) == ("generic_pla", "PLA", "black")
    section_with_colour = complete_section(make_section(material="black PLA", colour="white"), FleetSection())
    assert section_with_colour.colour == "white"


def test_folder_of_own_materials_is_read_and_errors_are_reported(resources, tmp_path):
    path = tmp_path / "x.xml.fdm_material"
    path.write_text("<html/>")
    with pytest.raises(FieldError, match="is not a Cura material file") as error:
        complete_section(make_section(), FleetSection(materials=tmp_path))
    assert error.value.key_path == ("fleet", "materials")
    with pytest.raises(FieldError, match="cannot be read"):
        complete_section(make_section(), FleetSection(materials=tmp_path / "no"))


def test_material_of_a_job_matches_every_printer_of_its_kind(resources):
    printers = [
        make_section(name="a").with_filament("generic_pla", "PLA", "white"),
        make_section(name="b", port="/dev/b").with_filament("ultimaker_pla_black", "PLA", "black"),
    ]
    requested_filament = resolve_filament(JobOptions(material="pla"), printers, None)
    assert [p.has_material(requested_filament.material) for p in printers] == [True, True]
    requirements = Requirements(material=requested_filament.material, colour=None, nozzle_mm=None)
    assert all(requirements.matches(describe_capabilities(p, lambda _: ())) for p in printers)
    requested_filament = resolve_filament(JobOptions(material="black PLA"), printers, None)
    assert (requested_filament.material, requested_filament.colour) == ("PLA", "black")
    with pytest.raises(RefusedError, match="no printer of the fleet has ABS; the fleet has black PLA, white"):
        resolve_filament(JobOptions(material="abs"), printers, None)
    with pytest.raises(RefusedError, match="no printer of the fleet has gold; the fleet has black PLA"):
        resolve_filament(JobOptions(material="gold"), printers, None)
