"""Connections to the agents on this host and on other hosts."""

from farm.agents.host_record import HostRecord
from farm.agents.hosts import Hosts
from farm.agents.manager import AgentManager

__all__ = [
    "AgentManager",
    "HostRecord",
    "Hosts",
]
