"""Events of hosts with printers."""

from __future__ import annotations

from farm.model.event import Event


class HostLost(Event):
    """The connection to a host with printers was lost; their agents may still print."""

    host: str
    printers: tuple[str, ...]
    reason: str


class HostConnected(Event):
    """A host that was lost is connected again."""

    host: str
    printers: tuple[str, ...]
