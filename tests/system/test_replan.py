"""Replanning of failed parts in real processes: they are sliced for another printer model, or cut for several
printers."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import trimesh

from farms.real_farm import wait_for

pytestmark = pytest.mark.system


def test_failed_part_is_resliced_for_another_printer_model_and_printed(make_farm, tmp_path):
    models = {"one": "ultimaker2_plus", "two": "ultimaker2"}
    farm = make_farm({name: (model, f"sim://{model}") for name, model in models.items()})
    farm.up()
    path = tmp_path / "block.stl"
    trimesh.creation.box((28.0, 24.0, 10.0)).export(path)
    farm.run_checked("submit", path, "--printers", "1")
    wait_for("the part to print", lambda: farm.read_printer("one")["state"] == "printing")
    farm.run_checked("fail", "one", "--why", "a blob")
    job = wait_for("the job to be printed", lambda: (job := farm.read_job())["state"] == "printed" and job)
    (part,) = job["parts"]
    assert [(attempt["printer"], attempt["state"]) for attempt in part["prints"]] == [
        ("one", "failed"),
        ("two", "done"),
    ]
    (plate,) = job["plates"]
    assert (part["id"], plate["id"], plate["printer"]) == ("1/p01", "1/01-2", "two")
    assert farm.read_emulator_status("two").bed_clear is False
    farm.run_checked("cleared", "all")
    assert farm.read_job()["state"] == "done"


def test_failed_part_is_cut_for_the_free_printers_and_printed(make_farm, tmp_path):
    port = "sim://ultimaker2_plus"
    farm = make_farm(dict.fromkeys(("large", "left", "right"), ("ultimaker2_plus", port)))
    small_volume = "volume_mm: [110, 110, 100]"
    rows = farm.fleet.read_text().replace(f"{port!r}}}", f"{port!r}, {small_volume}}}")
    farm.fleet.write_text(rows.replace(f", {small_volume}}}", "}", 1))
    farm.up()
    path = tmp_path / "strip.stl"
    trimesh.creation.box((150.0, 20.0, 3.0)).export(path)
    farm.run_checked("submit", path)
    wait_for("the part to print", lambda: farm.read_printer("large")["state"] == "printing")
    farm.run_checked("fail", "large", "--why", "a blob")
    job = wait_for("the job to be printed", lambda: (job := farm.read_job())["state"] == "printed" and job)
    names = ["1/p01a", "1/p01b"]
    assert [part["id"] for part in job["parts"]] == names
    for part in job["parts"]:
        first_print, last_print = part["prints"]
        assert (first_print["part"], first_print["printer"], first_print["state"]) == (
            "1/p01",
            "large",
            "failed",
        )
        assert (last_print["part"], last_print["state"], part["cut_from"]) == (part["id"], "done", "1/p01")
    assert {part["prints"][1]["printer"] for part in job["parts"]} == {"left", "right"}
    assert all(farm.read_emulator_status(name).bed_clear is False for name in ("left", "right"))

    folder = Path(job["folder"])
    results = {path.name for path in folder.iterdir()}
    assert {"p01a.stl", "p01b.stl", "plate-01a.gcode", "plate-01b.gcode"} < results
    assert results.isdisjoint({"p01.stl", "plate-01.gcode"})
    report = json.loads((folder / "decomposition-p01.json").read_text())
    assert [f"1/{part['id']}" for part in report["parts"]] == names
    assert sum(part["volume_mm3"] for part in report["parts"]) == pytest.approx(150 * 20 * 3, rel=1e-4)
    page = tmp_path / "job.html"
    farm.run_checked("report", "1", "--out", page)
    text = page.read_text()
    assert text.count("1/p01 on large: failed") == 1
    assert all(f"<b>{name}</b> printed" in text for name in names)
    farm.run_checked("cleared", "all")
    assert farm.read_job()["state"] == "done"
