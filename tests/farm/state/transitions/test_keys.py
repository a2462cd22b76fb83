"""Keys: added, expired, revoked."""

import pytest

from farm.errors import NoSuchThing
from farm.model import Role
from farm.state import events as ev
from farm.state.books import Books
from farm.state.transitions import apply
from make_books import fleet, key, run


def added(**fields):
    return run(Books(), *fleet(), ev.KeyAdded(at_s=0.0, key=key(**fields)))[0]


def test_a_key_is_valid_until_it_expires_or_is_revoked():
    books = added(expires_s=100.0)
    assert books.key("abcd2345").is_valid(99.0)
    assert not books.key("abcd2345").is_valid(100.0)
    books, _ = run(books, ev.KeyRevoked(at_s=50.0, key="abcd2345", by="ann"))
    assert not books.key("abcd2345").is_valid(51.0)
    with pytest.raises(NoSuchThing, match="there is no key zz"):
        apply(ev.KeyRevoked(at_s=50.0, key="zz", by="ann"), books)


def test_a_restored_backup_accepts_no_key_that_may_have_been_revoked_since():
    books, _ = run(added(), ev.BooksRestored(at_s=50.0, copied_s=10.0))
    assert books.key("abcd2345").revoked_s == 50.0


def test_each_role_includes_those_before_it():
    allowed = {(role, needed) for role in Role for needed in Role if role.allows(needed)}
    look, send, operate = Role
    assert allowed == {
        (look, look), (send, look), (send, send), (operate, look), (operate, send), (operate, operate)
    }  # fmt: skip
