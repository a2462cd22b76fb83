"""Connections to agents, on this host and on others."""

from farm.agents.manager import AgentManager

__all__ = [
    "AgentManager",
]
