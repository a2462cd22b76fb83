"""Checks of requests: their host, their origin, and wrong keys."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farm.web.request_checks import (
    MAX_WRONG_KEYS,
    WRONG_KEY_WAIT_S,
    Refusal,
    WrongKeys,
    check_host,
    check_origin,
    check_session_origin,
)

NAMES = {"farm.lab.example", "pc-b"}


@pytest.mark.parametrize(
    "host",
    ["localhost:8467", "127.0.0.1", "[::1]:8467", "10.0.0.7:80", "FARM.lab.example:8467", "pc-b", "pc-b."],
)
def test_addresses_and_names_of_this_host_are_accepted(host):
    assert check_host(host, NAMES) is None


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("evil.example", 421),
        ("farm.lab.example.evil.example", 421),
        ("127.0.0.1.evil.example", 421),
        ("pc-b@evil.example", 400),
        ("pc-b/", 400),
        ("pc-b:80:80", 400),
        ("", 400),
        (None, 400),
    ],
)
def test_other_names_are_refused(host, status):
    assert check_host(host, NAMES).status == status


@given(st.text())
def test_any_host_is_accepted_or_refused(host):
    assert check_host(host, NAMES) is None or isinstance(check_host(host, NAMES), Refusal)


@pytest.mark.parametrize(
    ("method", "origin", "site", "is_allowed"),
    [
        ("POST", None, None, True),  # a program
        ("POST", "http://pc-b:8467", None, True),  # a browser on a plain-HTTP name sends no Sec-Fetch-Site
        ("POST", "https://pc-b:8467", "same-origin", True),
        ("POST", "http://evil.example", None, False),
        ("POST", "http://pc-b:8467.evil.example", None, False),
        ("POST", "http://pc-b", None, False),
        ("POST", "null", None, False),
        ("POST", "http://pc-b:8467", "cross-site", False),
        ("POST", None, "same-site", False),
        ("DELETE", "http://evil.example", None, False),
        ("GET", "http://evil.example", "cross-site", True),  # changes nothing, and shows nothing without CORS
    ],
)
def test_change_from_another_site_is_refused(method, origin, site, is_allowed):
    assert (check_origin(method, "pc-b:8467", origin, site) is None) is is_allowed


def test_address_with_ten_wrong_keys_waits_for_a_minute():
    wrong_keys = WrongKeys()
    for number in range(MAX_WRONG_KEYS):
        assert wrong_keys.check("10.0.0.9", number) is None
        wrong_keys.add("10.0.0.9", number)
    last_s = MAX_WRONG_KEYS - 1
    assert wrong_keys.check("10.0.0.9", last_s + WRONG_KEY_WAIT_S - 0.1).status == 429
    assert wrong_keys.check("10.0.0.8", last_s) is None
    assert wrong_keys.check("10.0.0.9", last_s + WRONG_KEY_WAIT_S) is None
    wrong_keys.add("10.0.0.9", last_s + WRONG_KEY_WAIT_S)
    assert wrong_keys.check("10.0.0.9", last_s + WRONG_KEY_WAIT_S) is None


def test_number_of_counted_addresses_is_limited():
    wrong_keys = WrongKeys()
    for number in range(5000):
        wrong_keys.add(f"address {number}", 0.0)
    assert len(wrong_keys._counts) == 1000


@pytest.mark.parametrize(
    ("method", "origin", "site", "is_allowed"),
    [
        ("GET", None, None, True),
        ("POST", "http://pc-b:8467", None, True),
        ("POST", None, "same-origin", True),
        ("POST", None, None, False),
        ("DELETE", None, None, False),
    ],
)
def test_change_in_a_session_without_its_origin_is_refused(method, origin, site, is_allowed):
    assert (check_session_origin(method, origin, site) is None) is is_allowed
