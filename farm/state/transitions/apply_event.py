"""Application of an event to the books, if the tables of the lifecycles allow it. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from farm.errors import NotFoundError
from farm.state import events as ev
from farm.state.books import Books
from farm.state.consequences import Result
from farm.state.lifecycles import LIFECYCLES, NO_STATE, PRINTER_LIFECYCLE, InvalidTransition, Lifecycle, State
from farm.state.transitions.rules import change


def apply(event: ev.Event, books: Books) -> Result:
    """Apply an event to the books.

    Parameters
    ----------
    event
        The event.
    books
        The books before the event; they are not changed.

    Returns
    -------
    books, instructions
        The books after the event, and the resulting instructions.

    Raises
    ------
    NotFoundError
        If the event names an unknown entity.
    InvalidTransition
        If the event is not allowed in the present state of an entity that it concerns.
    """
    subjects = list(find_subjects(event, books))
    changed_books, instructions = change(event, books)
    for subject in subjects:
        end = subject.lifecycle.find_state(changed_books, subject.key)
        if not subject.lifecycle.allows(type(event), subject.start, end):
            reason = f"{subject.start}, and would be {end}"
            raise InvalidTransition(event, subject.lifecycle, subject.key, subject.start, reason)
    return changed_books, instructions


@dataclass(frozen=True, slots=True)
class Subject:
    """Entity that an event concerns, with its state before the event."""

    lifecycle: Lifecycle
    key: object
    start: State | None


def find_subjects(event: ev.Event, books: Books) -> Iterator[Subject]:
    """Yield the entities that an event concerns.

    Raises
    ------
    NotFoundError
        If the event names an unknown entity, and does not create it.
    InvalidTransition
        If the event is not allowed in the present state of one of these entities.
    """
    kind = type(event)
    for lifecycle in LIFECYCLES:
        if kind not in lifecycle.event_kinds:
            continue
        key: object = getattr(event, lifecycle.key_field)
        if isinstance(event, ev.JobSubmitted):
            key = event.job.id
        start = lifecycle.find_state(books, key)
        start_states = lifecycle.find_start_states(kind)
        if start is NO_STATE and NO_STATE not in start_states:
            _raise_not_found(lifecycle, key, books)
        if start not in start_states:
            raise InvalidTransition(event, lifecycle, key, start)
        yield Subject(lifecycle, key, start)


def _raise_not_found(lifecycle: Lifecycle, key: object, books: Books) -> None:
    if isinstance(key, int):
        books.get_job(key)
    if lifecycle is PRINTER_LIFECYCLE:
        books.get_printer(str(key))
    raise NotFoundError(f"there is no {lifecycle.entity_name} {key}")


def list_undeclared_changes(event: ev.Event, old_books: Books, new_books: Books) -> list[str]:
    """List the state changes by an event that are in no table; tests require that there are none."""
    violations = []
    kind = type(event)
    for lifecycle in LIFECYCLES:
        rows = [row for row in (*lifecycle.transitions, *lifecycle.consequences) if row.event_kind is kind]
        for key in getattr(new_books, f"{lifecycle.entity_name}s"):
            start, end = lifecycle.find_state(old_books, key), lifecycle.find_state(new_books, key)
            if start != end and not any(row.allows(start, end) for row in rows):
                violations.append(f"{kind.__name__}: {lifecycle.entity_name} {key} from {start} to {end}")
    return violations
