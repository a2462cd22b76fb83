"""Sessions of browsers: links, extension, limits, end."""

import json

import pytest

from books.make_books import make_key
from books.recording_controller import Farm
from farm.control import SessionCommands, find_key
from farm.control.access.sessions import (
    LINK_LIFETIME_S,
    MAX_IDLE_S,
    MAX_SESSION_S,
    MAX_SESSIONS,
    list_open_sessions,
)
from farm.errors import NotFoundError
from farm.model import KeyKind, Role
from farm.state import events as ev
from hosts.manual_clock import ManualClock

HOUR_S = 3600.0


@pytest.fixture(params=[1.0, 100.0])
def farm(tmp_path, request):
    clock = ManualClock(scale=request.param)
    farm = Farm(tmp_path, clock=clock)
    farm.clock, farm.sessions = clock, SessionCommands(farm.controller)

    def open_session(user="ann", role=Role.PRINT):
        return farm.sessions.open(farm.sessions.make_link(user, role))

    def find_session(text):
        return find_key(text, farm.controller.books.keys, clock.now_s, KeyKind.SESSION)

    def wait(wall_s):
        clock.now_s += wall_s * clock.scale

    farm.open_session, farm.find_session, farm.wait = open_session, find_session, wait
    yield farm
    farm.store.close()


def list_events(farm, kind):
    return [json.loads(body) for _, name, body in farm.store.read_all_events() if name == kind]


def test_link_opens_one_session_of_its_user(farm):
    token = farm.sessions.make_link("ann", Role.OPERATE)
    assert farm.sessions.find_link(token).user == "ann"
    session = farm.find_session(farm.sessions.open(token))
    assert (session.name, session.role, session.by) == ("ann", Role.OPERATE, "ann")
    for method in (farm.sessions.find_link, farm.sessions.open):
        with pytest.raises(NotFoundError, match="`farm web`"):
            method(token)
    assert len(list_events(farm, "SessionOpened")) == 1


def test_link_expires_after_five_minutes(farm):
    token = farm.sessions.make_link("ann", Role.PRINT)
    farm.wait(LINK_LIFETIME_S - 1.0)
    farm.sessions.find_link(token)
    farm.wait(1.0)
    with pytest.raises(NotFoundError, match="has expired"):
        farm.sessions.open(token)
    assert list_events(farm, "SessionOpened") == []


def test_additional_link_replaces_the_oldest_of_its_user(farm):
    other_link = farm.sessions.make_link("bob", Role.PRINT)
    tokens = [farm.sessions.make_link("ann", Role.PRINT) for _ in range(50)]
    assert len(farm.sessions._links) == 6
    farm.sessions.find_link(other_link)
    farm.sessions.find_link(tokens[-1])
    for number in range(500):
        farm.sessions.make_link(f"user {number}", Role.PRINT)
    assert len(farm.sessions._links) == 100


def test_texts_of_links_and_sessions_are_not_stored(farm, tmp_path):
    token = farm.sessions.make_link("ann", Role.PRINT)
    text = farm.sessions.open(token)
    for secret in (token, text.split("_", 2)[2]):
        assert not any(secret.encode() in path.read_bytes() for path in tmp_path.rglob("*") if path.is_file())


def test_session_ends_twelve_hours_after_its_last_use_and_after_thirty_days(farm):
    text = farm.open_session()
    farm.wait(MAX_IDLE_S - 1.0)
    farm.sessions.extend(farm.find_session(text))
    used_s = 0.0
    while farm.find_session(text) is not None:
        farm.sessions.extend(farm.find_session(text))
        farm.wait(11 * HOUR_S)
        used_s += 11 * HOUR_S
    assert abs(used_s + MAX_IDLE_S - MAX_SESSION_S) < 12 * HOUR_S
    unused_session = farm.open_session()
    farm.wait(MAX_IDLE_S - 1.0)
    assert farm.find_session(unused_session) is not None
    farm.wait(1.0)
    assert farm.find_session(unused_session) is None


def test_session_in_constant_use_is_extended_once_an_hour(farm):
    text = farm.open_session()
    for _ in range(10 * 60):
        farm.wait(60.0)
        farm.sessions.extend(farm.find_session(text))
    assert len(list_events(farm, "SessionExtended")) == 10


def test_additional_session_ends_the_oldest_of_its_user(farm):
    other_session = farm.open_session("bob")
    texts = [farm.open_session() for _ in range(MAX_SESSIONS + 3) if farm.wait(1.0) is None]
    results = [farm.find_session(text) is not None for text in texts]
    assert results == [False] * 3 + [True] * MAX_SESSIONS
    assert farm.find_session(other_session) is not None
    assert len(farm.controller.books.keys) <= MAX_SESSIONS + 2


def test_ended_sessions_are_removed_from_the_books(farm):
    for _ in range(50):
        session = farm.find_session(farm.open_session())
        farm.wait(1.0)
        assert session is not None
        farm.sessions.end_all_sessions("ann")
    assert len(farm.controller.books.keys) == 1
    assert len(farm.store.load().keys) == 1


def test_end_of_all_sessions_also_voids_links(farm):
    texts = [farm.open_session(user) for user in ("ann", "bob")]
    token = farm.sessions.make_link("eve", Role.PRINT)
    assert farm.sessions.end_all_sessions("ann").ended == 2
    assert [farm.find_session(text) for text in texts] == [None, None]
    assert {event["by"] for event in list_events(farm, "KeyRevoked")} == {"ann"}
    with pytest.raises(NotFoundError):
        farm.sessions.open(token)


def test_restarted_daemon_keeps_sessions_and_forgets_links(farm, tmp_path):
    text, token = farm.open_session(), farm.sessions.make_link("ann", Role.PRINT)
    farm.store.close()
    restarted_farm = Farm(tmp_path, clock=farm.clock)
    assert (
        find_key(text, restarted_farm.controller.books.keys, farm.clock.now_s, KeyKind.SESSION).name == "ann"
    )
    assert len(list_open_sessions(restarted_farm.controller.books.keys.values(), farm.clock.now_s)) == 1
    with pytest.raises(NotFoundError):
        SessionCommands(restarted_farm.controller).open(token)
    restarted_farm.store.close()


def test_user_and_key_of_the_same_name_have_separate_sessions(farm):
    panel = make_key("ann", id="panel234", expires_s=None)
    farm.controller.handle(ev.KeyAdded(at_s=farm.clock.now_s, key=panel))
    text = farm.open_session("ann")
    for _ in range(MAX_SESSIONS + 3):
        farm.wait(1.0)
        key_session = farm.find_session(farm.sessions.open_with_key(panel))
    assert (key_session.caller, key_session.user, key_session.by) == ("key ann", None, "key ann")
    assert farm.find_session(text).caller == "ann"
    sessions = list_open_sessions(farm.controller.books.keys.values(), farm.clock.now_s, "key ann")
    assert len(sessions) == MAX_SESSIONS
