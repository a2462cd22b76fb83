"""Rules for events about keys and sessions. Pure."""

from __future__ import annotations

from farm.model import KeyKind
from farm.state import events as ev
from farm.state.books import Books, put, remove_keys, replace_fields
from farm.state.consequences import Result
from farm.state.transitions.rules import change


@change.register
def _(event: ev.KeyAdded, books: Books) -> Result:
    return put(books, event.key), ()


@change.register
def _(event: ev.KeyRevoked, books: Books) -> Result:
    """Revoke a key, and the sessions that it opened."""
    revoked_keys = [books.get_key(event.key)]
    revoked_keys += [
        key for key in books.keys.values() if key.opened_by == event.key and key.revoked_s is None
    ]
    return put(books, *(replace_fields(key, revoked_s=event.at_s) for key in revoked_keys)), ()


@change.register
def _(event: ev.SessionOpened, books: Books) -> Result:
    """Add a session, and remove the ended sessions of its caller."""
    ended_sessions = [
        key.id
        for key in books.keys.values()
        if key.kind is KeyKind.SESSION and key.caller == event.session.caller and not key.is_valid(event.at_s)
    ]
    return put(remove_keys(books, ended_sessions), event.session), ()


@change.register
def _(event: ev.SessionExtended, books: Books) -> Result:
    return put(books, replace_fields(books.get_key(event.session), expires_s=event.expires_s)), ()
