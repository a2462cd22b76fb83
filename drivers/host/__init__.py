"""Service of a host with printers: it runs their agents and carries the agents' sockets on one connection.

`service` and `program` are not imported here: they are separate programs.
"""

from drivers.host.connection import MAX_LINE_BYTES, MuxConnection
from drivers.host.messages import (
    SILENCE_TIMEOUT_S,
    STATE_INTERVAL_S,
    AgentPhase,
    AgentState,
    HostMessage,
    HostRequest,
    HostState,
    HostTask,
    PortState,
    Update,
    UpdatePhase,
)

__all__ = [
    "MAX_LINE_BYTES",
    "SILENCE_TIMEOUT_S",
    "STATE_INTERVAL_S",
    "AgentPhase",
    "AgentState",
    "HostMessage",
    "HostRequest",
    "HostState",
    "HostTask",
    "MuxConnection",
    "PortState",
    "Update",
    "UpdatePhase",
]
