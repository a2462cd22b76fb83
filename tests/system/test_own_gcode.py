"""A person's own G-code on real processes, without CuraEngine."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from model_files.make_gcode import make_marlin, make_square, make_ultigcode

pytestmark = pytest.mark.system


@pytest.fixture
def one_printer_farm(make_farm):
    """Start a farm of one simulated printer."""
    model = "ultimaker2_plus"
    farm = make_farm({"one": (model, f"sim://{model}?seed=7")})
    farm.up()
    return farm


def print_file(farm, number, path):
    """Submit a file, wait for the end, and return the job."""
    result = farm.run("submit", path, "--wait", "--json")
    assert result.returncode == 0, (result.stderr, farm.read_log())
    job = json.loads(result.stdout)["job"]
    assert (job["id"], job["state"], len(job["plates"])) == (number, "printed", 1)
    assert [p["state"] for p in job["parts"][0]["prints"]] == ["done"]
    if number == 1:  # a printer still warm from its last print starts sooner
        assert job["elapsed_s"] > 0.95 * job["estimated_s"]
    assert job["serial_s"] == job["estimated_s"]
    assert Path(job["parts"][0]["file"]).read_bytes() == path.read_bytes()
    emulator = farm.read_emulator_status("one")
    assert (emulator.nozzle_target_c, emulator.bed_target_c, emulator.bed_clear) == (0.0, 0.0, False)
    assert farm.read_printer("one")["filament"] == "parked"
    assert {f.name for f in Path(job["folder"]).iterdir()} == {"p01.gcode", "plate-01.gcode"}
    return job


def test_ultigcode_and_marlin_files_are_printed_to_their_end(one_printer_farm, tmp_path):
    tower = make_square(side_mm=60.0, layers=4)
    files = {"ulti.gcode": make_ultigcode(tower), "marlin.g": make_marlin(tower)}
    fed_mm = []
    for number, (name, lines) in enumerate(files.items(), 1):
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n")
        old_fed_mm = one_printer_farm.read_emulator_status("one").filament_mm
        job = print_file(one_printer_farm, number, path)
        fed_mm.append(one_printer_farm.read_emulator_status("one").filament_mm - old_fed_mm)
        assert job["filament_mm"] == pytest.approx(960 * 0.08 / 6.379, rel=1e-3)
        one_printer_farm.run_checked("cleared", "all")
    # From parked to parked, the board feeds the filament of the print and 7.8 mm for priming.
    assert fed_mm == [pytest.approx(7.8 + 960 * 0.08 / 6.379, abs=0.1)] * 2
    text = one_printer_farm.run_checked("status", "2")
    assert "Its start and end were replaced by the farm's." in text


def test_unprintable_gcode_is_refused_at_submission(one_printer_farm, tmp_path):
    path = tmp_path / "bad.gcode"
    path.write_text("\n".join(make_marlin(body=["M500"])) + "\n")
    result = one_printer_farm.run("submit", path)
    assert result.returncode == 5
    # On a busy host, progress lines precede the error.
    (error,) = (line for line in result.stderr.splitlines() if not line.startswith("  "))
    assert "farm: bad.gcode: line" in error and "M500" in error
    path.write_text("\n".join(make_marlin()) + "\n")
    assert one_printer_farm.run("submit", path, "--scale", "2").returncode == 2
    packed_file = tmp_path / "bad.gcode.gz"
    packed_file.write_bytes(b"\x1f\x8b")
    result = one_printer_farm.run("submit", packed_file)
    assert (result.returncode, "gunzip" in result.stderr) == (5, True)
    assert one_printer_farm.read_status()["jobs"] == []


def test_truncated_file_is_refused_and_another_machine_causes_a_warning(one_printer_farm, tmp_path):
    path, whole_lines = tmp_path / "tower.gcode", [";LAYER_COUNT:3", *make_marlin()]
    for cut_text, message in (
        (
            "\n".join(whole_lines[: whole_lines.index(";LAYER:2")]) + "\n",
            "states 3 layers, but the file has only 2",
        ),
        ("\n".join(whole_lines), "no newline"),
    ):
        path.write_text(cut_text)
        result = one_printer_farm.run("submit", path)
        assert (result.returncode, message in result.stderr, "--force" in result.stderr) == (5, True, False)
    path.write_text("\n".join([*whole_lines, "; printer_model = MK3S"]) + "\n")
    warning = "Warning: it was sliced for 'MK3S'."
    assert warning in one_printer_farm.run_checked("submit", path)
    assert warning in " ".join(one_printer_farm.run_checked("status", "1").split())
    (message,) = [
        line
        for line in json.loads(one_printer_farm.run_checked("status", "1", "--json"))["job"]["repairs"]
        if "MK3S" in line
    ]
    assert message.startswith(warning)
