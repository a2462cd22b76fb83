"""Users of pages, and notes: messages about a user's last action, each of which is shown once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from farm.model import Role
from farm.web.callers import KeyHolder

_MAX_USERS = 1000


@dataclass(frozen=True, slots=True)
class User:
    """User of a page.

    Attributes
    ----------
    name, role
        Name of the user or key, and its role.
    has_session
        True if the user has a session, and so can log out; False for the holder of a key.
    """

    name: str
    role: Role
    has_session: bool = True

    @classmethod
    def for_holder(cls, holder: KeyHolder) -> User:
        """Return the user for the holder of a key or a session."""
        return cls(holder.name, holder.role, holder.has_session)

    def has_role(self, role: str) -> bool:
        """Return whether the user has the rights of a role."""
        return self.role.allows(Role(role))


@dataclass(frozen=True, slots=True)
class Note:
    """Message about a user's last action, shown once at the top of a page."""

    text: str
    is_problem: bool = False


class Notes:
    """Last note of each user, kept until a page shows it."""

    def __init__(self) -> None:
        self._notes: dict[str, Note] = {}

    def put(self, user_id: str, note: Note) -> None:
        """Store the note of a user; `user_id` is the id of the user's key or session."""
        self._notes.pop(user_id, None)
        self._notes[user_id] = note
        if len(self._notes) > _MAX_USERS:
            del self._notes[next(iter(self._notes))]

    @contextmanager
    def show(self, user_id: str) -> Iterator[Note | None]:
        """Yield the note of a user, or None. Delete the note, unless the page with it cannot be rendered."""
        note = self._notes.pop(user_id, None)
        try:
            yield note
        except BaseException:
            if note is not None:
                self._notes.setdefault(user_id, note)
            raise
