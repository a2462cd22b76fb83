"""Requests for keys by programs, which an operator grants or denies; kept in memory only."""

from __future__ import annotations

import re
import secrets
from dataclasses import dataclass

from farm import api
from farm.control.access.keys import CODE_CHARACTERS, KeyCommands
from farm.errors import NotFoundError, RefusedError

_CODE_LENGTH = 4
_TOKEN_BYTES = 24
_MAX_APP_NAME_LENGTH = 30  # characters
_FORBIDDEN_CHARACTERS = re.compile(r"[^A-Za-z0-9._-]+")
MAX_REQUESTS = 5
MAX_REQUESTS_PER_ADDRESS = 2
REQUEST_LIFETIME_S = 300.0
"""Real seconds (not the farm's clock) after which a request is deleted, answered or not."""


@dataclass(slots=True)
class AppKeyRequest:
    """Request for a key by a program.

    Attributes
    ----------
    code
        Short code by which the operator identifies the request.
    app
        Name that the program gave, without forbidden characters.
    address
        Network address of the sender.
    expires_s
        Time at which the request expires, on a monotonic clock.
    key
        Text of the granted key; None before the operator grants it.
    """

    code: str
    app: str
    address: str
    expires_s: float
    key: str | None = None


class AppKeyRequests:
    """Requests for keys; a program identifies its own by a secret token. Times are from a monotonic clock."""

    def __init__(self) -> None:
        self._requests: dict[str, AppKeyRequest] = {}  # by token

    def add(self, app: str, address: str, now_s: float) -> str:
        """Add a request, and return its token. Raises RefusedError if there are too many."""
        open_requests = self.list_open_requests(now_s)
        if (
            len(open_requests) >= MAX_REQUESTS
            or sum(request.address == address for request in open_requests) >= MAX_REQUESTS_PER_ADDRESS
        ):
            raise RefusedError(
                "too many programs are requesting a key: wait for five minutes, or paste an existing key"
            )
        name = _FORBIDDEN_CHARACTERS.sub(" ", app).strip(" ._-")[:_MAX_APP_NAME_LENGTH].strip() or "app"
        code = "".join(secrets.choice(CODE_CHARACTERS) for _ in range(_CODE_LENGTH))
        token = secrets.token_urlsafe(_TOKEN_BYTES)
        self._requests[token] = AppKeyRequest(code, name, address, now_s + REQUEST_LIFETIME_S)
        return token

    def list_open_requests(self, now_s: float) -> list[AppKeyRequest]:
        """Delete the expired requests, and list the unanswered ones."""
        self._requests = {
            token: request for token, request in self._requests.items() if now_s < request.expires_s
        }
        return [request for request in self._requests.values() if request.key is None]

    def find_open_request(self, code: str, now_s: float) -> AppKeyRequest:
        """Return the unanswered request with this code. Raises NotFoundError if there is none."""
        app_request = next(
            (request for request in self.list_open_requests(now_s) if request.code == code), None
        )
        if app_request is None:
            raise NotFoundError(
                f"there is no open request with the code {code}; `farm key` lists the open requests"
            )
        return app_request

    def grant(
        self, code: str, grant: api.AppKeyGrant, caller_name: str, keys: KeyCommands, now_s: float
    ) -> str:
        """Add a key for the program whose request has this code, and return the name of the key.

        Raises
        ------
        NotFoundError
            If there is no unanswered request with this code.
        RefusedError
            If a valid key has the same name.
        """
        app_request = self.find_open_request(code, now_s)
        key_request = api.KeyRequest(name=f"{app_request.app} {code}", role=grant.role, days=grant.days)
        app_request.key = keys.add(key_request, caller_name).text
        return key_request.name

    def deny(self, code: str, now_s: float) -> None:
        """Remove an unanswered request. Raises NotFoundError if there is none with this code."""
        denied_request = self.find_open_request(code, now_s)
        self._requests = {
            token: request for token, request in self._requests.items() if request is not denied_request
        }

    def take_key(self, token: str, now_s: float) -> str | None:
        """Return the granted key, but only once; return None before the operator answers.

        Raises
        ------
        NotFoundError
            If the request was denied, has expired, or is unknown.
        """
        self.list_open_requests(now_s)
        request = self._requests.get(token)
        if request is None:
            raise NotFoundError("this request for a key was denied, or has expired: request a key again")
        if request.key is not None:
            del self._requests[token]
        return request.key
