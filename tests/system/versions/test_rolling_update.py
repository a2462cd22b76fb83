"""Rolling update of the agents on two hosts, from one installed version of farm to the next."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from bench.night import write_slow_gcode
from drivers.emulator.launch import Command, control, is_running
from farms.installed_version import Versions
from farms.real_farm import TIME_SCALE, RealFarm, wait_for
from hosts.host_pipe import HostPipe

pytestmark = pytest.mark.system

PRINTER_MODEL = "ultimaker2_plus"
OLD_VERSION, BROKEN_VERSION, NEW_VERSION = "1.0.0", "1.1.0", "1.1.1"
HOSTS = {"pc-a": ("a1", "a2"), "pc-b": ("b1", "b2")}
PRINTING_PRINTER = "a1"
BROKEN_MAIN = 'raise SystemExit("no such library")\n'
MIN_PRINT_S, PRINT_RATIO = 30.0, 6.0
"""Minimum wall seconds of the print, also as a multiple of the seconds that the start of the farm takes. It
must not end before the daemon has been restarted twice and an agent three times."""


class HostsFarm(RealFarm):
    """Farm with printers on two hosts, which run `farm host` in the version to which a link points."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.versions = Versions(folder)
        self.pipes = {}
        for host in HOSTS:
            (folder / host).mkdir()
            self.pipes[host] = HostPipe(folder / host)
        monkeypatch.setenv("FARM_SSH", self.pipes["pc-a"].ssh)  # this script serves both hosts
        super().__init__(folder, {name: (PRINTER_MODEL, "") for names in HOSTS.values() for name in names})
        command = f"{self.versions.link}/bin/farm host"
        rows = [
            {
                "name": name,
                "model": PRINTER_MODEL,
                "port": f"sim://{PRINTER_MODEL}",
                "colour": "red" if name == PRINTING_PRINTER else "white",
                "host": host,
                "host_command": f"XDG_STATE_HOME={folder / host / 'there'} {command}",
            }
            for host, names in HOSTS.items()
            for name in names
        ]
        fleet = {
            "fleet": {"name": "test", "time_scale": TIME_SCALE, "compute": {"workers": 1}},
            "printers": rows,
        }
        self.fleet.write_text(json.dumps(fleet))

    def update(self, version: str) -> None:
        """Update to an installed version as the documentation describes."""
        self.versions.use(version)
        self.kill_daemon()
        self.run_checked("up")
        wait_for("the new services", lambda: {h["version"] for h in self.list_hosts()} == {version})
        self.run_checked("hosts", "--update")

    def list_hosts(self) -> list[dict]:
        """Return the hosts, as `farm hosts --json` shows them."""
        return self._parse(self._connect().fetch_hosts())["hosts"]

    def read_agents(self) -> dict[str, tuple[str | None, int]]:
        """Return the version and the process id of each running agent."""
        return {
            agent["printer"]: (self.versions.find_version(agent["installation"]), agent["pid"])
            for host in self.list_hosts()
            for agent in host["agents"]
        }

    def end(self) -> None:
        """End all processes of the farm and of its hosts."""
        super().end()
        for host, names in HOSTS.items():
            self.pipes[host].close(*names)
            for name in names:
                emulator = self.pipes[host].paths.find_agent_folder(name) / "emulator"
                if is_running(emulator):
                    control(emulator, Command.POWER_OFF)


@pytest.fixture
def farm(tmp_path, monkeypatch):
    """Start a farm of two hosts with the old version; install a broken and a working new version."""
    farm = HostsFarm(tmp_path, monkeypatch)
    for version in (OLD_VERSION, BROKEN_VERSION, NEW_VERSION):
        packages = farm.versions.install(version)
        if version == BROKEN_VERSION:
            (packages / "drivers" / "agent" / "__main__.py").write_text(BROKEN_MAIN)
    farm.versions.use(OLD_VERSION)
    started_s = time.monotonic()
    try:
        farm.up()
        farm.start_duration_s = time.monotonic() - started_s
        yield farm
    finally:
        farm.end()


def test_idle_agents_are_updated_host_by_host_and_restored_at_the_first_fault(farm, tmp_path):
    slow_file = tmp_path / "slow.gcode"
    print_s = TIME_SCALE * max(MIN_PRINT_S, PRINT_RATIO * farm.start_duration_s)
    slow_file.write_text(write_slow_gcode(moves=int(print_s / 20), move_s=20.0))
    farm.run_checked("submit", slow_file, "--colour", "red")
    wait_for("the print", lambda: farm.read_printer(PRINTING_PRINTER)["state"] == "printing")
    old_agents = farm.read_agents()
    assert {version for version, _ in old_agents.values()} == {OLD_VERSION}

    farm.update(BROKEN_VERSION)
    tasks = wait_for(
        "the fault", lambda: [t for t in farm.read_status()["todo"] if "the update" in t["text"]]
    )
    assert "a2: its new agent has ended; its old version is started again" in tasks[0]["text"]
    wait_for(
        "the old agent", lambda: {version for version, _ in farm.read_agents().values()} == {OLD_VERSION}
    )
    wait_for("the printer to be ready", lambda: farm.read_printer("a2")["state"] == "idle")
    new_agents = farm.read_agents()
    assert {name for name in new_agents if new_agents[name] != old_agents[name]} == {"a2"}

    farm.update(NEW_VERSION)
    states = []

    def is_updated() -> bool:
        agents = farm.read_agents()
        states.append({name: version for name, (version, _) in agents.items()})
        if farm.read_job()["printed"] == 0:
            assert agents[PRINTING_PRINTER] == old_agents[PRINTING_PRINTER]
        return {version for version, _ in agents.values()} == {NEW_VERSION}

    wait_for("the update", is_updated)
    # The second host is updated only after the print on the first one.
    assert {"a1": OLD_VERSION, "a2": NEW_VERSION, "b1": OLD_VERSION, "b2": OLD_VERSION} in states
    assert not [
        versions
        for versions in states
        if NEW_VERSION in (versions["b1"], versions["b2"]) and versions["a1"] != NEW_VERSION
    ]
    assert [attempt["state"] for attempt in farm.read_job()["parts"][0]["prints"]] == ["done"]
    assert not [task for task in farm.read_status()["todo"] if "the update" in task["text"]]
