"""Every route on the network, for every kind of caller, from one table."""

import re

import pytest
from fastapi.routing import iter_route_contexts

from farm.api import NETWORK_PREFIX
from farm.model import Role
from farm.web.access import HOST_ONLY_ROUTES, LIVENESS_PATH, PUBLIC_ROUTES, ROLES
from farms.network_farm import HOST, SAME_ORIGIN_HEADERS, NetworkFarm

VALUES = {"printer": "a", "number": "1", "name": "a", "part": "p01", "request_id": "r" * 8}
LOOK, PRINT, OPERATE = Role
JSON_HEADERS = {"content-type": "application/json"}
HOUR_S = 3600.0
REFUSALS = (401, 403, 421, 429, 500)


@pytest.fixture
def farm(tmp_path):
    farm = NetworkFarm(tmp_path)
    yield farm
    farm.store.close()


def fill_path(path):
    query = "?wait=false" if path.endswith("/events") else ""  # without it the stream does not end
    query = "?page=/nothing" if path == "/live" else query
    return path.format(**VALUES) + query


def test_each_route_has_a_row_in_one_table_and_each_row_is_a_route(farm):
    contexts = iter_route_contexts(farm.web._app.routes)
    routes = {(method, context.path) for context in contexts for method in context.methods}
    assert routes == ROLES.keys() | PUBLIC_ROUTES | HOST_ONLY_ROUTES
    assert len(routes) == len(ROLES) + len(PUBLIC_ROUTES) + len(HOST_ONLY_ROUTES)


def test_route_without_a_role_is_not_served(farm):
    operator = farm.add_key(OPERATE).text
    assert ("POST", f"{NETWORK_PREFIX}/down") in HOST_ONLY_ROUTES
    for method, path in HOST_ONLY_ROUTES | {
        ("PUT", f"{NETWORK_PREFIX}/jobs"),
        ("OPTIONS", f"{NETWORK_PREFIX}/status"),
        ("HEAD", f"{NETWORK_PREFIX}/status"),
        ("GET", f"{NETWORK_PREFIX}/.."),
    }:
        assert farm.ask(method, fill_path(path), operator, json={}).status_code == 404, (method, path)
    for path in (
        "/status",
        "/docs",
        "/openapi.json",
        f"{NETWORK_PREFIX}//status",
        f"{NETWORK_PREFIX}/jobs/1/x",
    ):
        assert farm.ask("GET", path, operator).status_code == 404, path
    assert farm.shutdowns == []


def list_callers(farm, needed_role):
    """List callers of every kind: their headers, and the status with which a route refuses them, or None."""
    keys = {role: farm.add_key(role).text for role in Role}
    revoked_key, expired_key = farm.add_key(OPERATE, "gone"), farm.add_key(OPERATE, "old", days=1.0)
    farm.keys.revoke(revoked_key.id, "ann")
    ended_session, unused_session = farm.open_session(user="bob"), farm.open_session(user="eve")
    farm.keys.revoke(ended_session.split("_")[1], "bob")
    farm.clock.now_s += 13 * HOUR_S
    sessions = {role: farm.open_session(role) for role in Role}
    farm.clock.now_s += 11.5 * HOUR_S
    wrong_texts = ("nonsense", keys[OPERATE][:-1], "ü", revoked_key.text, expired_key.text, sessions[OPERATE])
    yield "nobody", {}, 401
    for text in wrong_texts:
        yield f"key {text}", {"x-api-key": text.encode()}, 401
    for text in ("nonsense", sessions[OPERATE][:-1], ended_session, unused_session, keys[OPERATE]):
        yield f"session {text}", SAME_ORIGIN_HEADERS | farm.make_cookie_header(text), 401
    operator, session = {"x-api-key": keys[OPERATE]}, farm.make_cookie_header(sessions[OPERATE])
    yield "other host", operator | {"host": "evil.example"}, 421
    yield "other host, session", SAME_ORIGIN_HEADERS | session | {"host": "evil.example"}, 421
    for role in Role:
        status = None if role.allows(needed_role) else 403
        yield f"key {role}", {"x-api-key": keys[role]}, status
        yield f"bearer {role}", {"authorization": f"Bearer {keys[role]}"}, status
        yield f"session {role}", SAME_ORIGIN_HEADERS | farm.make_cookie_header(sessions[role]), status


OTHER_SITES = (
    {"origin": "http://evil.example"},
    {"origin": f"http://{HOST}:81"},
    {"origin": "null"},
    {"sec-fetch-site": "cross-site"},
    {"sec-fetch-site": "same-site"},
)


@pytest.mark.parametrize(("method", "path"), ROLES)
def test_route_answers_each_kind_of_caller_by_its_role(farm, method, path):
    needed_role, filled_path = ROLES[method, path], fill_path(path)
    callers = list(list_callers(farm, needed_role))

    def request_status(headers):
        return farm.ask(method, filled_path, headers=headers, json={"why": "x"}).status_code

    def count_events():
        return len(farm.store.read_all_events())

    event_count = count_events()
    for name, headers, status in callers:
        if status is not None:
            assert request_status(headers) == status, name
            farm.clock.now_s += 60.0  # otherwise requests would wait after ten wrong keys
    operator_headers = [headers for name, headers, _ in callers if name in ("key operate", "session operate")]
    assert len(operator_headers) == 2
    if method == "POST":
        for headers in operator_headers:
            for site in OTHER_SITES:
                headers_without_origin = {name: value for name, value in headers.items() if name != "origin"}
                assert request_status(headers_without_origin | site) == 403, site
        # No browser sends a form without its origin.
        assert request_status({"cookie": operator_headers[1]["cookie"]}) == 403
    assert count_events() == event_count  # refused requests changed nothing
    for name, headers, status in callers:
        if status is None and (method, path) != ("POST", "/logout"):
            assert request_status(headers) not in REFUSALS, name
    assert request_status(operator_headers[1]) not in REFUSALS


def test_event_log_has_the_name_of_a_key_and_never_its_text(farm, tmp_path):
    key = farm.add_key(OPERATE, "slicer of ann")
    assert farm.ask("POST", f"{NETWORK_PREFIX}/printers/a/cleared", key.text, json={}).status_code == 200
    assert '"by":"key slicer of ann"' in farm.store.read_all_events()[-1][2]
    assert farm.services.key_uses_s.keys() == {key.id}
    secret = key.text.split("_", 2)[2].encode()
    for path in tmp_path.rglob("*"):
        assert not path.is_file() or secret not in path.read_bytes(), path


def test_model_is_submitted_by_a_key_that_may_print(farm):
    key = farm.add_key(PRINT)
    params = {"request_id": "r" * 8, "name": "box.stl", "size": 100_000}
    assert (
        farm.ask(
            "POST", f"{NETWORK_PREFIX}/jobs", key.text, params=params, content=b"x" * 100_000
        ).status_code
        == 200
    )
    job = farm.ask("GET", f"{NETWORK_PREFIX}/jobs/1", key.text).json()["job"]
    assert job["submitted_by"] == "key print"
    assert farm.ask("POST", f"{NETWORK_PREFIX}/jobs/1/cancel", key.text).json()["job"]["state"] == "cancelled"


def test_oversized_body_is_refused(farm):
    long_response = farm.ask(
        "POST", f"{NETWORK_PREFIX}/printers/a/cleared", farm.add_key(OPERATE).text, content=b"x" * 200_000
    )
    assert long_response.status_code == 413


def test_long_headers_are_refused(farm):
    long_headers = {"x-long": "x" * 20_000}
    assert farm.ask("GET", LIVENESS_PATH, headers=long_headers).status_code == 431


def test_ten_wrong_keys_are_delayed_but_a_valid_key_is_not(farm):
    key = farm.add_key(LOOK)
    for _ in range(10):
        assert farm.ask("GET", f"{NETWORK_PREFIX}/status", "nonsense").status_code == 401
    assert farm.ask("GET", f"{NETWORK_PREFIX}/status", "nonsense").status_code == 429
    assert farm.ask("GET", f"{NETWORK_PREFIX}/status", "nonsense", address="10.0.0.8").status_code == 401
    assert farm.ask("GET", f"{NETWORK_PREFIX}/status", key.text).status_code == 200


def test_every_response_forbids_scripts_and_frames_and_no_other_site_may_read_it(farm):
    key = farm.add_key(LOOK).text
    responses = (
        farm.ask("GET", LIVENESS_PATH),
        farm.ask("GET", f"{NETWORK_PREFIX}/status"),
        farm.ask("GET", f"{NETWORK_PREFIX}/status", key, headers={"origin": "http://evil.example"}),
        farm.ask("GET", f"{NETWORK_PREFIX}/nothing", key),
    )
    assert [response.status_code for response in responses] == [200, 401, 200, 404]
    for response in responses:
        assert response.headers["content-security-policy"].startswith("default-src 'none'")
        assert response.headers["x-content-type-options"] == "nosniff"
        assert "access-control-allow-origin" not in response.headers
    assert responses[0].json() == {"status": "ok"}
    assert not re.search("key print|um2|job", responses[0].text)


def test_body_that_cannot_be_parsed_gets_the_usual_error(farm):
    path, key = fill_path(f"{NETWORK_PREFIX}/printers/{{name}}/cleared"), farm.add_key(OPERATE).text
    response = farm.ask("POST", path, key, content=b'{"why": "\xff"}', headers=JSON_HEADERS)
    assert response.status_code == 400
    assert response.json().keys() == {"error", "code", "exit_code"}
