"""Recorded log and G-code of CuraEngine 5 (`record_engine`), processed like those of 4.13."""

import base64
import dataclasses
import gzip
import json
import shlex
from pathlib import Path

import pytest

from drivers.gcode import Feature, read_program
from drivers.printers.ultimaker2_plus import ULTIMAKER2_PLUS
from slicing.errors import EngineFailed, EngineMissing, Rule, SliceRejected
from slicing.plate import slice_plate
from slicing.settings import EngineSettings

RECORD = Path(__file__).parent / "fixtures" / "engine-5.0.json.gz"


@pytest.fixture(scope="module")
def record():
    return json.loads(gzip.decompress(RECORD.read_bytes()))


@pytest.fixture
def make_cura_5_request(record, make_request, make_settings, tmp_path):
    """Return a function that makes a request to a script, which repeats the recording on an output stream."""

    def make(stream=1, edit=lambda gcode: gcode, body=None):
        (tmp_path / "log").write_text(record["log"])
        (tmp_path / "gcode").write_text(edit(record["gcode"]))
        engine = tmp_path / "cura5"
        log, gcode = (shlex.quote(str(tmp_path / name)) for name in ("log", "gcode"))
        engine.write_text(
            f"#!/bin/sh\nif [ $1 = help ]; then echo '{record['version']}' >&{stream}; exit; fi\n"
            + (body or f"cat {log} >&{stream}\ncp {gcode} part.gcode\n")
        )
        engine.chmod(0o755)
        names = {field.name for field in dataclasses.fields(EngineSettings)}
        values = {key: value for key, value in record["settings"].items() if key in names}
        settings = dataclasses.replace(make_settings(), **values)
        request = make_request(base64.b64decode(record["stl"]), settings=settings)
        return dataclasses.replace(request, engine=engine)

    return make


@pytest.mark.parametrize("stream", [1, 2])
def test_slice_of_cura_5_is_accepted_with_the_figures_of_its_log(make_cura_5_request, record, stream):
    result = slice_plate(make_cura_5_request(stream))
    assert f"Print time (s): {int(result.sliced_s)}\n" in record["log"]
    assert f"Filament (mm^3): {int(result.filament_mm3)}\n" in record["log"]
    assert result.layers == 20
    assert result.height_mm == pytest.approx(4.0, abs=0.11)
    text = result.gcode.read_bytes()
    assert b"MINX:2.14748" not in text
    assert b"Cura_SteamEngine 5.0.0" in text
    assert result.unprinted_walls == ()  # the fin is a separate line here
    with result.gcode.open("rb") as lines:
        program = read_program(lines, ULTIMAKER2_PLUS)
    assert program.time_s == result.sliced_s
    assert {mark.feature for mark in program.timeline} >= {Feature.SKIRT, Feature.WALL_OUTER, Feature.SKIN}


def remove_layer_features(gcode, number, kinds):
    """Return the G-code with some features of a layer changed to travels."""
    head, tail = gcode.split(f";LAYER:{number}\n")
    layer, end = tail.split(f";LAYER:{number + 1}\n")
    kept_lines, feature = [], ""
    for line in layer.splitlines():
        feature = line if line.startswith(";TYPE:") else feature
        is_dropped = feature in kinds and line.startswith("G1")
        kept_lines.append(line.partition(" E")[0] if is_dropped else line)
    return f"{head};LAYER:{number}\n" + "\n".join(kept_lines) + f"\n;LAYER:{number + 1}\n{end}"


WALLS = (";TYPE:WALL-OUTER", ";TYPE:WALL-INNER")


@pytest.mark.parametrize(
    ("number", "kinds", "rule"),
    [(5, WALLS, Rule.OUTLINE), (15, (*WALLS, ";TYPE:SKIN", ";TYPE:FILL"), Rule.LAYERS)],
)
def test_layer_that_lacks_its_walls_is_refused(make_cura_5_request, number, kinds, rule):
    with pytest.raises(SliceRejected, match="layer") as error:
        slice_plate(make_cura_5_request(edit=lambda gcode: remove_layer_features(gcode, number, kinds)))
    assert error.value.rule is rule


def test_setting_that_the_engine_does_not_know_is_reported(make_cura_5_request):
    body = "echo \"[ERROR] Trying to retrieve setting with no value given: 'x'\" >&2; exit 2"
    with pytest.raises(EngineFailed, match=r"no value given: 'x'; .*set FARM_CURA_RESOURCES"):
        slice_plate(make_cura_5_request(body=body))


def test_settings_of_cura_4_are_not_passed_to_cura_5(make_cura_5_request, make_settings):
    with pytest.raises(EngineMissing, match="settings files are of version 4"):
        slice_plate(dataclasses.replace(make_cura_5_request(), settings=make_settings()))
