"""An agent on another host: ``ssh HOST python -m drivers.remote.bridge``, kept up by the daemon.

The first line on stdin says what to do, as JSON (`Errand`). To serve is to start the agent where none lives
and then to carry bytes between stdin, stdout and the agent's socket, until one of them ends; to reach it is
the same, but none is started. The agent is in a session of its own: a bridge that breaks, as networks do, is
nothing to it, and the next one finds it.
"""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path

from drivers.agent.heartbeat import Heartbeat, look_at
from drivers.errors import AgentError, DriverError
from drivers.printers import firmware_of
from drivers.records import StartFile
from drivers.remote import client
from drivers.safety import estop

SSH = (
    "ssh -T -o BatchMode=yes -o ConnectTimeout=10 -o ServerAliveInterval=5 -o ServerAliveCountMax=3 "
    "-o ControlMaster=no -o ControlPath=none"
)
NOBODY = "no agent lives there"
_CONNECT_S = 30.0
_STOP_S = 200.0
_LOOK_S = 0.5
_BYTES = 65536


class Do(StrEnum):
    """Purpose of a bridge."""

    SERVE = "serve"
    REACH = "reach"  # the same where an agent lives
    STOP = "stop"  # the emergency stop


@dataclass(frozen=True, slots=True)
class Errand:
    """First line to a bridge. `farm` keeps the printers of two farms on one host apart."""

    do: Do
    farm: str
    start: StartFile

    def line(self) -> bytes:
        return json.dumps(asdict(self)).encode() + b"\n"


def parse(line: bytes) -> Errand:
    """Read the first line; raises AgentError."""
    try:
        raw = json.loads(line)
        return Errand(Do(raw["do"]), str(raw["farm"]), StartFile(**raw["start"]))
    except (ValueError, KeyError, TypeError) as error:
        raise AgentError(f"no errand of this version of farm ({error}): install the same on both") from error


def words(host: str, command: str, env: Mapping[str, str] = os.environ) -> list[str]:
    """The program that carries bytes to a bridge on `host`; FARM_SSH is another ssh with its options."""
    return [*(env.get("FARM_SSH") or SSH).split(), "--", host, command]


def folder_of(farm: str, printer: str, env: Mapping[str, str] = os.environ) -> Path:
    """The agent's folder on this host.

    Raises
    ------
    AgentError
        A name that would leave it.
    """
    if any(name in ("", ".", "..") or "/" in name for name in (farm, printer)):
        raise AgentError(f"{farm!r}, {printer!r}: no names of a farm and a printer")
    state = Path(env.get("XDG_STATE_HOME") or Path(env.get("HOME", "/")) / ".local/state")
    return state / "farm-agents" / farm / printer


def stop_there(
    host: str, command: str, farm: str, start: StartFile, patience_s: float = _STOP_S
) -> estop.StopResult:
    """The emergency stop of a printer on another host. Never raises."""
    errand, said = Errand(Do.STOP, farm, start), ""
    try:
        done = subprocess.run(
            words(host, command), input=errand.line(), capture_output=True, timeout=patience_s, check=False
        )
        said = done.stderr.decode(errors="replace").strip()
        return estop.StopResult(**json.loads(done.stdout))
    except subprocess.TimeoutExpired:
        why = "does not answer"
    except (OSError, ValueError, TypeError) as error:
        why = said.splitlines()[-1] if said else f"the way there said nothing ({error})"
    return estop.StopResult(start.printer, None, False, f"cannot be stopped: {host}: {why}; switch it off")


def serve(errand: Errand, folder: Path) -> None:
    """Carry bytes until an end closes; an agent that is wedged is killed.

    Raises
    ------
    DriverError
        No agent comes up.
    """
    start = errand.start
    if not client.alive(folder):
        if errand.do is Do.REACH:
            raise AgentError(f"{start.printer}: {NOBODY}")
        client.spawn(start.printer, start.model, start.port, folder, start.clock, start.power_off_cmd)
    with _connect(folder) as agent:
        heartbeat = Heartbeat()
        while True:
            ready = select.select([0, agent.fileno()], [], [], _LOOK_S)[0]
            if agent.fileno() in ready:
                data = agent.recv(_BYTES)
                heartbeat.heard()
                if not data:
                    return
                _write(data)
            if 0 in ready:
                data = os.read(0, _BYTES)
                if not data:
                    return
                agent.sendall(data)
            pid = client.pid(folder)
            if pid is not None and heartbeat.wedged(time.monotonic(), partial(look_at, pid)):
                client.kill(folder)
                raise AgentError(f"{start.printer}: its agent was wedged, and is replaced")


def _connect(folder: Path) -> socket.socket:
    until_s = time.monotonic() + _CONNECT_S
    while True:
        agent = socket.socket(socket.AF_UNIX)
        try:
            descriptor = os.open(folder, os.O_PATH | os.O_DIRECTORY)
            try:
                agent.connect(f"/proc/self/fd/{descriptor}/{client.SOCKET}")
            finally:
                os.close(descriptor)
        except OSError as error:
            agent.close()
            if time.monotonic() > until_s:
                raise AgentError(f"{folder}: no agent answers; see {folder / client.LOG}") from error
            time.sleep(client.RETRY_S)
        else:
            return agent


def _write(data: bytes) -> None:
    while data:
        data = data[os.write(1, data) :]


def main() -> int:
    """Read the errand, do it."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(0, 1)
        if not byte:
            return 2
        line += byte
    try:
        errand = parse(line)
        folder = folder_of(errand.farm, errand.start.printer)
        if errand.do is Do.STOP:
            start = errand.start
            target = estop.StopTarget(
                start.printer, start.port, folder, start.power_off_cmd, firmware_of(start.model)
            )
            _write(json.dumps(asdict(estop.stop_printer(target))).encode() + b"\n")
        else:
            serve(errand, folder)
    except BrokenPipeError:
        return 0
    except (DriverError, OSError) as error:
        print(f"farm: {error}", file=sys.stderr)  # noqa: T201 - the daemon logs it
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
