"""Stand-in for ssh that runs commands on this host, with connections that a test can cut and count."""

import os
import signal
import sys
from contextlib import suppress
from pathlib import Path

from drivers.host.paths import HostPaths, end_service


class HostPipe:
    """Connection to a host whose state is in its own folder."""

    def __init__(self, folder: Path, farm: str = "test") -> None:
        self._folder = folder / "pipe"
        self._folder.mkdir()
        self._cut_marker = self._folder / "gone"
        script = self._folder / "ssh.sh"
        script.write_text(
            f'#!/bin/sh\n[ -e {self._cut_marker} ] && {{ echo "no route" >&2; exit 255; }}\n'
            f'echo $$ >> {self._folder}/pids\nfor last; do :; done\nexec sh -c "exec env $last"\n'
        )
        script.chmod(0o700)
        self.ssh = str(script)
        remote_folder = folder / "there"
        self.command = f"XDG_STATE_HOME={remote_folder} {sys.executable} -m farm.cli.main host"
        self.paths = HostPaths(farm, {"XDG_STATE_HOME": str(remote_folder)})

    @property
    def pids(self) -> list[int]:
        """Process ids of all connections, oldest first."""
        path = self._folder / "pids"
        return [int(number) for number in path.read_text().split()] if path.exists() else []

    def cut(self) -> None:
        """Close the connection and refuse new ones."""
        self._cut_marker.touch()
        for number in self.pids:
            with suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)

    def reconnect(self) -> None:
        """Allow connections again."""
        self._cut_marker.unlink()

    def close(self, *printers: str) -> None:
        """End the service and the agents."""
        self.cut()
        end_service(self.paths)
        for printer in printers:
            _kill_agents(self.paths.find_agent_folder(printer))


def _kill_agents(folder: Path) -> None:
    """Kill the agents of a folder, also one that the service has just started and that holds no lock yet."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            words = path.read_bytes().split(b"\0")
            if b"drivers.agent" in words and os.fsencode(folder) in words:
                os.kill(int(path.parent.name), signal.SIGKILL)
