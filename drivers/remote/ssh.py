"""Connection to an agent on another host: a command that copies bytes to `bridge` there."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum

from drivers.errors import AgentError
from drivers.records import StartFile
from drivers.safety import StopResult

SSH_COMMAND = (
    "ssh -T -o BatchMode=yes -o ConnectTimeout=10 -o ServerAliveInterval=5 -o ServerAliveCountMax=3 "
    "-o ControlMaster=no -o ControlPath=none"
)
NO_AGENT_REASON = "no agent is running there"
_STOP_TIMEOUT_S = 200.0  # wall seconds for an emergency stop


class BridgeTask(StrEnum):
    """Task of a bridge."""

    SERVE = "serve"  # connect to the agent, and start one if none is running
    REACH = "reach"  # connect to the agent, if one is running
    STOP = "stop"  # emergency stop


@dataclass(frozen=True, slots=True)
class BridgeRequest:
    """First line sent to a bridge. Its JSON names are fixed, as daemons store it on disk.

    Attributes
    ----------
    do
        The task.
    farm
        Name of the farm, which separates the printers of two farms on one host.
    start
        Start file of the agent.
    """

    do: BridgeTask
    farm: str
    start: StartFile

    def serialise(self) -> bytes:
        """Serialise the request as one line of JSON."""
        return json.dumps(asdict(self)).encode() + b"\n"

    @classmethod
    def parse(cls, line: bytes) -> BridgeRequest:
        """Parse a request. Raises AgentError."""
        try:
            raw = json.loads(line)
            return cls(BridgeTask(raw["do"]), str(raw["farm"]), StartFile(**raw["start"]))
        except (ValueError, KeyError, TypeError) as error:
            raise AgentError(
                f"not a request of this version of farm ({error}): install the same version on both hosts"
            ) from error


def build_ssh_command(host: str, command: str, env: Mapping[str, str] = os.environ) -> list[str]:
    """Build the arguments that run a command on a host; the variable FARM_SSH replaces `SSH_COMMAND`."""
    return [*(env.get("FARM_SSH") or SSH_COMMAND).split(), "--", host, command]


def runs_host_service(command: str) -> bool:
    """Return whether a `host_command` is `farm host`, which carries all agents of its host at once."""
    return command.split()[-1:] == ["host"]


def stop_over_ssh(
    host: str, command: str, farm: str, start: StartFile, timeout_s: float = _STOP_TIMEOUT_S
) -> StopResult:
    """Run the emergency stop of a printer on another host. Never raises.

    Parameters
    ----------
    host, command
        The host, and the command that starts the bridge there.
    farm, start
        See `BridgeRequest`.
    timeout_s
        Wall seconds for the result.
    """
    request, stderr = BridgeRequest(BridgeTask.STOP, farm, start), ""
    try:
        process = subprocess.run(
            build_ssh_command(host, command),
            input=request.serialise(),
            capture_output=True,
            timeout=timeout_s,
            check=False,
        )
        stderr = process.stderr.decode(errors="replace").strip()
        return StopResult.parse(process.stdout)
    except subprocess.TimeoutExpired:
        reason = "does not answer"
    except (OSError, ValueError, TypeError) as error:
        reason = stderr.splitlines()[-1] if stderr else f"no result ({error})"
    return StopResult(
        start.printer, None, False, f"cannot be stopped ({host}: {reason}); switch the printer off"
    )
