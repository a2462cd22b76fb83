"""A mixed fleet of an Ender-3 with plain Marlin 2 and an Ultimaker 2+."""

from __future__ import annotations

import json

import pytest

pytestmark = pytest.mark.system

ENDER3, UM2_PLUS = "creality_ender3", "ultimaker2_plus"


@pytest.fixture
def mixed_farm(make_farm):
    farm = make_farm({"ender": (ENDER3, f"sim://{ENDER3}"), "um2": (UM2_PLUS, f"sim://{UM2_PLUS}")})
    text = farm.fleet.read_text()
    farm.fleet.write_text(text.replace(f"model: {ENDER3},", f"model: {ENDER3}, material: generic_pla_175,"))
    farm.up()
    return farm


def test_job_is_split_between_printers_of_two_models(mixed_farm, bar):
    result = mixed_farm.run("submit", bar, "--wait", "--json")
    assert result.returncode == 0, (result.stderr, mixed_farm.read_log())
    job = json.loads(result.stdout)["job"]
    assert job["state"] == "printed"
    assert {part["prints"][-1]["printer"] for part in job["parts"]} == {"ender", "um2"}
    for name in ("ender", "um2"):
        printer, emulator = mixed_farm.read_printer(name), mixed_farm.read_emulator_status(name)
        assert (printer["bed"], printer["filament"], printer["heaters_off"]) == ("not_clear", "parked", True)
        assert (emulator.nozzle_target_c, emulator.bed_target_c, emulator.bed_clear) == (0.0, 0.0, False)
        assert emulator.altered_line_count == emulator.damaged_byte_count == 0
    mixed_farm.run_checked("cleared", "all")
    assert mixed_farm.read_status()["todo"] == []
