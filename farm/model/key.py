"""Keys that identify programs and people on other hosts to the daemon."""

from __future__ import annotations

from enum import StrEnum

from farm.model.entity import Entity


class Role(StrEnum):
    """Permissions of a caller on the network; each role includes the permissions of those before it."""

    LOOK = "look"  # see everything
    PRINT = "print"  # submit, pause and cancel
    OPERATE = "operate"  # approve, clear beds, load reels, end maintenance

    def allows(self, role: Role) -> bool:
        """Return whether a caller with this role may use a function that requires `role`."""
        order = list(Role)
        return order.index(self) >= order.index(role)

    def limit_to(self, max_role: Role) -> Role:
        """Return this role, or `max_role` if that permits less."""
        return max_role if self.allows(max_role) else self


class KeyKind(StrEnum):
    """Kind of key: for a program or a person, or for a browser."""

    KEY = "key"  # a program or a person, who sends it with each request
    SESSION = "session"  # a browser, which keeps it as a cookie


class Key(Entity):
    """Key of a caller on the network. The secret itself is not kept."""

    id: str
    kind: KeyKind = KeyKind.KEY
    name: str  # for a session: the name of the user, or of the key that opened it
    role: Role
    digest: str  # SHA-256 of the key's text, in hexadecimal
    created_s: float
    by: str  # name of the operator who added the key, or of the caller who opened the session
    expires_s: float | None = None  # None: never; the end of a session is postponed while it is used
    revoked_s: float | None = None
    opened_by: str | None = None  # id of the key that opened a session; None: a link for a user

    @property
    def user(self) -> str | None:
        """Name of the user of this host who owns the session; None for a key and for a key's sessions."""
        return self.name if self.kind is KeyKind.SESSION and self.opened_by is None else None

    @property
    def caller(self) -> str:
        """Name of the caller for the event log; a user has the same name as on the Unix socket."""
        return self.user or f"key {self.name}"

    def is_valid(self, now_s: float) -> bool:
        """Return whether the key is accepted at a time on the farm's clock."""
        return self.revoked_s is None and (self.expires_s is None or now_s < self.expires_s)
