"""Hosts with printers, each in a network namespace with its own state folder, reached over TCP.

`remote_shell` takes the place of ssh between them. The hosts need root; see `virtual_network.find_obstacle`.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from drivers.host.paths import HostPaths
from drivers.locks import find_holder
from drivers.remote import find_agent_pid
from hosts.remote_shell import READY_LINE
from hosts.virtual_network import Network

_SHELL_SCRIPT = Path(__file__).with_name("remote_shell.py")


class NetworkHosts:
    """Hosts with printers of one farm.

    Parameters
    ----------
    folder
        A new folder.
    names
        Names of the hosts.
    farm
        Name of the farm.
    program
        The command `farm` on these hosts.
    """

    def __init__(self, folder: Path, names: Sequence[str], farm: str, program: Path) -> None:
        folder.mkdir()
        self._folder, self._program = folder, program
        self._network = Network(names)
        addresses = {name: self._network.get_address(name) for name in names}
        (folder / "addresses.json").write_text(json.dumps(addresses))
        self.ssh = f"{sys.executable} {_SHELL_SCRIPT} call {folder / 'addresses.json'}"
        self.paths = {name: HostPaths(farm, {"XDG_STATE_HOME": str(folder / name)}) for name in names}
        self._shells = [self._listen(name, addresses[name]) for name in names]

    def _listen(self, name: str, address: str) -> subprocess.Popen[bytes]:
        command = self._network.make_command(name, [sys.executable, str(_SHELL_SCRIPT), "listen", address])
        path = os.pathsep.join(filter(None, sys.path))
        with (self._folder / f"{name}.log").open("ab") as log:
            shell = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=log, env=os.environ | {"PYTHONPATH": path}
            )
        assert shell.stdout is not None
        if shell.stdout.readline() != READY_LINE:
            raise OSError(f"{name} does not listen; see {log.name}")
        return shell

    def make_command(self, name: str) -> str:
        """Return the `host_command` of a host's printers."""
        return f"XDG_STATE_HOME={self._folder / name} {self._program} host"

    def cut(self, name: str) -> None:
        """Cut a host off the network without informing either end."""
        self._network.set_faults(name, cut=True)

    def reconnect(self, name: str) -> None:
        """Connect a host to the network again."""
        self._network.set_faults(name)

    def kill_service(self, name: str) -> bool:
        """Kill the service of a host; return True if it was running."""
        return _kill(find_holder(self.paths[name].lock_file))

    def kill_agents(self, name: str, printers: Sequence[str]) -> int:
        """Kill the running agents of a host; return their number."""
        return sum(_kill(find_agent_pid(self.paths[name].find_agent_folder(printer))) for printer in printers)

    def list_processes(self) -> list[int]:
        """List the processes of all hosts, without their remote shells."""
        shells = {shell.pid for shell in self._shells}
        return [pid for name in self.paths for pid in self._network.list_pids(name) if pid not in shells]

    def close(self) -> None:
        """Remove the hosts, and end their remaining processes."""
        self._network.close()
        for shell in self._shells:
            shell.wait()
            assert shell.stdout is not None
            shell.stdout.close()


def _kill(pid: int | None) -> bool:
    if pid is None:
        return False
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    return True
