"""Events of keys and sessions."""

from __future__ import annotations

from farm.model.event import Event
from farm.model.key import Key


class KeyAdded(Event):
    """An operator added a key for callers on the network."""

    key: Key


class KeyRevoked(Event):
    """A key was revoked, or a session was ended."""

    key: str
    by: str


class SessionOpened(Event):
    """A user opened the farm's pages in a browser."""

    session: Key


class SessionExtended(Event):
    """The end of a session was postponed, because the session is in use."""

    session: str
    expires_s: float
