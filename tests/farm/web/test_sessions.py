"""Sessions in a browser: link, cookie, pages, and names in the event log."""

import asyncio
import grp
import json
import os

import httpx
import pytest
from fastapi import Response

from browser.http_caller import DAEMON_USER, call_as
from farm.http import Person
from farm.model import Role
from farm.state.storage import StoreError
from farm.web.cookies import SessionCookie
from farm.web.pages.static_files import make_static_url
from farms.network_farm import HOST, SAME_ORIGIN_HEADERS, NetworkFarm

TLS = {"tls": {"cert": "c.pem", "key": "k.pem"}}
CLEARED_PATH = "/api/v1/printers/a/cleared"


@pytest.fixture
def farm(tmp_path):
    farm = NetworkFarm(tmp_path)
    yield farm
    farm.store.close()


def list_sessions(farm):
    return [key for key in farm.controller.books.keys.values() if key.kind == "session"]


def read_cookie(response):
    """Return the value of the cookie that a response sets, and its attributes."""
    pair, *attributes = response.headers["set-cookie"].split("; ")
    return pair.partition("=")[2], {attribute.lower() for attribute in attributes}


def test_link_logs_in_only_by_its_button_and_only_once(farm):
    link = f"/login/{farm.sessions.make_link('ann', Role.PRINT)}"
    for _ in range(3):  # as the link preview of a chat program does
        page = farm.ask("GET", link)
        assert page.status_code == 200
        assert "Log in as ann" in page.text
        assert "set-cookie" not in page.headers
    assert list_sessions(farm) == []
    log_in_response = farm.browse("POST", link)
    assert (log_in_response.status_code, log_in_response.headers["location"]) == (303, "/")
    text, attributes = read_cookie(log_in_response)
    assert {"httponly", "samesite=lax", "path=/"} <= attributes
    assert "secure" not in attributes
    assert farm.browse("GET", "/", text).status_code == 200
    for method in ("GET", "POST"):
        response = farm.browse(method, link)
        assert response.status_code == 404
        assert "was used or has expired" in response.text
        assert "set-cookie" not in response.headers
    assert len(list_sessions(farm)) == 1


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"sec-fetch-site": "cross-site", **SAME_ORIGIN_HEADERS},
        {"sec-fetch-site": "same-site"},
        {"origin": "null"},
        {},
    ],
)
def test_page_of_another_site_opens_no_session(farm, headers):
    link = f"/login/{farm.sessions.make_link('eve', Role.PRINT)}"
    assert farm.ask("POST", link, headers=headers).status_code == 403
    assert list_sessions(farm) == []


@pytest.mark.parametrize("web", [TLS, {"url": "https://farm.lab.example"}])
def test_cookie_over_https_is_secure_and_only_for_this_host(tmp_path, web):
    farm = NetworkFarm(tmp_path, web)
    link = f"/login/{farm.sessions.make_link('ann', Role.PRINT)}"
    log_in_response = farm.browse("POST", link)
    assert log_in_response.headers["set-cookie"].startswith("__Host-farm-8467=session_")
    text, attributes = read_cookie(log_in_response)
    assert {"secure", "path=/"} <= attributes
    assert not any(attribute.startswith("domain") for attribute in attributes)
    assert farm.browse("GET", "/", text).status_code == 200
    headers_without_prefix = {"cookie": f"farm-8467={text}"}
    assert farm.ask("GET", "/", headers=headers_without_prefix).status_code == 401
    farm.store.close()


def test_two_farms_on_a_host_have_different_cookies():
    assert SessionCookie(8467, False).name != SessionCookie(8468, False).name


def test_logging_out_ends_the_session_and_forgets_the_cookie(farm):
    text = farm.open_session()
    response = farm.browse("POST", "/logout", text)
    assert (response.status_code, read_cookie(response)[0]) == (200, '""')
    assert "max-age=0" in read_cookie(response)[1]
    kind, body = farm.read_last_event()
    assert (kind, json.loads(body)["by"]) == ("KeyRevoked", "ann")
    response = farm.browse("GET", "/", text)
    assert response.status_code == 401
    assert "farm web" in response.text
    assert "max-age=0" in read_cookie(response)[1]
    key = farm.add_key(Role.LOOK).text
    assert farm.ask("POST", "/logout", key).status_code == 409
    assert farm.ask("GET", "/", key).status_code == 200


@pytest.mark.parametrize("role", Role)
def test_page_shows_tasks_printers_jobs_and_user(tmp_path, role):
    farm = NetworkFarm(tmp_path, fleet={"name": "lab"})
    key = farm.add_key(Role.PRINT, "laptop").text
    params = {"request_id": "r" * 8, "name": "<i>box.stl", "size": 100}
    farm.ask("POST", "/api/v1/jobs", key, params=params, content=b"x" * 100)
    page = farm.browse("GET", "/", farm.open_session(role))
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    for text in (
        "<title>Home – lab</title>",
        f"ann ({role})",
        '<li class="card tile" id="printer-a">',
        "key laptop",
        "Log out",
    ):
        assert text in page.text
    assert "&lt;i&gt;box.stl" in page.text
    assert "<i>box" not in page.text
    assert "<script>" not in page.text
    assert "style=" not in page.text
    policy = page.headers["content-security-policy"]
    for rule in (
        "default-src 'none'",
        "style-src 'self'",
        "script-src 'self'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    ):
        assert rule in policy
    farm.store.close()


def test_static_files_need_no_session_and_are_cached_by_their_version(farm):
    style = farm.ask("GET", "/static/farm.css")
    assert style.headers["content-type"].startswith("text/css")
    assert style.headers["content-encoding"] == "gzip"
    assert "table" in style.text
    assert style.headers["cache-control"] == "no-store"
    assert "immutable" in farm.ask("GET", make_static_url("farm.css")).headers["cache-control"]
    assert farm.ask("GET", "/static/farm.css", headers={"accept-encoding": "br"}).text == style.text
    for name in ("nothing.css", "..", "%2e%2e%2frouting.py"):
        assert farm.ask("GET", f"/static/{name}").status_code in (401, 404)


def test_browser_without_a_session_gets_a_page_and_a_program_gets_json(farm):
    for status, path, headers in ((401, "/", {}), (421, "/", {"host": "evil.example"}), (401, "/x", {})):
        page = farm.ask("GET", path, headers={"accept": "text/html,*/*"}, **headers)
        assert (page.status_code, page.headers["content-type"]) == (status, "text/html; charset=utf-8")
        assert farm.ask("GET", path, **headers).json()["exit_code"] == 5
    missing_page = farm.browse("GET", "/<i>", farm.open_session())
    assert missing_page.status_code == 404
    assert "/&lt;i&gt;" in missing_page.text


def post_to_socket(farm, person, path):
    """Send a request over the Unix socket as a person."""

    async def send_request():
        transport = httpx.ASGITransport(call_as(person, farm.unix))
        async with httpx.AsyncClient(transport=transport, base_url="http://farm") as client:
            return await client.post(path, json={})

    return asyncio.run(send_request())


def test_event_log_names_every_kind_of_caller(farm):
    farm.browse("POST", CLEARED_PATH, farm.open_session(Role.OPERATE, "ann"), json={})
    farm.ask("POST", CLEARED_PATH, farm.add_key(Role.OPERATE, "panel").text, json={})
    assert post_to_socket(farm, DAEMON_USER, "/printers/a/cleared").status_code == 200
    callers = [
        json.loads(body)["by"] for _, kind, body in farm.store.read_all_events() if kind == "BedCleared"
    ]
    assert callers == ["ann", "key panel", DAEMON_USER.name]


NON_MEMBER = Person(uid=54321, gid=54321)
"""User who is not in the daemon's group."""


@pytest.mark.parametrize(
    ("group", "person", "role"),
    [
        (None, NON_MEMBER, "operate"),
        (grp.getgrgid(os.getgid()).gr_name, NON_MEMBER, "print"),
        (grp.getgrgid(os.getgid()).gr_name, DAEMON_USER, "operate"),
    ],
)
def test_link_is_for_the_user_whom_the_kernel_identifies(tmp_path, group, person, role):
    farm = NetworkFarm(tmp_path, fleet={"operators": group})
    refusal = post_to_socket(farm, person, "/sessions/link")
    assert (refusal.status_code, "write `web: {}` into fleet.yaml" in refusal.text) == (409, True)
    network = farm.services.network
    network.browser_url, network.problem = "https://farm.lab:1", "Address already in use"
    assert "Address already in use" in post_to_socket(farm, person, "/sessions/link").text
    network.problem = None
    link = post_to_socket(farm, person, "/sessions/link").json()
    assert (link["user"], link["role"]) == (person.name, role)
    address, path = link["url"][:18], link["url"][18:]
    assert address == "https://farm.lab:1"
    assert f"Log in as {person.name}" in farm.ask("GET", path).text
    farm.store.close()


def test_only_operators_end_all_sessions(tmp_path):
    farm = NetworkFarm(tmp_path, fleet={"operators": grp.getgrgid(os.getgid()).gr_name})
    text = farm.open_session()
    assert post_to_socket(farm, NON_MEMBER, "/sessions/end").status_code == 409
    assert farm.browse("GET", "/", text).status_code == 200
    assert post_to_socket(farm, DAEMON_USER, "/sessions/end").json()["ended"] == 1
    assert farm.browse("GET", "/", text).status_code == 401
    farm.store.close()


def test_session_in_use_is_extended_and_its_last_use_is_known(farm):
    text = farm.open_session()
    session = list_sessions(farm)[0]
    farm.clock.now_s += 7200.0
    farm.browse("GET", "/", text)
    assert list_sessions(farm)[0].expires_s == session.expires_s + 7200.0
    assert farm.services.key_uses_s[session.id] == farm.clock.now_s


def test_session_is_served_although_its_extension_cannot_be_written(farm, monkeypatch):
    def fail_to_commit(*_):
        raise StoreError("the disk is full")

    text = farm.open_session()
    farm.clock.now_s += 7200.0
    monkeypatch.setattr(farm.store, "commit", fail_to_commit)
    assert farm.browse("GET", "/", text).status_code == 200


def test_ten_wrong_sessions_are_delayed_but_a_valid_one_is_not(farm):
    text = farm.open_session()
    responses = [farm.browse("GET", "/", "nonsense").status_code for _ in range(11)]
    assert responses == [401] * 10 + [429]
    assert farm.browse("GET", "/", text).status_code == 200


def test_session_is_limited_to_the_current_role_of_its_user(farm):
    text = farm.open_session(Role.OPERATE, "ann")
    assert farm.browse("POST", CLEARED_PATH, text, json={}).status_code == 200
    farm.user_roles["ann"] = Role.PRINT
    response = farm.browse("POST", CLEARED_PATH, text, json={})
    assert (response.status_code, "needs a key with the role operate; ann has print" in response.text) == (
        403,
        True,
    )
    assert "ann (print)" in farm.browse("GET", "/", text).text
    farm.user_roles["ann"] = None
    response = farm.browse("GET", "/", text)
    assert (response.status_code, "this host no longer has a user ann" in response.text) == (403, True)
    farm.user_roles["ann"] = Role.OPERATE  # as after a failure of the user database
    assert farm.browse("POST", CLEARED_PATH, text, json={}).status_code == 200


def test_session_is_limited_to_the_role_with_which_it_was_opened(farm):
    text = farm.open_session(Role.PRINT, "ann")  # a user who becomes an operator logs in again
    assert farm.browse("POST", CLEARED_PATH, text, json={}).status_code == 403


def test_stream_of_a_session_ends_when_its_user_is_gone(farm):
    permissions = []

    async def read_stream(scope, receive, send):
        is_allowed = scope["state"]["is_allowed"]
        permissions.append(is_allowed())
        farm.user_roles["ann"] = None
        permissions.append(is_allowed())
        await Response()(scope, receive, send)

    farm.web._app = read_stream
    farm.browse("GET", "/api/v1/events", farm.open_session())
    assert permissions == [True, False]


@pytest.mark.parametrize("role", Role)
def test_key_opens_a_session_of_its_role_and_name(farm, role):
    assert 'action="/login"' in farm.browse("GET", "/login").text
    assert 'action="/login"' in farm.browse("GET", "/").text
    key = farm.add_key(role, "panel")
    log_in_response = farm.log_in(f" {key.text}\n")  # as a person may paste it
    assert (log_in_response.status_code, log_in_response.headers["location"]) == (303, "/")
    text, attributes = read_cookie(log_in_response)
    assert {"httponly", "samesite=lax", "path=/"} <= attributes
    assert f"key panel ({role})" in farm.browse("GET", "/", text).text
    change_response = farm.browse("POST", CLEARED_PATH, text, json={})
    assert change_response.status_code == (200 if role is Role.OPERATE else 403)
    if role is Role.OPERATE:
        assert json.loads(farm.read_last_event()[1])["by"] == "key panel"
    assert farm.services.key_uses_s[key.id] == farm.clock.now_s


def test_session_of_a_key_ends_with_the_key(farm):
    lasting_key, short_key = farm.add_key(Role.LOOK, "a"), farm.add_key(Role.LOOK, "b", days=0.25)
    texts = [read_cookie(farm.log_in(key.text))[0] for key in (lasting_key, short_key)]
    farm.clock.now_s += 5 * 3600.0
    assert [farm.browse("GET", "/", text).status_code for text in texts] == [200, 200]
    farm.clock.now_s += 3600.0  # the second key has expired although its session is in use
    assert [farm.browse("GET", "/", text).status_code for text in texts] == [200, 401]
    farm.keys.revoke(lasting_key.id, "ann")
    assert farm.browse("GET", "/", texts[0]).status_code == 401
    assert all(session.revoked_s or session.expires_s <= farm.clock.now_s for session in list_sessions(farm))


@pytest.mark.parametrize("form", [{}, {"key": ""}, {"key": "nonsense"}, {str(i): "x" for i in range(99)}])
def test_wrong_key_opens_no_session(farm, form):
    response = farm.browse("POST", "/login", data=form)
    assert (response.status_code, "set-cookie" in response.headers) == (401, False)
    assert 'action="/login"' in response.text
    assert "this key is wrong" in response.text
    assert farm.browse("POST", "/login", content=b"key=\xff%ff").status_code == 401
    assert list_sessions(farm) == []


def test_revoked_key_and_session_open_no_session(farm):
    key = farm.add_key(Role.PRINT)
    session = read_cookie(farm.log_in(key.text))[0]
    farm.keys.revoke(key.id, "ann")
    assert [farm.log_in(text).status_code for text in (key.text, session)] == [401, 401]


def test_wrong_keys_in_the_form_count_like_those_of_programs(farm):
    key = farm.add_key(Role.PRINT).text
    responses = [farm.log_in("nonsense").status_code for _ in range(11)]
    assert responses == [401] * 10 + [429]
    assert farm.ask("GET", "/", "nonsense").status_code == 429
    assert farm.log_in(key).status_code == 303
    assert farm.log_in("nonsense", "10.0.0.8").status_code == 401


@pytest.mark.parametrize("headers", [{"origin": "http://evil.example"}, {}])
def test_login_form_of_another_site_is_refused(farm, headers):
    key = farm.add_key(Role.PRINT).text
    assert farm.ask("POST", "/login", headers=headers, data={"key": key}).status_code == 403
    assert list_sessions(farm) == []


def test_live_page_follows_the_current_role_and_its_stream_ends_when_the_role_changes(tmp_path):
    farm = NetworkFarm(tmp_path, printers=("a", "b"))
    session, path = farm.open_session(Role.OPERATE), b"/printers/b/cleared"
    assert path.decode() in farm.browse("GET", "/", session).text
    farm.user_roles["ann"] = Role.PRINT
    chunks = []

    async def receive():
        await asyncio.Event().wait()

    async def send(message):
        chunks.append(message.get("body", b""))
        if chunks[-1].startswith(b"id:"):
            farm.user_roles["ann"] = Role.LOOK
        if b"beat" in chunks[-1]:
            farm.services.page_streams.close()  # otherwise the stream would not end

    headers = {"host": HOST, **farm.make_cookie_header(session)}
    scope = {
        "type": "http",
        "method": "GET",
        "path": "/live",
        "query_string": b"page=/",
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }
    asyncio.run(farm.web(scope, receive, send))
    text = b"".join(chunks)
    assert b"printer-b" in text
    assert path not in text
    assert b"beat" not in text
    farm.store.close()
