"""Base of all events, and the events of hosts, keys and sessions."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from farm.model.key import Key


class Event(BaseModel):
    """Change that happened at `at_s` on the farm's clock."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    at_s: float


class HostLost(Event):
    """The connection to a host with printers was lost; the agents on that host may still be printing."""

    host: str
    printers: tuple[str, ...]
    reason: str


class HostConnected(Event):
    """A host that was lost is connected again."""

    host: str
    printers: tuple[str, ...]


class KeyAdded(Event):
    """An operator added a key for callers on the network."""

    key: Key


class KeyRevoked(Event):
    """A key was revoked, or a session was ended."""

    key: str  # id of the key or session
    by: str  # name of the caller who ended it


class SessionOpened(Event):
    """A user opened the farm's pages in a browser."""

    session: Key


class SessionExtended(Event):
    """The end of a session was postponed, because the session was in use."""

    session: str
    expires_s: float
