"""Application of one event to the books. Pure."""

from __future__ import annotations

from farm.state import events as ev
from farm.state.books import Books
from farm.state.consequences import Result
from farm.state.lifecycles import InvalidTransition, find_subjects
from farm.state.transitions.rules import change


def apply(event: ev.Event, books: Books) -> Result:
    """Apply an event to the books.

    Parameters
    ----------
    event
        What has happened.
    books
        The books before it; they are not changed.

    Returns
    -------
    books, instructions
        The books after it, and what is to be done then.

    Raises
    ------
    NoSuchThing
        Where the event names something that the books do not have.
    InvalidTransition
        Where it does not fit the state of what it is about. It leaves no trace.
    """
    subjects = list(find_subjects(event, books))
    after, instructions = change(event, books)
    for subject in subjects:
        end = subject.lifecycle.find_state(after, subject.key)
        if not subject.lifecycle.allows(type(event), subject.start, end):
            reason = f"{subject.start}, and would be {end}"
            raise InvalidTransition(event, subject.lifecycle, subject.key, subject.start, reason)
    return after, instructions
