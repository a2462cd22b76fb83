"""Services of many hosts: ``python -m bench.fleets.agents.host_services FOLDER ADDRESS HOST...``.

Each is the real service behind `farm host`, with the agents of its own folder; it is reached over TCP instead
of ssh. The first line on stdout has the address and port of each host as JSON; the process ends when its
stdin is closed.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.host.paths import HostPaths
from drivers.host.service import HostService

if TYPE_CHECKING:
    from hosts.virtual_network import Network

FARM = "scale"
_SSH_PIPE = Path(__file__).with_name("ssh_pipe.py")
_SUPPORT = Path(__file__).parents[3] / "tests/support"
_BUFFER_BYTES = 65536


def make_paths(folder: Path, host: str) -> HostPaths:
    """Return the paths of a host's files."""
    return HostPaths(FARM, {"XDG_STATE_HOME": str(folder / host)})


class HostGroups:
    """Groups of hosts, each group in a process and, if this computer allows it, in a network namespace.

    Parameters
    ----------
    folder
        Folder of all hosts.
    groups
        Hosts by name of their group.
    uses_namespaces
        True if each group has a network namespace; False if all are on this computer's network.
    """

    def __init__(self, folder: Path, groups: Mapping[str, Sequence[str]], uses_namespaces: bool) -> None:
        self._network = _open_network(groups) if uses_namespaces else None
        self._processes: dict[str, subprocess.Popen[str]] = {}
        addresses: dict[str, tuple[str, int]] = {}
        for name, hosts in groups.items():
            address = "127.0.0.1" if self._network is None else self._network.get_address(name)
            arguments = [
                sys.executable,
                "-m",
                "bench.fleets.agents.host_services",
                str(folder),
                address,
                *hosts,
            ]
            command = arguments if self._network is None else self._network.make_command(name, arguments)
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            self._processes[name] = process
            assert process.stdout is not None
            addresses |= json.loads(process.stdout.readline())
        file = folder / "addresses.json"
        self._pids = Path(f"{file}.pids")
        file.write_text(json.dumps(addresses))
        self.ssh = f"{sys.executable} -IS {_SSH_PIPE} {file}"
        """Value of FARM_SSH for the daemon."""

    @property
    def uses_namespaces(self) -> bool:
        """True if each group has a network namespace, so that packets can be lost and delayed."""
        return self._network is not None

    def disconnect(self, *groups: str) -> None:
        """Drop all bytes to and from these groups, as if a cable were cut or the computers hung."""
        self._set_connected(groups, False)

    def reconnect(self, *groups: str) -> None:
        """Let bytes pass again."""
        self._set_connected(groups, True)

    def _set_connected(self, groups: Sequence[str], connected: bool) -> None:
        if self._network is not None:
            self._network.set_faults(*groups, cut=not connected)
            return
        for name in groups:
            self._processes[name].send_signal(signal.SIGCONT if connected else signal.SIGSTOP)

    def disturb(self, loss: float, delay_s: float) -> None:
        """Lose this share of all packets, and delay the others in each direction."""
        assert self._network is not None
        self._network.set_faults(*self._processes, loss=loss, delay_s=delay_s)

    def break_connections(self) -> None:
        """Kill the processes that take the place of ssh."""
        pids = self._pids.read_text().split()
        self._pids.unlink()
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGKILL)

    def close(self) -> None:
        """End the processes."""
        for process in self._processes.values():
            process.kill()
            process.wait()
        if self._network is not None:
            self._network.close()


def find_network_obstacle() -> str | None:
    """Return the reason why this computer cannot have a network that loses packets, or None."""
    _add_support_path()
    from hosts.virtual_network import find_obstacle

    return find_obstacle()


def _open_network(names: Iterable[str]) -> Network:
    _add_support_path()
    from hosts.virtual_network import Network

    return Network(list(names))


def _add_support_path() -> None:
    """Make the support modules of the tests importable."""
    if str(_SUPPORT) not in sys.path:
        sys.path.append(str(_SUPPORT))


async def _serve(folder: Path, address: str, hosts: Sequence[str]) -> None:
    addresses: dict[str, tuple[str, int]] = {}
    services = []
    for host in hosts:
        paths = make_paths(folder, host)
        paths.create_folder()
        services.append(asyncio.create_task(HostService(paths).run()))

        async def forward(
            reader: asyncio.StreamReader, writer: asyncio.StreamWriter, paths: HostPaths = paths
        ) -> None:
            with suppress(OSError):
                with paths.open_socket_path() as path:
                    inner_reader, inner_writer = await asyncio.open_unix_connection(path)
                copies = [
                    asyncio.create_task(_copy_stream(reader, inner_writer)),
                    asyncio.create_task(_copy_stream(inner_reader, writer)),
                ]
                await asyncio.wait(copies, return_when=asyncio.FIRST_COMPLETED)
                for copy in copies:
                    copy.cancel()
                inner_writer.close()
            writer.close()

        server = await asyncio.start_server(forward, address, 0)
        addresses[host] = server.sockets[0].getsockname()
    sys.stdout.write(json.dumps(addresses) + "\n")
    sys.stdout.flush()
    await asyncio.to_thread(sys.stdin.read)
    for service in services:
        service.cancel()
    await asyncio.gather(*services, return_exceptions=True)


async def _copy_stream(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with suppress(OSError):
        while data := await reader.read(_BUFFER_BYTES):
            writer.write(data)
            await writer.drain()


if __name__ == "__main__":
    asyncio.run(_serve(Path(sys.argv[1]), sys.argv[2], sys.argv[3:]))
