"""Messages between a daemon and the service of a host: JSON, beside the streams to the agents."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from drivers.errors import AgentError
from drivers.records import StartFile

HOST_PROTOCOL = 1
"""Version of these messages, increased when the meaning of one changes; new fields have defaults."""
STATE_INTERVAL_S = 5.0
"""Wall seconds between two states of a host; they are the heartbeat of the connection."""
SILENCE_TIMEOUT_S = 20.0
"""Wall seconds after which a silent connection is lost."""


class _Message(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)  # the other end may be newer


class HostTask(StrEnum):
    """Task of `farm host`, in its first line."""

    CARRY = "carry"  # run the agents, and relay connections to their sockets over this one
    STOP = "stop"  # emergency stop


class HostRequest(_Message):
    """First line sent to `farm host`.

    Attributes
    ----------
    do
        The task.
    farm
        Name of the farm, which separates the printers of two farms on one host.
    starts
        Start files of the agents that this host runs, or of the printers to stop.
    report_s
        Wall seconds between two reports of a printer in which only temperatures and progress have changed.
    """

    protocol: int = HOST_PROTOCOL
    do: HostTask
    farm: str
    starts: tuple[StartFile, ...]
    report_s: float = 1.0

    def serialise(self) -> bytes:
        """Serialise the request as one line."""
        return self.model_dump_json().encode() + b"\n"

    @classmethod
    def parse(cls, line: bytes) -> HostRequest:
        """Parse a request. Raises AgentError."""
        try:
            return cls.model_validate_json(line)
        except ValidationError as error:
            raise AgentError(
                f"not a request of this version of farm ({error.errors()[0]['msg']}): install the same "
                "version on both hosts"
            ) from error


class HostMessage(_Message):
    """Message of the daemon on an open connection."""

    do: Literal["ping", "agents", "update", "halt"]  # halt: stop the update of the agents
    starts: tuple[StartFile, ...] = ()  # of `agents`: the agents that this host runs from now on

    def encode(self) -> bytes:
        """Serialise the message."""
        return self.model_dump_json().encode()


class AgentPhase(StrEnum):
    """State of an agent's process, as its host sees it."""

    STARTING = "starting"  # was started, but has not reported yet
    IDLE = "idle"
    PRINTING = "printing"
    WAITING = "waiting"  # has ended, and is started again after a wait
    ENDING = "ending"  # no longer in the fleet


class AgentState(_Message):
    """An agent on this host."""

    printer: str
    phase: AgentPhase
    pid: int | None = None
    restarts: int = 0  # since the service started
    installation: str = ""  # folder of the version of farm that it runs
    reason: str | None = None


class PortState(_Message):
    """A serial port of this host."""

    port: str
    description: str
    printer: str | None = None


class UpdatePhase(StrEnum):
    """State of the update of a host's agents."""

    CURRENT = "current"  # all agents run the version of the service
    OUTDATED = "outdated"
    RUNNING = "running"
    FAILED = "failed"  # an agent of the new version had a fault; its old version runs again


class Update(_Message):
    """Update of a host's agents to the version of its service."""

    phase: UpdatePhase = UpdatePhase.CURRENT
    reason: str | None = None


class HostState(_Message):
    """State of a host."""

    protocol: int = HOST_PROTOCOL
    version: str = ""  # of farm
    installation: str = ""
    pid: int
    agents: tuple[AgentState, ...] = ()
    ports: tuple[PortState, ...] = ()
    update: Update = Update()

    def encode(self) -> bytes:
        """Serialise the state."""
        return self.model_dump_json().encode()


def is_for_host(line: bytes) -> bool:
    """Return whether a first line is a `HostRequest` and not a `BridgeRequest`."""
    try:
        return "starts" in json.loads(line)
    except (ValueError, TypeError):
        return False
