"""Tests of every row of docs/reference/defects.md."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

import numpy as np
import pytest
import trimesh

from farms.real_farm import RealFarm, wait_for

pytestmark = pytest.mark.system

PRINTER_MODEL = "ultimaker2_plus"
SIMULATED_PRINTER = (PRINTER_MODEL, f"sim://{PRINTER_MODEL}")


@pytest.fixture(scope="module")
def shared_farm(tmp_path_factory):
    """Provide one farm for all rows, which none of them may disturb."""
    farm = RealFarm(tmp_path_factory.mktemp("farm"), {"one": SIMULATED_PRINTER})
    farm.up()
    yield farm
    assert {p["state"] for p in farm.read_status()["printers"]} == {"idle"}
    farm.end()


def write_random_bytes(path):
    path.write_bytes(np.random.default_rng(1).bytes(5000))


def write_unknown_file_kind(path):
    path.with_suffix(".txt").write_text("solid it is not")
    return path.with_suffix(".txt")


def write_empty_file(path):
    path.touch()


def write_flat_mesh(path):
    trimesh.Trimesh([[0, 0, 0], [50, 0, 0], [50, 50, 0], [0, 50, 0]], [[0, 1, 2], [0, 2, 3]]).export(path)


def write_mesh_with_nan(path):
    box = trimesh.creation.box((50, 50, 50))
    vertices = np.array(box.vertices)
    vertices[3, 1] = np.nan
    trimesh.Trimesh(vertices, box.faces, process=False, validate=False).export(path)


def write_half_stl(path):
    trimesh.creation.icosphere(3, 50.0).export(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def write_loose_triangles(path):
    rng = np.random.default_rng(2)
    corners = rng.uniform(0, 100, (60, 3, 3))
    trimesh.Trimesh(corners.reshape(-1, 3), np.arange(180).reshape(-1, 3), process=False).export(path)


def write_box_in_metres(path):
    trimesh.creation.box((0.26, 0.1, 0.1)).export(path)


REFUSALS = {
    "random_bytes": (write_random_bytes, "model.stl"),
    "unknown_kind": (write_unknown_file_kind, "not a known kind"),
    "empty": (write_empty_file, "empty"),
    "flat": (write_flat_mesh, "flat"),
    "nan": (write_mesh_with_nan, "not a number"),
    "half_an_stl": (write_half_stl, "header states"),
    "loose_triangles": (write_loose_triangles, "solid"),
    "in_metres": (write_box_in_metres, "--scale"),
}


def read_error_line(stderr):
    lines = [line for line in stderr.splitlines() if line.startswith("farm: ")]
    assert len(lines) == 1, stderr
    assert "Traceback" not in stderr
    return lines[0]


@pytest.mark.parametrize("defect", REFUSALS)
def test_unusable_model_is_refused(shared_farm, tmp_path, defect):
    write, message = REFUSALS[defect]
    path = tmp_path / "model.stl"
    path = write(path) or path
    result = shared_farm.run("submit", path, "--wait")
    assert result.returncode == 5, result.stderr
    assert message in read_error_line(result.stderr)
    assert shared_farm.read_status()["jobs"] == []


def test_missing_file_is_refused(shared_farm, tmp_path):
    result = shared_farm.run("submit", tmp_path / "no.stl")
    assert result.returncode == 5
    assert "no such file" in read_error_line(result.stderr)


def test_unreachable_daemon_is_reported(make_farm, bar):
    farm = make_farm({"one": SIMULATED_PRINTER})
    for arguments in (("submit", bar), ("status",), ("status", 1, "--json"), ("down",)):
        result = farm.run(*arguments)
        assert result.returncode == 3
        assert "farm up" in read_error_line(result.stderr)


def test_unknown_key_in_the_fleet_file_is_reported(make_farm):
    farm = make_farm({"one": SIMULATED_PRINTER})
    farm.fleet.write_text(farm.fleet.read_text().replace("name: one", "name: one, colur: red"))
    result = farm.run("up")
    assert result.returncode == 2
    assert re.search(r"fleet.yaml:3: printers.0.colur: unknown key", read_error_line(result.stderr))


def test_unknown_material_in_the_fleet_file_is_reported(make_farm):
    farm = make_farm({"one": SIMULATED_PRINTER})
    farm.fleet.write_text(farm.fleet.read_text().replace("name: one", "name: one, material: PLAA"))
    result = farm.run("up")
    assert result.returncode == 2
    assert re.search(
        r"fleet.yaml:3: printers.0.material: .*PLAA: there is no such material; it prints ABS",
        read_error_line(result.stderr),
    )


def test_two_printers_on_one_port_are_refused(make_farm, tmp_path):
    farm = make_farm({"one": (PRINTER_MODEL, "/dev/ttyACM0"), "two": (PRINTER_MODEL, "/dev/ttyACM0")})
    result = farm.run("up")
    assert result.returncode == 2
    assert "one and two are on one port" in read_error_line(result.stderr)


def test_missing_port_is_reported(make_farm, tmp_path):
    farm = make_farm({"one": (PRINTER_MODEL, str(tmp_path / "ttyACM7"))})
    farm.fleet.write_text(farm.fleet.read_text().replace("time_scale: 150", "time_scale: 1"))
    result = farm.run("up")
    assert result.returncode == 0, result.stderr
    assert "one: there is no port" in read_error_line(result.stderr)
    wait_for("the agent's report", lambda: farm.read_printer("one")["state"] == "absent")
    assert farm.read_status()["todo"][0]["code"] == "connect"


def test_missing_cura_engine_is_reported(make_farm, bar, tmp_path):
    farm = make_farm({"one": SIMULATED_PRINTER})
    farm.up(FARM_CURA_ENGINE=str(tmp_path / "no-engine"))
    result = farm.run("submit", bar, "--wait")
    assert result.returncode == 1, result.stderr
    assert "FARM_CURA_ENGINE" in read_error_line(result.stderr)


def test_failing_cura_engine_is_reported(make_farm, bar, tmp_path):
    engine = tmp_path / "engine"
    script = "[ $1 = help ] && exec CuraEngine help; echo 'out of memory' >&2; exit 1"
    engine.write_text(f"#!/bin/sh\n{script}\n")
    engine.chmod(engine.stat().st_mode | stat.S_IXUSR)
    farm = make_farm({"one": SIMULATED_PRINTER, "two": SIMULATED_PRINTER})
    farm.up(FARM_CURA_ENGINE=str(engine))
    result = farm.run("submit", bar, "--wait")
    assert result.returncode == 1, result.stderr
    assert "out of memory" in read_error_line(result.stderr)
    assert farm.read_job()["state"] == "failed"


def test_part_that_fits_no_printer_is_refused(make_farm, tmp_path):
    farm = make_farm({"one": SIMULATED_PRINTER})
    # The printer is so small that its clips and the brim leave no space for a part.
    farm.fleet.write_text(farm.fleet.read_text().replace("name: one", "name: one, volume_mm: [20, 20, 20]"))
    farm.up()
    path = tmp_path / "model.stl"
    trimesh.creation.box((200, 200, 200)).export(path)
    result = farm.run("submit", path, "--wait")
    assert result.returncode == 5, result.stderr
    assert re.search(r"\d+ (printers|parts)|mm", read_error_line(result.stderr))


def test_open_mesh_is_repaired_and_parts_are_printed_in_rounds(make_farm, tmp_path):
    farm = make_farm({"one": SIMULATED_PRINTER})
    farm.up()
    bar = trimesh.creation.box((260.0, 12.0, 10.0)).subdivide().subdivide()
    bar.update_faces(np.arange(len(bar.faces)) != 7)
    path = tmp_path / "open.stl"
    bar.export(path)
    output = farm.run_checked("submit", path)
    assert "losed" in output
    wait_for("the first round", lambda: farm.read_job()["waits_for_person"])
    job = farm.read_job()
    assert job["repairs"]
    assert len(job["parts"]) == 2
    assert {p["hold"]["code"] for p in job["plates"] if p["hold"]} == {"bed_not_clear"}
    farm.run_checked("cleared", "one")
    wait_for("the second round", lambda: farm.read_job()["state"] == "printed")


def test_read_only_state_folder_is_refused(make_farm, tmp_path):
    farm = make_farm({"one": SIMULATED_PRINTER})
    farm.state = Path("/proc/farm")
    result = farm.run("up")
    assert result.returncode == 1
    assert "/proc/farm" in read_error_line(result.stderr)
    farm.state = tmp_path / "state"


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="Linux only")
def test_second_daemon_is_refused(shared_farm):
    result = shared_farm.run("daemon")
    assert result.returncode == 5
    assert "another daemon" in read_error_line(result.stderr)
