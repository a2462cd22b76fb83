"""Real daemon with simulated printers and a server for the network, for measurements."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import yaml

FARM = Path(sys.executable).with_name("farm")
TIMEOUT_S = 600.0
_PRINTER_MODEL = "ultimaker2_plus"


class WebFarm:
    """Daemon on its own state folder, in a folder of the caller.

    Parameters
    ----------
    folder
        Parent folder of its settings and its state.
    printers
        Names of the printers.
    """

    def __init__(self, folder: Path, printers: Sequence[str] = ("um2-01",)) -> None:
        with socket.create_server(("127.0.0.1", 0)) as probe:
            self.port = probe.getsockname()[1]
        # The kernels are compiled before the start, so the first model does not wait for them.
        compilation = [sys.executable, "-m", "decompose.compilation"]
        subprocess.run(compilation, check=True, stdout=subprocess.DEVNULL)
        self.state, self.fleet = folder / "state", folder / "fleet.yaml"
        rows = [
            {"name": name, "model": _PRINTER_MODEL, "port": f"sim://{_PRINTER_MODEL}"} for name in printers
        ]
        self.fleet.write_text(yaml.safe_dump({"printers": rows, "web": {"listen": f"127.0.0.1:{self.port}"}}))
        self.start()

    def start(self) -> None:
        """Start the daemon."""
        self.run("up", "--fleet", str(self.fleet))
        self.pid = int(json.loads(self.run("status", "--json"))["daemon"]["pid"])

    def run(self, *arguments: str) -> str:
        """Run a command of `farm`."""
        command = [str(FARM), *arguments, "--state", str(self.state)]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=TIMEOUT_S).stdout

    def add_key(self, name: str, role: str) -> str:
        """Add a key, and return its text."""
        return self.run("key", "add", name, "--role", role).strip()

    def read_cpu_s(self) -> float:
        """Return the CPU seconds of the daemon, in all its threads."""
        return time.clock_gettime((~self.pid << 3) | 2)

    def list_work_files(self) -> list[str]:
        """List the files in the work folder."""
        return [str(path) for path in (self.state / "work").rglob("*") if path.is_file()]
