"""Commands that add and revoke keys of callers on the network. Only the SHA-256 of a key's text is stored.

A session is the key of a browser (`farm.control.access.sessions`). Its text begins with a different word than
the text of a program's key, so that neither is accepted in place of the other.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Mapping

from farm import api
from farm.control.controller import Controller
from farm.errors import RefusedError
from farm.model import Key, KeyKind
from farm.state import events as ev

CODE_CHARACTERS = "abcdefghijkmnpqrstuvwxyz23456789"  # without l, o, 0 and 1, which look alike
_ID_AND_SECRET_PATTERN = r"_([a-z0-9]{8})_[A-Za-z0-9_-]{43}"
_PREFIXES = {KeyKind.KEY: "farm", KeyKind.SESSION: "session"}
_PATTERNS = {kind: re.compile(word + _ID_AND_SECRET_PATTERN) for kind, word in _PREFIXES.items()}
_SECRET_BYTES = 32
_ID_LENGTH = 8
_DAY_S = 86400.0


def make_key_text(kind: KeyKind = KeyKind.KEY) -> tuple[str, str]:
    """Make the id and the text of a new key, with 256 random bits.

    Parameters
    ----------
    kind
        KEY for a program, SESSION for a browser.

    Returns
    -------
    id, text
        The public part, which identifies the key, and the whole text, which is shown only once.
    """
    key_id = "".join(secrets.choice(CODE_CHARACTERS) for _ in range(_ID_LENGTH))
    return key_id, f"{_PREFIXES[kind]}_{key_id}_{secrets.token_urlsafe(_SECRET_BYTES)}"


def digest_key(text: str) -> str:
    """Return the SHA-256 of a key's text; no slow hash is needed, because the text has 256 random bits."""
    return hashlib.sha256(text.encode()).hexdigest()


def find_key(text: str, keys: Mapping[str, Key], now_s: float, kind: KeyKind = KeyKind.KEY) -> Key | None:
    """Find the valid key that has the given text.

    Parameters
    ----------
    text
        The text that a caller sent.
    keys
        All keys by their ids.
    now_s
        Time on the farm's clock.
    kind
        The kind of key that is accepted.

    Returns
    -------
    Key or None
        The key; None if the text is not a key of this kind, or the key is unknown, expired or revoked.
    """
    match = _PATTERNS[kind].fullmatch(text)
    key = keys.get(match[1]) if match else None
    if (
        key is None
        or key.kind is not kind
        or not hmac.compare_digest(key.digest, digest_key(text))
        or not key.is_valid(now_s)
    ):
        return None
    return key


class KeyCommands:
    """Commands of operators that add and revoke keys."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def add(self, request: api.KeyRequest, caller_name: str) -> api.NewKey:
        """Add a key, and return it with its text, which is not stored.

        Raises
        ------
        RefusedError
            If a valid key has the same name.
        """
        now_s = self._controller.clock.now()
        keys_with_name = [
            key
            for key in self._controller.books.keys.values()
            if key.kind is KeyKind.KEY and key.name == request.name and key.is_valid(now_s)
        ]
        if keys_with_name:
            raise RefusedError(
                f"there is a key named {request.name}: choose another name, or "
                f"`farm key revoke {keys_with_name[0].id}`"
            )
        key_id, text = make_key_text()
        key = Key(
            id=key_id,
            name=request.name,
            role=request.role,
            digest=digest_key(text),
            created_s=now_s,
            by=caller_name,
            expires_s=None if request.days is None else now_s + request.days * _DAY_S,
        )
        self._controller.handle(ev.KeyAdded(at_s=now_s, key=key))
        return api.NewKey(id=key_id, text=text, role=key.role)

    def revoke(self, key_id: str, caller_name: str) -> None:
        """Revoke a key, or end a session, immediately.

        Raises
        ------
        NotFoundError
            If the key is unknown.
        RefusedError
            If the key is already revoked.
        """
        if self._controller.books.get_key(key_id).revoked_s is not None:
            raise RefusedError(f"the key {key_id} is already revoked")
        self._controller.handle(ev.KeyRevoked(at_s=self._controller.clock.now(), key=key_id, by=caller_name))
