"""Rules for events about the farm as a whole. Pure."""

from __future__ import annotations

from farm.state import events as ev
from farm.state.books import Books, edited, put
from farm.state.consequences import Result, shift_print_times
from farm.state.lifecycles import InvalidTransition
from farm.state.recovery import restore
from farm.state.transitions.rules import change


@change.register
def _(event: ev.ClockSet, books: Books) -> Result:
    return shift_print_times(books, event.by_s), ()


@change.register
def _(event: ev.BooksRestored, books: Books) -> Result:
    return restore.restore_books(event, books), ()


@change.register
def _(event: ev.OutageConfirmed, books: Books) -> Result:
    if books.outage is None:
        raise InvalidTransition(event, None, None, None, "in no outage")
    return put(books, edited(books.outage, confirmed_s=event.at_s)), ()
