"""Callers on the network: holders of keys, users with a session in a browser, and visitors."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass

from fastapi import Request

from farm.control import find_key
from farm.errors import FarmError, RefusedError
from farm.http import Services
from farm.model import Key, KeyKind, Role
from farm.web.cookies import SessionCookie
from farm.web.request_checks import Refusal, WrongKeys

log = logging.getLogger(__name__)

_BEARER = "bearer "


@dataclass(frozen=True, slots=True)
class KeyHolder:
    """Caller on the network with a key, or with a session in a browser.

    Attributes
    ----------
    key
        The key or session.
    role
        Current role of the caller.
    """

    key: Key
    role: Role

    @property
    def name(self) -> str:
        """Name for the event log."""
        return self.key.caller

    @property
    def has_session(self) -> bool:
        """True for a session in a browser."""
        return self.key.kind is KeyKind.SESSION

    def is_operator(self, group: str | None) -> bool:
        """Return whether the caller has the role of an operator; `group` counts only on the Unix socket."""
        return self.role is Role.OPERATE


@dataclass(frozen=True, slots=True)
class Visitor:
    """Caller on the network without a key, on a route that requires none."""

    address: str

    @property
    def name(self) -> str:
        """Name for the event log."""
        return f"visitor at {self.address}"

    def is_operator(self, group: str | None) -> bool:
        """Return False: a visitor has no role."""
        return False


def find_holder(request: Request) -> KeyHolder:
    """Return the caller of a request, whom `app.Guard` has identified. Raises RefusedError for a visitor."""
    caller = request.state.caller
    if isinstance(caller, KeyHolder):
        return caller
    raise RefusedError("this request needs a session: `farm web` on the farm's host opens one")


class CallerFinder:
    """Finder of a request's caller by key or session; it limits the number of wrong keys from an address.

    Parameters
    ----------
    services
        Source of the keys and sessions, the farm's clock, and the roles of users.
    cookie
        The cookie of sessions.
    """

    def __init__(self, services: Services, cookie: SessionCookie) -> None:
        self._services, self._controller, self._cookie = services, services.controller, cookie
        self._wrong_keys = WrongKeys()

    def find(self, headers: Mapping[str, str], address: str) -> KeyHolder | Refusal:
        """Find the caller by the key or session in a request's headers; a key takes precedence.

        Parameters
        ----------
        headers
            Headers of the request.
        address
            Address of the client.
        """
        text = headers.get("x-api-key") or _read_bearer(headers.get("authorization", ""))
        if text:
            return self.find_key_holder(text, address)
        text = self._cookie.read(headers.get("cookie", ""))
        if text:
            return self.find_key_holder(text, address, KeyKind.SESSION)
        return Refusal(401, "this needs a key: an operator creates one with `farm key add NAME`")

    def find_key_holder(self, text: str, address: str, kind: KeyKind = KeyKind.KEY) -> KeyHolder | Refusal:
        """Find the caller by the text of a key or session; count a text that is not valid as a wrong key."""
        now_s = self._controller.clock.now()
        key = find_key(text, self._controller.books.keys, now_s, kind)
        if key is not None:
            role = self.find_role(key)
            return (
                KeyHolder(key, role) if role else Refusal(403, f"this host no longer has a user {key.name}")
            )
        refusal = self._wrong_keys.check(address, now_s)
        if refusal is None:
            self._wrong_keys.add(address, now_s)
            log.warning("refused a wrong, expired or revoked %s from %s", kind, address)
        if refusal is None and kind is KeyKind.SESSION:
            return Refusal(401, "this session has ended: `farm web` on the farm's host opens another")
        return refusal or Refusal(
            401, "this key is wrong, expired or revoked: `farm key` lists the valid ones"
        )

    def find_role(self, key: Key) -> Role | None:
        """Return the current role of a valid key or session; None for a session whose user was deleted.

        A session has at most the current role of its user: a user who has left the group of operators
        loses the role of an operator.
        """
        if key.user is None:
            return key.role
        role = self._services.find_user_role(key.user, self._controller.fleet.fleet.operators)
        return None if role is None else key.role.limit_to(role)

    def extend_session(self, session: Key) -> None:
        """Extend a session that is in use; if the extension cannot be stored, the session ends earlier."""
        try:
            self._services.sessions.extend(session)
        except FarmError as error:
            log.warning("the session %s is not extended: %s", session.id, error)


def _read_bearer(authorization: str) -> str:
    return authorization[len(_BEARER) :].strip() if authorization.lower().startswith(_BEARER) else ""
