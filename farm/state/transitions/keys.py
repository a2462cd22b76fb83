"""Rules for events about keys. Pure."""

from __future__ import annotations

from farm.state import events as ev
from farm.state.books import Books, put, replace_fields
from farm.state.consequences import Result
from farm.state.transitions.rules import change


@change.register
def _(event: ev.KeyAdded, books: Books) -> Result:
    return put(books, event.key), ()


@change.register
def _(event: ev.KeyRevoked, books: Books) -> Result:
    return put(books, replace_fields(books.key(event.key), revoked_s=event.at_s)), ()
