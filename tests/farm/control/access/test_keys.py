"""Texts of keys: generation, and the search for the key of a text."""

import re
from itertools import permutations

from hypothesis import given
from hypothesis import strategies as st

from books.make_books import make_key
from farm.control.access.keys import digest_key, find_key, make_key_text
from farm.model import KeyKind


def test_new_key_is_found_by_its_text_which_is_not_stored():
    name, text = make_key_text()
    assert re.fullmatch(rf"farm_{name}_[\w-]{{43}}", text)
    stored_key = make_key(id=name, digest=digest_key(text), expires_s=100.0)
    keys = {name: stored_key}
    assert find_key(text, keys, 99.0) is stored_key
    assert text.split("_", 2)[2] not in stored_key.model_dump_json()
    assert find_key(text, keys, 100.0) is None
    assert find_key(text, {name: stored_key.model_copy(update={"revoked_s": 1.0})}, 2.0) is None
    changed_text = text[:-1] + ("A" if text[-1] != "A" else "B")
    assert find_key(changed_text, keys, 1.0) is None
    assert find_key(make_key_text()[1], keys, 1.0) is None


@given(st.text())
def test_unknown_text_is_not_accepted_as_key(text):
    name, secret = make_key_text()
    assert find_key(text, {name: make_key(id=name, digest=digest_key(secret))}, 1.0) is None


def test_session_and_key_are_not_accepted_in_place_of_each_other():
    for kind, other_kind in permutations(KeyKind):
        name, text = make_key_text(kind)
        keys = {name: make_key(id=name, kind=kind, digest=digest_key(text))}
        assert find_key(text, keys, 1.0, kind) is keys[name]
        assert find_key(text, keys, 1.0, other_kind) is None
        wrong_keys = {name: keys[name].model_copy(update={"kind": other_kind})}
        assert find_key(text, wrong_keys, 1.0, kind) is None
