"""Full disks, read-only disks and a damaged database during prints."""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack

import pytest

from farm.paths import StateFolder
from farm.state.storage.backups import back_up
from farms.killed_daemon_farm import KilledDaemonFarm
from farms.real_farm import wait_for
from hosts.small_disk import SmallDisk

pytestmark = pytest.mark.system


@pytest.fixture
def disk_farm(tmp_path):
    """Make a farm whose state folder is on a small disk."""
    with ExitStack() as stack:  # its callbacks run in reverse order, even if one of them fails
        disk = SmallDisk(tmp_path / "state", 8)
        stack.callback(disk.end)
        if not disk.is_mounted:
            pytest.skip("no disk can be mounted here")
        farm = KilledDaemonFarm(tmp_path, disk)
        stack.callback(farm.end)
        stack.callback(disk.free)
        yield farm


@pytest.fixture
def farm(tmp_path):
    farm = KilledDaemonFarm(tmp_path)
    yield farm
    farm.end()


def clear_and_list_prints(farm):
    """Clear the beds that are full; return the plates whose first layer has begun."""
    status = farm.request("GET", "/status")
    farm.clear_beds(status)
    prints = [printer["print"] for printer in status["printers"] if printer["print"]]
    return {item["plate"] for item in prints if item["layer"]}


def are_heaters_off(farm):
    """Return True if the targets of all heaters are zero."""
    targets = [printer["targets"] for printer in farm.request("GET", "/status")["printers"]]
    return all((target["nozzle_c"], target["bed_c"]) == (0.0, 0.0) for target in targets)


def read_start_failure(farm, read_only=False):
    """Start the daemon, which fails; return the line with the reason."""
    command = [sys.executable, "-P", "-m", "farm.cli.main", *farm.list_daemon_arguments()]
    result = subprocess.run(
        farm.disk.make_command(command, read_only), check=False, capture_output=True, text=True
    )
    assert result.returncode == 1, result.stderr
    (line,) = (line for line in result.stderr.splitlines() if line.startswith("farm: "))
    assert str(farm.state_option) in line
    assert "Traceback" not in result.stderr, result.stderr
    return line


def test_full_disk_stops_and_loses_no_print(disk_farm):
    farm = disk_farm
    farm.start_daemons([])
    farm.submit(2)
    wait_for("both jobs to print", lambda: clear_and_list_prints(farm) == {"1/01", "2/01"})
    farm.disk.fill()
    status, answer = farm.request_any("POST", *farm.make_submission(9))
    assert status == 500
    assert "No space left" in answer["error"]
    assert "check its disk space" in answer["error"]
    assert len(farm.request("GET", "/status")["jobs"]) == 2
    wait_for("both prints to end without a record", lambda: are_heaters_off(farm))
    (first, *_) = farm.request("GET", "/status")["todo"]
    assert first["code"] == "farm"
    assert "disk is full" in first["text"]
    assert "nothing is recorded until there is space" in first["text"]
    farm.kill_daemons()
    assert "disk is full; check its disk space" in read_start_failure(farm)
    farm.disk.free()
    assert "Read-only file system" in read_start_failure(farm, read_only=True)
    farm.start_daemons([])
    farm.judge_prints_good()
    farm.check()


def list_states(farm):
    return {job["state"] for job in farm.request("GET", "/status")["jobs"]}


def test_damaged_database_is_restored_and_no_part_is_printed_twice(farm):
    """Restore a backup that contains the plans of the running prints, but not the prints."""
    farm.start_daemons([])
    farm.submit(3, hold=True)
    wait_for("all jobs to be planned", lambda: list_states(farm) == {"held"})
    back_up(StateFolder(farm.state), farm.read_clock().now())
    farm.approve()
    wait_for("the last job to print", lambda: "3/01" in clear_and_list_prints(farm))
    farm.kill_daemons()
    for name in ("farm.db", "farm.db-wal"):
        path = farm.state / name
        data = path.read_bytes()
        path.write_bytes(data[:4096] + b"\xa5" * (len(data) - 4096))
    farm.start_daemons([])
    assert list_states(farm) == {"held"}
    assert "was restored from" in farm.read_log()
    farm.approve()
    farm.judge_prints_good()
    farm.check()
