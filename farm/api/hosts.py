"""Other computers that run agents, as `farm hosts` shows them."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from farm.api.base import SCHEMA, View


class HostAgentView(View):
    """Agent on a host."""

    printer: str
    state: str
    pid: int | None
    restarts: int
    installation: str  # folder of the installation that the agent runs
    reason: str | None


class HostPortView(View):
    """Serial port of a host."""

    port: str
    description: str
    printer: str | None


class HostView(View):
    """Computer that runs agents, with its connection to the daemon."""

    host: str
    connected: str | None  # time at which the connection was made; null while disconnected
    lost: str | None  # time at which the connection was lost; null while connected
    waiting: str | None  # description of what the host waits for
    version: str | None  # version of farm that its service runs
    printers: list[str]
    agents: list[HostAgentView]
    ports: list[HostPortView]
    update: str | None  # phase of the update of its agents


class HostList(View):
    """All other computers that run agents."""

    model_config = ConfigDict(populate_by_name=True)
    schema_: int = Field(default=SCHEMA, alias="schema")
    now: str
    hosts: list[HostView]


class HostUpdate(View):
    """Hosts whose agents are updated."""

    hosts: list[str]
