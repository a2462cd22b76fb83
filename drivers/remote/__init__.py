"""Access to agents: a client of their socket, their processes, and the connection to other hosts.

`bridge` is not imported here: it is the program that ssh runs on another host.
"""

from drivers.records import AGENT_LOG
from drivers.remote.client import AgentClient
from drivers.remote.heartbeat import Heartbeat, sample_process
from drivers.remote.process import (
    RETRY_S,
    agents_are_units,
    find_agent_pid,
    is_alive,
    kill_agent,
    spawn_agent,
)
from drivers.remote.ssh import NO_AGENT, BridgeRequest, BridgeTask, build_ssh_command, stop_over_ssh

__all__ = [
    "AGENT_LOG",
    "NO_AGENT",
    "RETRY_S",
    "AgentClient",
    "BridgeRequest",
    "BridgeTask",
    "Heartbeat",
    "agents_are_units",
    "build_ssh_command",
    "find_agent_pid",
    "is_alive",
    "kill_agent",
    "sample_process",
    "spawn_agent",
    "stop_over_ssh",
]
