"""Sessions of browsers: opened by a key, or by a link that is valid once; extended while they are used.

A user requests such a link on the daemon's host, where the kernel reports the user's name. Links are kept in
memory, by their SHA-256; sessions are keys in the books. A session ends with the key that opened it.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from dataclasses import dataclass

from farm import api
from farm.control.access.keys import digest_key, make_key_text
from farm.control.controller import Controller
from farm.errors import NotFoundError
from farm.model import Key, KeyKind, Role
from farm.state import events as ev

LINK_LIFETIME_S = 300.0
"""Wall seconds for which a link is valid."""
MAX_IDLE_S = 12 * 3600.0
"""Wall seconds after which an unused session ends."""
MAX_SESSION_S = 30 * 86400.0
"""Wall seconds after which every session ends."""
MAX_SESSIONS = 10
"""Maximum number of open sessions of one user or key; one more ends the oldest."""
_EXTENSION_INTERVAL_S = 3600.0  # minimum wall seconds from one extension to the next; each is an event
_MAX_LINKS = 5  # maximum number of links of one user
_MAX_LINKS_TOTAL = 100
_TOKEN_BYTES = 32


@dataclass(frozen=True, slots=True)
class LoginLink:
    """Link that opens one session for the user who requested it; `end_s` is on the farm's clock."""

    user: str
    role: Role
    end_s: float


def list_open_sessions(keys: Iterable[Key], now_s: float, caller: str | None = None) -> list[Key]:
    """List the open sessions of a caller (None: of all callers), oldest first."""
    sessions = [
        key
        for key in keys
        if key.kind is KeyKind.SESSION and key.is_valid(now_s) and caller in (None, key.caller)
    ]
    return sorted(sessions, key=lambda session: session.created_s)


def find_session_end_s(created_s: float, now_s: float, scale: float, key: Key | None = None) -> float:
    """Return the time on the farm's clock at which a session ends if it is not used again.

    Parameters
    ----------
    created_s, now_s
        Time at which the session was opened, and the current time, on the farm's clock.
    scale
        Farm seconds per wall second.
    key
        The key that opened the session; None if a link did.
    """
    end_s = min(now_s + MAX_IDLE_S * scale, created_s + MAX_SESSION_S * scale)
    return end_s if key is None or key.expires_s is None else min(end_s, key.expires_s)


class SessionCommands:
    """Commands about sessions. The farm's two servers, for the socket and the network, share one object."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._links: dict[str, LoginLink] = {}  # by the digest of the token, oldest first

    def make_link(self, user: str, role: Role) -> str:
        """Make a link for a user, and return its token, which is not stored.

        Parameters
        ----------
        user
            Name of the user, as reported by the kernel.
        role
            Role of the session that the link opens.
        """
        clock = self._controller.clock
        now_s = clock.now()
        open_links = {digest: link for digest, link in self._links.items() if now_s < link.end_s}
        user_links = [digest for digest, link in open_links.items() if link.user == user]
        for digest in user_links[: max(0, len(user_links) - _MAX_LINKS + 1)]:
            del open_links[digest]
        if len(open_links) >= _MAX_LINKS_TOTAL:
            del open_links[next(iter(open_links))]
        token = secrets.token_urlsafe(_TOKEN_BYTES)
        open_links[digest_key(token)] = LoginLink(user, role, now_s + LINK_LIFETIME_S * clock.scale)
        self._links = open_links
        return token

    def find_link(self, token: str) -> LoginLink:
        """Return the link that has this token; the link stays valid.

        Raises
        ------
        NotFoundError
            If the link is unknown, used or expired.
        """
        link = self._links.get(digest_key(token))
        if link is None or self._controller.clock.now() >= link.end_s:
            raise NotFoundError(
                "this link was used or has expired: `farm web` on the farm's host makes a new one"
            )
        return link

    def open(self, token: str) -> str:
        """Open a session with a link, invalidate the link, and return the text of the session.

        Raises
        ------
        NotFoundError
            If the link is unknown, used or expired.
        """
        link = self.find_link(token)
        del self._links[digest_key(token)]
        return self._open_session(link.user, link.role, None)

    def open_with_key(self, key: Key) -> str:
        """Open a session with a valid key, whose role and expiry it gets; return the text of the session."""
        return self._open_session(key.name, key.role, key)

    def _open_session(self, name: str, role: Role, key: Key | None) -> str:
        clock = self._controller.clock
        now_s = clock.now()
        session_id, text = make_key_text(KeyKind.SESSION)
        session = Key(
            id=session_id,
            kind=KeyKind.SESSION,
            name=name,
            role=role,
            digest=digest_key(text),
            created_s=now_s,
            by=name if key is None else key.caller,
            expires_s=find_session_end_s(now_s, now_s, clock.scale, key),
            opened_by=None if key is None else key.id,
        )
        open_sessions = list_open_sessions(self._controller.books.keys.values(), now_s, session.caller)
        self._controller.handle(
            *(
                ev.KeyRevoked(at_s=now_s, key=session_to_end.id, by=session.caller)
                for session_to_end in open_sessions[: max(0, len(open_sessions) - MAX_SESSIONS + 1)]
            ),
            ev.SessionOpened(at_s=now_s, session=session),
        )
        return text

    def extend(self, session: Key) -> None:
        """Extend a session because it is used; at most once an hour."""
        clock = self._controller.clock
        now_s = clock.now()
        key = self._controller.books.keys.get(session.opened_by or "")
        end_s = find_session_end_s(session.created_s, now_s, clock.scale, key)
        if end_s - (session.expires_s or 0.0) >= _EXTENSION_INTERVAL_S * clock.scale:
            self._controller.handle(ev.SessionExtended(at_s=now_s, session=session.id, expires_s=end_s))

    def end_all_sessions(self, caller_name: str) -> api.EndedSessions:
        """End all sessions, and invalidate all links; return the number of ended sessions."""
        now_s = self._controller.clock.now()
        sessions = list_open_sessions(self._controller.books.keys.values(), now_s)
        self._links.clear()
        self._controller.handle(
            *(ev.KeyRevoked(at_s=now_s, key=session.id, by=caller_name) for session in sessions)
        )
        return api.EndedSessions(ended=len(sessions))
