"""Lifecycle of an entity as a table of transitions, and the error for an event that violates it. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

from farm.errors import ErrorCode, FarmError
from farm.model import JobState, PrintState
from farm.state import events as ev
from farm.state.books import Books
from farm.state.plate_state import PlateState


class PrinterState(StrEnum):
    """Recorded state of a printer: PRINTING while it has an open print, otherwise the state of its bed."""

    PRINTING = "printing"
    CLEAR = "clear"
    NOT_CLEAR = "not_clear"
    UNKNOWN = "unknown"


State = JobState | PlateState | PrintState | PrinterState
EventKind = type[ev.Event]
NO_STATE = None
"""State of an entity that does not exist yet."""


@dataclass(frozen=True, slots=True)
class Transition:
    """Row of a lifecycle's table: an event, and the states that it connects.

    Attributes
    ----------
    event_kind
        Class of the event.
    start_states
        States in which the event can happen; NO_STATE if the event creates the entity.
    end_states
        States to which the event can lead; None if the state stays the same.
    """

    event_kind: EventKind
    start_states: frozenset[State | None]
    end_states: frozenset[State] | None

    def allows(self, start: State | None, end: State | None) -> bool:
        """Return whether the row leads from one state to another."""
        return start in self.start_states and (
            end == start if self.end_states is None else end in self.end_states
        )


@dataclass(frozen=True, slots=True)
class Lifecycle:
    """Lifecycle of one kind of entity.

    Attributes
    ----------
    entity_name
        Name of the kind: job, plate, print or printer.
    key_field
        Field of an event that contains the id of the entity.
    states
        All states of the entity.
    transitions
        Rows of the events about the entity itself; an event that no row allows is an error.
    consequences
        Rows of the events about another entity that change the state of this entity.
    find_state
        Function that returns the state of an entity; NO_STATE if the books do not contain it.
    """

    entity_name: str
    key_field: str
    states: type[StrEnum]
    transitions: tuple[Transition, ...]
    consequences: tuple[Transition, ...]
    find_state: Callable[[Books, object], State | None]

    @property
    def event_kinds(self) -> frozenset[EventKind]:
        """Kinds of events about the entity itself."""
        return frozenset(row.event_kind for row in self.transitions)

    def allows(self, kind: EventKind, start: State | None, end: State | None) -> bool:
        """Return whether an event about the entity leads from one state to the other."""
        return any(row.event_kind is kind and row.allows(start, end) for row in self.transitions)

    def find_start_states(self, kind: EventKind) -> frozenset[State | None]:
        """Return the states in which an event about the entity can happen."""
        return frozenset().union(*(row.start_states for row in self.transitions if row.event_kind is kind))


class InvalidTransition(FarmError):
    """Error for an event that is not allowed in the state of its entity.

    Attributes
    ----------
    lifecycle, key
        Lifecycle and id of the entity; None if the event is about the farm itself.
    start
        State of the entity before the event.
    event
        The rejected event.
    history
        Texts of the last events about the entity, oldest first; empty unless the store has added them.
    """

    code = ErrorCode.REFUSED

    def __init__(
        self,
        event: ev.Event,
        lifecycle: Lifecycle | None,
        key: object,
        start: State | None,
        reason: str | None = None,
        history: Iterable[str] = (),
    ) -> None:
        self.event, self.lifecycle, self.key, self.start = event, lifecycle, key, start
        self.history, self.reason = tuple(history), reason
        entity = "the farm" if lifecycle is None else f"{lifecycle.entity_name} {key}"
        state = reason or ("not in the books" if start is None else f"{start}")
        message = f"{type(event).__name__} is not allowed: {entity} is {state}"
        if self.history:
            message += f"; before that: {', '.join(self.history)}"
        super().__init__(message)

    def with_history(self, history: Iterable[str]) -> InvalidTransition:
        """Return the same error with the entity's last events."""
        return InvalidTransition(self.event, self.lifecycle, self.key, self.start, self.reason, history)
