"""Slicing of one file: refusals before the slice, and the files that are written."""

import re
from pathlib import Path

import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from farm.errors import ErrorCode, ExitCode, FarmError
from farm.planning.local.slice_file import SliceOptions, find_default_cache, slice_to_file

SIDES_MM = st.floats(20.0, 400.0)


@pytest.fixture
def box(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box((20.0, 18.0, 6.0)).export(path)
    return path


def slice_model(path, output, cache=None, on_step=lambda _: None, **options):
    defaults = {
        "printer_model": "ultimaker2_plus",
        "quality": "glue",
        "material": "generic_pla",
        "nozzle_mm": 0.4,
        "overrides": {},
    }
    return slice_to_file(path, output, SliceOptions(**{**defaults, **options}), cache, on_step)


def read_refusal(path, output, **options):
    with pytest.raises(FarmError) as error:
        slice_model(path, output, **options)
    assert "\n" not in str(error.value)
    return error.value


def test_second_slice_comes_from_the_cache_and_is_equal(box, tmp_path):
    cache, output = tmp_path / "cache", tmp_path / "new folder" / "box.gcode"
    steps = []
    first_result = slice_model(box, output, cache=cache, on_step=steps.append)
    content = output.read_bytes()
    assert steps[:3] == ["box.stl: reading", "box.stl: checking its surface", "slicing box.stl"]
    assert all(re.fullmatch(r"slicing box.stl, \d+%", text) for text in steps[3:])
    second_result = slice_model(box, output, cache=cache)
    assert (first_result["cached"], second_result["cached"]) == (False, True)
    assert output.read_bytes() == content
    assert [path.name for path in output.parent.iterdir()] == ["box.gcode"]
    documented_keys = {"schema", "print_time_s", "filament_mm", "filament_mm3", "grams", "layers", "cached"}
    assert documented_keys | {"settings", "unprinted", "estimated_s"} <= set(first_result)
    assert first_result["estimated_s"] > first_result["print_time_s"] > 0
    assert float(first_result["settings"]["global"]["layer_height"]) == pytest.approx(0.2, rel=0.04)


REFUSALS = {
    "folder": ({}, ErrorCode.FAILED, "it is a folder"),
    "printer": ({"printer_model": "ultimaker2_pls"}, ErrorCode.SETTINGS, "did you mean ultimaker2_plus"),
    "material": ({"material": "PETG"}, ErrorCode.SETTINGS, "it prints ABS, CPE,"),
    "nozzle": ({"nozzle_mm": 0.5}, ErrorCode.SETTINGS, "0.4 mm, 0.6 mm"),
    "setting": ({"overrides": {"laier_height": "1"}}, ErrorCode.SETTINGS, "did you mean layer_height"),
    "both": ({"scale": 1.0, "longest_side_mm": 9.0}, ErrorCode.SETTINGS, "exclude each other"),
}


@pytest.mark.parametrize("mistake", REFUSALS)
def test_mistake_is_named_and_nothing_is_written(box, tmp_path, mistake):
    options, code, message = REFUSALS[mistake]
    output = tmp_path if mistake == "folder" else tmp_path / "new" / "deep" / "out.gcode"
    error = read_refusal(box, output, **options)
    assert error.code is code
    assert message in str(error)
    assert [path.name for path in tmp_path.iterdir()] == ["box.stl"]


def test_output_over_the_model_is_refused(box, tmp_path):
    content = box.read_bytes()
    link = tmp_path / "link.stl"
    link.symlink_to(box)
    for output in (box, link):
        assert "it is the model" in str(read_refusal(box, output))
    assert box.read_bytes() == content


def test_output_below_a_file_is_refused(box):
    assert "is not a folder" in str(read_refusal(box, box / "deep" / "out.gcode"))


def test_model_in_inches_or_metres_is_refused_with_scales(tmp_path):
    path = tmp_path / "m.stl"
    trimesh.creation.box((0.3, 0.2, 0.1)).export(path)
    message = str(read_refusal(path, tmp_path / "out.gcode"))
    assert "--scale 1000 if it is in metres" in message and "--scale 25.4 if it is in inches" in message


def test_missing_engine_is_not_reported_as_an_error_of_the_model(box, tmp_path, monkeypatch):
    monkeypatch.setenv("FARM_CURA_ENGINE", str(tmp_path / "none"))
    error = read_refusal(box, tmp_path / "out.gcode")
    assert (error.code, error.exit_code) == (ErrorCode.ENGINE, ExitCode.FAILED)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.tuples(SIDES_MM, SIDES_MM, SIDES_MM).filter(lambda size: max(size) > 210.0), st.booleans())
def test_proposed_scale_of_a_large_model_fits(tmp_path, monkeypatch, size, uses_scale):
    path = tmp_path / "large.stl"
    trimesh.creation.box(size).export(path)
    message = str(read_refusal(path, tmp_path / "out.gcode"))
    scale, longest_side = re.search(r"--scale (\S+) or --longest-side (\S+)$", message).groups()

    def refuse_slicing(task, progress):
        raise FarmError("it fits")

    monkeypatch.setattr("farm.planning.local.slice_file.slice_part", refuse_slicing)
    size_option = {"scale": float(scale)} if uses_scale else {"longest_side_mm": float(longest_side)}
    assert str(read_refusal(path, tmp_path / "out.gcode", **size_option)) == "it fits"


def test_unwritable_cache_is_not_used(tmp_path):
    (tmp_path / "file").touch()
    assert find_default_cache({"XDG_CACHE_HOME": str(tmp_path / "file")}) is None
    assert find_default_cache({"XDG_CACHE_HOME": str(tmp_path)}) == tmp_path / "farm" / "slices"
    assert find_default_cache({"HOME": "/proc"}) is None
    assert find_default_cache({"HOME": str(tmp_path)}) == Path(tmp_path) / ".cache" / "farm" / "slices"


CUSTOM_MATERIAL = """<fdmmaterial xmlns="http://www.ultimaker.com/material" version="1.3">
  <metadata><name><brand>Own</brand><material>PETG</material></name></metadata>
  <properties><density>1.27</density><diameter>2.85</diameter></properties>
  <settings><setting key="print temperature">233</setting></settings>
</fdmmaterial>"""


def test_settings_of_a_custom_material_are_in_the_gcode(box, tmp_path, monkeypatch):
    (tmp_path / "petg.xml.fdm_material").write_text(CUSTOM_MATERIAL)
    monkeypatch.setenv("FARM_MATERIALS", str(tmp_path))
    report = slice_model(box, tmp_path / "box.gcode", material="black PETG")
    lines = (tmp_path / "box.gcode").read_text().splitlines()
    assert "M109 S233" in lines
    assert report["grams"] == pytest.approx(report["filament_mm3"] * 1.27e-3)
