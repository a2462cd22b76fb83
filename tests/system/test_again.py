"""What failed on the only printer of its kind, on real processes: it is sliced for another kind."""

from __future__ import annotations

import pytest
import trimesh

from real_farm import wait_for

pytestmark = pytest.mark.system


def test_a_part_that_failed_is_sliced_for_another_kind_of_printer_and_printed_there(make_farm, tmp_path):
    kinds = {"one": "ultimaker2_plus", "two": "ultimaker2"}
    farm = make_farm({name: (model, f"sim://{model}") for name, model in kinds.items()})
    farm.up()
    path = tmp_path / "block.stl"
    trimesh.creation.box((24.0, 20.0, 4.0)).export(path)
    farm.ok("submit", path, "--printers", "1")
    wait_for("it to print", lambda: farm.printer("one")["state"] == "printing")
    farm.ok("fail", "one", "--why", "a blob")
    job = wait_for("it to be printed", lambda: (job := farm.job())["state"] == "printed" and job)
    (part,) = job["parts"]
    assert [(one["printer"], one["state"]) for one in part["prints"]] == [("one", "failed"), ("two", "done")]
    (plate,) = job["plates"]
    assert (part["id"], plate["id"], plate["printer"]) == ("1/p01", "1/01-2", "two")
    assert farm.emulator_status("two").bed_clear is False
    farm.ok("cleared", "all")
    assert farm.job()["state"] == "done"
