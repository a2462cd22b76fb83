"""Functions that start, find and kill the processes of agents on this host."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import drivers
from drivers.clock import Clock
from drivers.errors import AgentError
from drivers.locks import AGENT_LOCK, find_holder, is_locked, kill_holder
from drivers.records import AGENT_LOG, StartFile

UNIT_VARIABLE = "FARM_AGENT_UNIT"
RETRY_INTERVAL_S = 0.25  # wall seconds between two attempts to connect to an agent that is starting


@dataclass(frozen=True, slots=True)
class Installation:
    """Installation of farm that an agent runs.

    Attributes
    ----------
    python
        Path of the interpreter. Links in its folder are resolved, as a link to the current version may
        change.
    folder
        Folder that contains `drivers`.
    """

    python: str
    folder: str

    @classmethod
    def from_this_process(cls) -> Installation:
        """Return the installation that this process runs."""
        python = Path(sys.executable)
        folder = Path(drivers.__file__).resolve().parents[1]
        return cls(str(python.parent.resolve() / python.name), str(folder))

    @classmethod
    def from_agent(cls, pid: int) -> Installation | None:
        """Return the installation that an agent runs; None if it has ended."""
        process = Path("/proc") / str(pid)
        try:
            python = process.joinpath("cmdline").read_bytes().split(b"\0")[0]
            folder = process.joinpath("cwd").readlink()
        except OSError:
            return None
        path = Path(os.fsdecode(python))
        return cls(str(path.parent.resolve() / path.name), str(folder))

    @property
    def exists(self) -> bool:
        """True unless the installation was deleted."""
        return Path(self.python).exists() and Path(self.folder).is_dir()


def spawn_agent(
    printer: str, model: str, port: str, folder: Path, clock: Clock, power_off_cmd: str | None = None
) -> subprocess.Popen[bytes]:
    """Start an agent in its own process session, so that it survives the caller.

    If the environment names a systemd unit (`FARM_AGENT_UNIT`, with %i for the printer), that unit is started
    instead, and the returned process is systemctl's.

    Parameters
    ----------
    printer, model, port, power_off_cmd
        As in `fleet.yaml`.
    folder
        The agent's folder, created if missing, with its log `agent.log`.
    clock
        The farm's clock.

    Returns
    -------
    subprocess.Popen
        The process. Poll it regularly to reap it when it ends.

    Raises
    ------
    AgentError
        The process cannot be started.
    """
    return start_agent(StartFile(printer, model, port, clock.scale, clock.anchor_s, power_off_cmd), folder)


def start_agent(
    start: StartFile, folder: Path, installation: Installation | None = None
) -> subprocess.Popen[bytes]:
    """Start an agent as `spawn_agent` does, from this or another installation of farm.

    Parameters
    ----------
    start
        The agent's start file, which is written into its folder.
    folder
        The agent's folder, created if missing.
    installation
        Installation of farm that the agent runs; None for the installation of this process.

    Raises
    ------
    AgentError
        The process cannot be started.
    """
    installation, unit = installation or Installation.from_this_process(), os.environ.get(UNIT_VARIABLE)
    command = [installation.python, "-m", "drivers.agent", "--folder", str(folder.absolute())]
    if unit:
        command = ["systemctl", "start", unit.replace("%i", start.printer)]
    try:
        start.write(folder)
        with _open_log(folder) as log:
            return subprocess.Popen(
                command,
                cwd=installation.folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
    except OSError as error:
        raise AgentError(
            f"{start.printer}: its agent does not start ({error}); see {folder / AGENT_LOG}"
        ) from error


def _open_log(folder: Path) -> BinaryIO:
    """Open an agent's log, or /dev/null on a full disk: the agent may have to switch heaters off."""
    try:
        return (folder / AGENT_LOG).open("ab")
    except OSError:
        return Path(os.devnull).open("ab")


def agents_are_units() -> bool:
    """Return True if agents are started as systemd units."""
    return bool(os.environ.get(UNIT_VARIABLE))


def is_alive(folder: Path) -> bool:
    """Return True while an agent holds the lock of this folder."""
    return is_locked(folder / AGENT_LOCK)


def kill_agent(folder: Path) -> bool:
    """Kill the agent of this folder; return True if none is alive afterwards."""
    return kill_holder(folder / AGENT_LOCK)


def find_agent_pid(folder: Path) -> int | None:
    """Return the process id of the agent of this folder; None if none is alive."""
    return find_holder(folder / AGENT_LOCK)
