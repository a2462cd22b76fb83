"""Bridge to an agent: ``python -m drivers.remote.bridge``, which runs over ssh on the agent's host.

The first line on stdin is a `BridgeRequest`. For SERVE, the bridge starts the agent if none is running, and
then copies bytes between stdin, stdout and the agent's socket until one of them closes; REACH does the same,
but starts no agent. The agent runs in its own process session: it continues when the connection breaks, and
the next bridge finds it.
"""

from __future__ import annotations

import os
import select
import socket
import sys
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from drivers.errors import AgentError, DriverError
from drivers.messages import AGENT_SOCKET
from drivers.records import AGENT_LOG
from drivers.remote.heartbeat import Heartbeat, sample_process
from drivers.remote.process import (
    RETRY_INTERVAL_S,
    find_agent_pid,
    is_alive,
    kill_agent,
    start_agent,
)
from drivers.remote.ssh import NO_AGENT_REASON, BridgeRequest, BridgeTask
from drivers.safety import StopTarget, stop_printer

_CONNECT_TIMEOUT_S = 30.0
_POLL_INTERVAL_S = 0.5
_READ_BYTES = 65536


def find_folder(farm: str, printer: str, env: Mapping[str, str] = os.environ) -> Path:
    """Return the agent's folder on this host.

    Parameters
    ----------
    farm, printer
        Name of the farm, and of the agent's printer.
    env
        Environment, which names the state folder.

    Raises
    ------
    AgentError
        A name would point outside the state folder.
    """
    if any(name in ("", ".", "..") or "/" in name for name in (farm, printer)):
        raise AgentError(f"{farm!r}, {printer!r}: not the names of a farm and a printer")
    state = Path(env.get("XDG_STATE_HOME") or Path(env.get("HOME", "/")) / ".local/state")
    return state / "farm-agents" / farm / printer


def serve(request: BridgeRequest, folder: Path) -> None:
    """Copy bytes until one end closes; kill the agent if it hangs.

    Raises
    ------
    DriverError
        There is no agent, or the agent does not start or has stopped responding.
    """
    start = request.start
    if not is_alive(folder):
        if request.do is BridgeTask.REACH:
            raise AgentError(f"{start.printer}: {NO_AGENT_REASON}")
        start_agent(start, folder)
    with _connect_to_agent(folder) as agent:
        heartbeat = Heartbeat()
        while True:
            ready = select.select([0, agent.fileno()], [], [], _POLL_INTERVAL_S)[0]
            if agent.fileno() in ready:
                data = agent.recv(_READ_BYTES)
                heartbeat.reset()
                if not data:
                    return
                _write_to_stdout(data)
            if 0 in ready:
                data = os.read(0, _READ_BYTES)
                if not data:
                    return
                agent.sendall(data)
            pid = find_agent_pid(folder)
            if pid is not None and heartbeat.is_hung(time.monotonic(), partial(sample_process, pid)):
                kill_agent(folder)
                raise AgentError(f"{start.printer}: its agent stopped responding, and is replaced")


def _connect_to_agent(folder: Path) -> socket.socket:
    deadline_s = time.monotonic() + _CONNECT_TIMEOUT_S
    while True:
        agent = socket.socket(socket.AF_UNIX)
        try:
            descriptor = os.open(folder, os.O_PATH | os.O_DIRECTORY)
            try:
                agent.connect(f"/proc/self/fd/{descriptor}/{AGENT_SOCKET}")
            finally:
                os.close(descriptor)
        except OSError as error:
            agent.close()
            if time.monotonic() > deadline_s:
                raise AgentError(f"{folder}: no agent answers; see {folder / AGENT_LOG}") from error
            time.sleep(RETRY_INTERVAL_S)
        else:
            return agent


def _write_to_stdout(data: bytes) -> None:
    while data:
        data = data[os.write(1, data) :]


def read_first_line() -> bytes:
    """Read the first line of stdin, and nothing after it; empty if there is none."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(0, 1)
        if not byte:
            return b""
        line += byte
    return line


def main() -> int:
    """Read the request and execute it."""
    line = read_first_line()
    return execute(line) if line else 2


def execute(line: bytes) -> int:
    """Execute the request in a first line; return the exit code."""
    try:
        request = BridgeRequest.parse(line)
        folder = find_folder(request.farm, request.start.printer)
        if request.do is BridgeTask.STOP:
            result = stop_printer(StopTarget.from_agent(request.start, folder))
            _write_to_stdout(result.dump().encode() + b"\n")
        else:
            serve(request, folder)
    except BrokenPipeError:
        return 0
    except (DriverError, OSError) as error:
        print(f"farm: {error}", file=sys.stderr)  # noqa: T201 - the daemon logs it
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
