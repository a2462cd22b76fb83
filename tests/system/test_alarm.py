"""A heater that cannot be switched off, as a person sees it in `farm status`."""

import pytest

from drivers.emulator.launch import control
from farms.real_farm import RealFarm, wait_for


@pytest.mark.system
def test_shorted_nozzle_of_an_idle_printer_is_the_first_task_and_cuts_the_mains(tmp_path):
    farm = RealFarm(tmp_path, {"um2-01": ("ultimaker2_plus", "sim://ultimaker2_plus")})
    relay_log, relay = tmp_path / "log", tmp_path / "relay.sh"
    relay.write_text(f'#!/bin/sh\necho "$1" >> {relay_log}\n')
    relay.chmod(0o700)
    fleet_text = farm.fleet.read_text().replace(
        "name: um2-01,", f'name: um2-01, power_off_cmd: "{relay} {{printer}}",'
    )
    farm.fleet.write_text(fleet_text)
    try:
        farm.up()
        control(farm.get_emulator_folder("um2-01"), "break", fault="nozzle_burns_after")
        wait_for("the mains to be cut", relay_log.exists)
        wait_for(
            "the task about the mains",
            lambda: any("cut its mains" in task["text"] for task in farm.read_status()["todo"]),
        )
        first_task = farm.read_status()["todo"][0]
        assert first_task["code"] == "alarm" and "cut its mains" in first_task["text"]
        assert "go to um2-01 now: " in first_task["text"] and ", nozzle " in first_task["text"]
        assert farm.read_printer("um2-01")["state"] == "look"
        assert "DO NOW   go to um2-01 now: " in farm.run_checked("status")
        assert relay_log.read_text() == "um2-01\n"
    finally:
        farm.end()
