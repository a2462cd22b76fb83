"""A state folder of farm 0.1, left in the middle of a print, and opened by this version."""

from __future__ import annotations

import pytest

from farms.real_farm import wait_for
from farms.recorded_state import unpack_state

pytestmark = pytest.mark.system


def test_open_print_of_an_older_farm_is_ended_and_its_part_waits(make_farm, tmp_path):
    models = {"um2-01": "ultimaker2_plus", "um2-02": "ultimaker2_plus", "um2x-01": "ultimaker2_extended_plus"}
    farm = make_farm({name: (model, f"sim://{model}") for name, model in models.items()})
    unpack_state(farm.folder)  # includes the fleet file of that farm
    farm.run_checked("up")
    wait_for("the open print to be ended", lambda: farm.read_printer("um2x-01")["print"] is None)
    jobs = {job["id"]: job["state"] for job in farm.read_status()["jobs"]}
    assert (jobs[2], jobs[3], jobs[4]) == ("printing", "held", "printed")
    assert farm.read_job(1)["state"] == "done"
    (part,) = farm.read_job(2)["parts"]
    first_print = part["prints"][0]
    assert (first_print["printer"], first_print["state"]) == ("um2x-01", "failed")
    assert "agent" in first_print["reason"]
    assert farm.read_printer("um2-01")["bed"] == "not_clear"
    farm.run_checked("cleared", "um2-01")
    assert farm.read_job(4)["state"] == "done"
