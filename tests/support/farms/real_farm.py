"""A complete farm of real processes on pseudo-terminals, in its own folder."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from drivers.emulator.launch import Command, control, is_running
from drivers.emulator.status import read_status
from drivers.remote import kill_agent
from farm.cli.client import connect
from farm.paths import find_farm_paths

FARM_PROGRAM = Path(sys.executable).with_name("farm")
TIME_LIMIT_S = 240.0
TIME_SCALE = 150
BUDGET_S = 2  # for the search for parts; on small models, a longer search gains little


def wait_for(description, condition, limit_s=TIME_LIMIT_S):
    """Poll until a condition of a real process is true, up to a deadline."""
    deadline_s = time.monotonic() + limit_s
    while time.monotonic() < deadline_s:
        value = condition()
        if value:
            return value
        time.sleep(0.1)
    raise AssertionError(f"waited {limit_s:.0f} s for {description}")


def find_free_port():
    """Return a port of this host on which nothing listens."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


class RealFarm:
    """The `farm` command with its own state folder and fleet."""

    def __init__(self, folder, printers):
        self.folder = folder
        self.state = folder / "state"
        self.fleet = folder / "fleet.yaml"
        self.printers = list(printers)
        self.wrapper = []  # command that runs the `farm` command, if any
        self.write_fleet(printers)

    def write_fleet(self, printers):
        rows = "".join(f"  - {{name: {n}, model: {m}, port: {p!r}}}\n" for n, (m, p) in printers.items())
        fleet_options = f"name: test, time_scale: {TIME_SCALE}, compute: {{budget_s: {BUDGET_S}}}"
        self.fleet.write_text(f"fleet: {{{fleet_options}}}\nprinters:\n{rows}")

    def run(self, *arguments, **env):
        """Run a farm command to its end; return the completed process."""
        command = [*self.wrapper, str(FARM_PROGRAM), *map(str, arguments), "--state", str(self.state)]
        if arguments[0] in ("up", "daemon"):
            command += ["--fleet", str(self.fleet)]
        return subprocess.run(
            command,
            check=False,
            capture_output=True,
            text=True,
            timeout=TIME_LIMIT_S,
            env={**os.environ, **env},
            stdin=subprocess.DEVNULL,
        )

    def run_checked(self, *arguments, **env):
        """Run a farm command that must succeed; return its output."""
        result = self.run(*arguments, **env)
        assert result.returncode == 0, (arguments, result.stdout, result.stderr, self.read_log())
        return result.stdout

    def up(self, **env):
        """Run `farm up`, and wait until all printers are idle."""
        self.run_checked("up", **env)
        wait_for(
            "printers to connect", lambda: all(p["state"] == "idle" for p in self.read_status()["printers"])
        )

    def read_status(self):
        """Return the same as `farm status --json`, without a process for each poll."""
        return self._parse(self._connect().fetch_status())

    def read_job(self, number=1):
        return self._parse(self._connect().fetch_job(number))["job"]

    def _connect(self):
        return connect(find_farm_paths(self.state, None, self.fleet))

    @staticmethod
    def _parse(answer):
        return json.loads(answer.model_dump_json(by_alias=True))

    def read_printer(self, name):
        return next(p for p in self.read_status()["printers"] if p["name"] == name)

    def get_emulator_folder(self, name):
        return self.state / "agents" / name / "emulator"

    def read_emulator_status(self, name):
        return read_status(self.get_emulator_folder(name))

    def read_log(self):
        path = self.state / "daemon.log"
        return path.read_text()[-4000:] if path.exists() else ""

    def kill_daemon(self):
        os.kill(self.read_status()["daemon"]["pid"], signal.SIGKILL)

    def end(self):
        """End all processes of the farm."""
        if self.state.exists() and self.run("down", "--now").returncode != 0:
            for agent in self.state.glob("agents/*/"):
                kill_agent(agent)
        for name in self.printers:
            if is_running(self.get_emulator_folder(name)):
                control(self.get_emulator_folder(name), Command.POWER_OFF)
