"""Files of a host's service, which lie beside the folders of its agents; start and end of the service."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from drivers.errors import AgentError
from drivers.locks import find_holder, is_locked, kill_holder
from drivers.records import StartFile
from drivers.remote import RETRY_INTERVAL_S, Installation
from drivers.remote.bridge import find_folder

_FOLDER = ".host"  # no printer's name begins with a dot
_START_TIMEOUT_S = 30.0
_END_TIMEOUT_S = 5.0


def read_version() -> str:
    """Return the installed version of farm; empty if it is unknown."""
    try:
        return version("farm")
    except PackageNotFoundError:
        return ""


class HostPaths:
    """Files of the service of one farm on this host.

    Parameters
    ----------
    farm
        Name of the farm.
    env
        Environment, which names the state folder.
    """

    def __init__(self, farm: str, env: Mapping[str, str] = os.environ) -> None:
        self.farm, self._env = farm, env
        self.folder = find_folder(farm, _FOLDER, env)
        self.lock_file = self.folder / "lock"
        self.log_file = self.folder / "host.log"
        self._agents = self.folder / "agents.json"
        self._version = self.folder / "version.json"

    def find_agent_folder(self, printer: str) -> Path:
        """Return the folder of an agent. Raises AgentError if the name points elsewhere."""
        if printer.startswith("."):
            raise AgentError(f"{printer!r}: not the name of a printer")
        return find_folder(self.farm, printer, self._env)

    def create_folder(self) -> None:
        """Create the folder, accessible to its user only."""
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)

    @contextmanager
    def open_socket_path(self) -> Iterator[str]:
        """Yield a short path to the socket, as its path in a deep folder would be too long."""
        descriptor = os.open(self.folder, os.O_PATH | os.O_DIRECTORY)
        try:
            yield f"/proc/self/fd/{descriptor}/host.sock"
        finally:
            os.close(descriptor)

    def read_agents(self) -> dict[str, tuple[StartFile, Installation | None]]:
        """Read the agents that this host runs, each with the installation that it keeps, if any."""
        with suppress(OSError, ValueError, TypeError, KeyError):
            rows = json.loads(self._agents.read_text())
            return {
                row["start"]["printer"]: (
                    StartFile(**row["start"]),
                    Installation(**row["kept"]) if row["kept"] else None,
                )
                for row in rows
            }
        return {}

    def write_agents(self, agents: Sequence[tuple[StartFile, Installation | None]]) -> None:
        """Store the agents that this host runs. Raises OSError."""
        rows = [
            {"start": asdict(start), "kept": asdict(kept_installation) if kept_installation else None}
            for start, kept_installation in agents
        ]
        _replace_file(self._agents, json.dumps(rows))

    def write_version(self) -> None:
        """Store the version of the running service. Raises OSError."""
        _replace_file(self._version, self._describe_version())

    def _describe_version(self) -> str:
        return json.dumps([read_version(), *asdict(Installation.from_this_process()).values()])

    def has_this_version(self) -> bool:
        """Return whether the running service has the version and installation of this process."""
        with suppress(OSError):
            return self._version.read_text() == self._describe_version()
        return False


def _replace_file(path: Path, text: str) -> None:
    new_path = path.with_name(f".{path.name}.new")
    new_path.write_text(text)
    new_path.replace(path)


def connect_to_service(paths: HostPaths) -> socket.socket:
    """Connect to the service of this host; start it unless one of this version is running.

    Raises
    ------
    AgentError
        The service does not start or does not answer.
    """
    if is_locked(paths.lock_file) and not paths.has_this_version():
        end_service(paths)
    deadline_s, process = time.monotonic() + _START_TIMEOUT_S, None
    while time.monotonic() < deadline_s:
        if not is_locked(paths.lock_file) and (process is None or process.poll() is not None):
            process = _start_service(paths)
        with suppress(OSError), paths.open_socket_path() as path:
            connection = socket.socket(socket.AF_UNIX)
            try:
                connection.connect(path)
            except OSError:
                connection.close()
                raise
            return connection
        time.sleep(RETRY_INTERVAL_S)
    raise AgentError(f"{paths.folder}: the service of this host does not answer; see {paths.log_file}")


def _start_service(paths: HostPaths) -> subprocess.Popen[bytes]:
    """Start the service in its own process session, in which it survives this connection."""
    installation = Installation.from_this_process()
    try:
        paths.create_folder()
        with paths.log_file.open("ab") as log:
            return subprocess.Popen(
                [installation.python, "-m", "drivers.host.service", paths.farm],
                cwd=installation.folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
    except OSError as error:
        raise AgentError(f"{paths.folder}: the service of this host does not start ({error})") from error


def end_service(paths: HostPaths) -> None:
    """End the service; its agents continue. Raises AgentError if it cannot be ended."""
    pid = find_holder(paths.lock_file)
    if pid is not None:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)
    deadline_s = time.monotonic() + _END_TIMEOUT_S
    while is_locked(paths.lock_file) and time.monotonic() < deadline_s:
        time.sleep(RETRY_INTERVAL_S / 5)
    if is_locked(paths.lock_file) and not kill_holder(paths.lock_file):
        raise AgentError(f"{paths.folder}: the service of another version cannot be ended; end it by hand")
