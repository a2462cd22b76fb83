"""Registry of the rules: one function for each kind of event. Pure."""

from __future__ import annotations

from functools import singledispatch

from farm.state import events as ev
from farm.state.books import Books
from farm.state.consequences import Result


@singledispatch
def change(event: ev.Event, books: Books) -> Result:
    """Apply an event that is allowed in the current state of the books."""
    raise TypeError(f"no rule for {type(event).__name__}")
