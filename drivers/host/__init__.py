"""The service of a host with printers: its agents, and the one connection that carries their sockets.

`service` and `program` are not imported here: they are separate programs.
"""

from drivers.host.connection import LINE_BYTES, MuxConnection
from drivers.host.messages import (
    SILENCE_S,
    STATE_S,
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
    "LINE_BYTES",
    "SILENCE_S",
    "STATE_S",
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
