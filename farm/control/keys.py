"""Keys of callers on the network: added and revoked. Their text is kept only as SHA-256."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Mapping

from farm import api
from farm.control.controller import Controller
from farm.errors import Refused
from farm.model import Key
from farm.state import events as ev

_ID_LETTERS = "abcdefghijkmnpqrstuvwxyz23456789"  # without l, o, 0 and 1, which look alike
_KEY = re.compile(r"farm_([a-z0-9]{8})_[A-Za-z0-9_-]{43}")
_SECRET_BYTES = 32
_ID_LENGTH = 8
_DAY_S = 86400.0


def make_key_text() -> tuple[str, str]:
    """Make the text of a new key with 256 random bits.

    Returns
    -------
    id, text
        The public part, by which people name the key, and the whole text, which is shown once.
    """
    name = "".join(secrets.choice(_ID_LETTERS) for _ in range(_ID_LENGTH))
    return name, f"farm_{name}_{secrets.token_urlsafe(_SECRET_BYTES)}"


def digest_key(text: str) -> str:
    """Return the SHA-256 of a key's text. Its 256 random bits need no slow hash."""
    return hashlib.sha256(text.encode()).hexdigest()


def find_key(text: str, keys: Mapping[str, Key], now_s: float) -> Key | None:
    """Find the valid key with a text.

    Parameters
    ----------
    text
        The text that a caller sent.
    keys
        All keys by their ids.
    now_s
        The time on the farm's clock.

    Returns
    -------
    Key or None
        None if the text is no key, or an unknown, expired or revoked one.
    """
    match = _KEY.fullmatch(text)
    key = keys.get(match[1]) if match else None
    if key is None or not hmac.compare_digest(key.digest, digest_key(text)) or not key.is_valid(now_s):
        return None
    return key


class KeyCommands:
    """Commands of operators about keys."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def add(self, request: api.KeyRequest, by: str) -> api.NewKey:
        """Add a key; its text is in the answer and nowhere else.

        Raises
        ------
        Refused
            If a valid key has the same name.
        """
        now_s = self._controller.clock.now()
        same = [
            k for k in self._controller.books.keys.values() if k.name == request.name and k.is_valid(now_s)
        ]
        if same:
            raise Refused(
                f"there is a key named {request.name}: choose another name, or `farm key revoke {same[0].id}`"
            )
        name, text = make_key_text()
        key = Key(
            id=name,
            name=request.name,
            role=request.role,
            digest=digest_key(text),
            created_s=now_s,
            by=by,
            expires_s=None if request.days is None else now_s + request.days * _DAY_S,
        )
        self._controller.handle(ev.KeyAdded(at_s=now_s, key=key))
        return api.NewKey(id=name, text=text, role=key.role)

    def revoke(self, name: str, by: str) -> None:
        """Revoke a key at once. Raises NoSuchThing for an unknown key, Refused for a revoked one."""
        if self._controller.books.key(name).revoked_s is not None:
            raise Refused(f"the key {name} is revoked already")
        self._controller.handle(ev.KeyRevoked(at_s=self._controller.clock.now(), key=name, by=by))
