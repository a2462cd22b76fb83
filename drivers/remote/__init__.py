"""Access to agents: a client of their sockets, their processes, and the connection to other hosts.

`bridge` is not imported here: it is the program that ssh runs on another host.
"""

from drivers.records import AGENT_LOG
from drivers.remote.client import AgentClient, Route, StreamOpener
from drivers.remote.heartbeat import Heartbeat, sample_process
from drivers.remote.process import (
    RETRY_INTERVAL_S,
    Installation,
    agents_are_units,
    find_agent_pid,
    is_alive,
    kill_agent,
    spawn_agent,
    start_agent,
)
from drivers.remote.ssh import (
    NO_AGENT_REASON,
    BridgeRequest,
    BridgeTask,
    build_ssh_command,
    runs_host_service,
    stop_over_ssh,
)

__all__ = [
    "AGENT_LOG",
    "NO_AGENT_REASON",
    "RETRY_INTERVAL_S",
    "AgentClient",
    "BridgeRequest",
    "BridgeTask",
    "Heartbeat",
    "Installation",
    "Route",
    "StreamOpener",
    "agents_are_units",
    "build_ssh_command",
    "find_agent_pid",
    "is_alive",
    "kill_agent",
    "runs_host_service",
    "sample_process",
    "spawn_agent",
    "start_agent",
    "stop_over_ssh",
]
