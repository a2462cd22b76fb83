"""Keys and sessions: added, extended, expired, revoked."""

import pytest

from books.make_books import apply_events, make_fleet_events, make_key
from farm.errors import NotFoundError
from farm.model import KeyKind, Role
from farm.state import events as ev
from farm.state.books import Books
from farm.state.transitions import apply


def add_key(**fields):
    return apply_events(Books(), *make_fleet_events(), ev.KeyAdded(at_s=0.0, key=make_key(**fields)))[0]


def test_key_is_valid_until_it_expires_or_is_revoked():
    books = add_key(expires_s=100.0)
    assert books.get_key("abcd2345").is_valid(99.0)
    assert not books.get_key("abcd2345").is_valid(100.0)
    books, _ = apply_events(books, ev.KeyRevoked(at_s=50.0, key="abcd2345", by="ann"))
    assert not books.get_key("abcd2345").is_valid(51.0)
    with pytest.raises(NotFoundError, match="there is no key zz"):
        apply(ev.KeyRevoked(at_s=50.0, key="zz", by="ann"), books)


def test_restored_backup_revokes_all_keys():
    books, _ = apply_events(add_key(), ev.BooksRestored(at_s=50.0, copied_s=10.0))
    assert books.get_key("abcd2345").revoked_s == 50.0


def test_each_role_includes_those_before_it():
    allowed_pairs = {(role, needed_role) for role in Role for needed_role in Role if role.allows(needed_role)}
    viewer, sender, operator = Role
    assert allowed_pairs == {
        (viewer, viewer), (sender, viewer), (sender, sender),
        (operator, viewer), (operator, sender), (operator, operator),
    }  # fmt: skip


def make_session(name, user="ann", at_s=0.0, expires_s=100.0):
    session_key = make_key(user, id=name, kind=KeyKind.SESSION, created_s=at_s, expires_s=expires_s)
    return ev.SessionOpened(at_s=at_s, session=session_key)


def test_extended_session_is_valid_until_its_new_end():
    books, _ = apply_events(
        Books(), make_session("s1"), ev.SessionExtended(at_s=90.0, session="s1", expires_s=190.0)
    )
    assert books.get_key("s1").is_valid(189.0)
    assert not books.get_key("s1").is_valid(190.0)


def test_ended_sessions_of_a_user_leave_the_books_when_the_user_opens_another():
    books, _ = apply_events(
        add_key(name="ann", expires_s=1.0), make_session("s1"), make_session("s2"), make_session("s3", "bob")
    )
    books, _ = apply_events(
        books, ev.KeyRevoked(at_s=50.0, key="s1", by="ann"), make_session("s4", at_s=60.0)
    )
    assert set(books.keys) == {"abcd2345", "s2", "s3", "s4"}  # only ended sessions of this user are removed
    books, _ = apply_events(books, make_session("s5", at_s=150.0, expires_s=300.0))
    assert set(books.keys) == {"abcd2345", "s3", "s5"}


def test_restored_backup_ends_every_session():
    books, _ = apply_events(
        Books(), *make_fleet_events(), make_session("s1"), ev.BooksRestored(at_s=50.0, copied_s=10.0)
    )
    assert books.get_key("s1").revoked_s == 50.0
