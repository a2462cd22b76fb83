"""Every route on the network, for every kind of caller, from one table."""

import asyncio
import re

import httpx
import pytest
from fastapi.routing import iter_route_contexts

from drivers.clock import Clock
from farm.api import NETWORK_PREFIX, KeyRequest
from farm.config import Fleet
from farm.control import Controller, DryRuns, KeyCommands
from farm.http import Services, make_app
from farm.model import AgentSnapshot, FilamentState, Link, Role
from farm.paths import StateFolder
from farm.planning.printer_settings import bed_boxes
from farm.state.storage.store import Store
from farm.web import make_web_app
from farm.web.access import HOST_ONLY, LIVENESS, OPEN, ROLES
from recording_controller import RecordedEffects
from same_process import AcceptAll

MODEL = "ultimaker2_plus"
HOST = "farm.lab.example"
VALUES = {"printer": "a", "number": "1", "name": "a", "part": "p01", "request_id": "r" * 8}
LOOK, PRINT, OPERATE = Role


@pytest.fixture
def farm(tmp_path):
    rows = [{"name": "a", "model": MODEL, "port": f"sim://{MODEL}"}]
    state = StateFolder(tmp_path / "state")
    state.make()
    store = Store(state.books)
    controller = Controller(Fleet.model_validate({"printers": rows}), store, Clock(), bed_boxes)
    controller.start(RecordedEffects())
    controller.on_snapshot(
        AgentSnapshot(printer="a", link=Link.READY, bed_clear=True, filament=FilamentState.PARKED)
    )
    went_down = []

    async def down(now):
        went_down.append(now)

    services = Services(controller, state, tmp_path / "fleet.yaml", AcceptAll(), down)
    web = make_web_app(services, DryRuns(controller), {HOST})
    keys = KeyCommands(controller)

    class Farm:
        pass

    farm = Farm()
    farm.controller, farm.keys, farm.services, farm.went_down = controller, keys, services, went_down
    farm.unix = make_app(services, DryRuns(controller))
    farm.web = web

    def ask(method, path, text=None, host=HOST, address="10.0.0.9", headers=None, **more):
        own = {"x-api-key": text} if text else {}

        async def call():
            transport = httpx.ASGITransport(web, client=(address, 1), raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url=f"http://{host}") as client:
                return await client.request(method, path, headers={**own, **(headers or {})}, **more)

        return asyncio.run(call())

    farm.ask = ask
    farm.add = lambda role, name=None, days=None: keys.add(
        KeyRequest(name=name or str(role), role=role, days=days), "ann"
    )
    yield farm
    store.close()


def fill(path):
    return path.format(**VALUES)


def test_each_route_has_a_row_in_one_table_and_each_row_is_a_route(farm):
    contexts = iter_route_contexts(farm.web._app.routes)
    routes = {(method, context.path) for context in contexts for method in context.methods}
    assert routes == ROLES.keys() | OPEN | HOST_ONLY
    assert len(routes) == len(ROLES) + len(OPEN) + len(HOST_ONLY)


def test_what_has_no_row_is_not_served(farm):
    operator = farm.add(OPERATE).text
    assert ("POST", f"{NETWORK_PREFIX}/down") in HOST_ONLY
    for method, path in HOST_ONLY | {
        ("PUT", f"{NETWORK_PREFIX}/jobs"),
        ("OPTIONS", f"{NETWORK_PREFIX}/status"),
        ("HEAD", f"{NETWORK_PREFIX}/status"),
        ("GET", f"{NETWORK_PREFIX}/.."),
    }:
        assert farm.ask(method, fill(path), operator, json={}).status_code == 404, (method, path)
    for path in (
        "/status",
        "/docs",
        "/openapi.json",
        f"{NETWORK_PREFIX}//status",
        f"{NETWORK_PREFIX}/jobs/1/x",
    ):
        assert farm.ask("GET", path, operator).status_code == 404, path
    assert farm.went_down == []


@pytest.mark.parametrize(("method", "path"), ROLES)
def test_a_route_for_every_kind_of_caller(farm, method, path):
    needed, at = ROLES[method, path], fill(path)
    keys = {role: farm.add(role) for role in Role}
    revoked, expired = farm.add(OPERATE, "gone"), farm.add(OPERATE, "old", days=1e-9)
    farm.keys.revoke(revoked.id, "ann")
    before = len(farm.controller._store.events())

    def status(text=None, **more):
        return farm.ask(method, at, text, json={"why": "x"}, **more).status_code

    for text in (None, "nonsense", keys[OPERATE].text[:-1], "ü", revoked.text, expired.text):
        assert status(headers={"x-api-key": text.encode()} if text else None) == 401, text
    for role in Role:
        if not role.allows(needed):
            assert status(keys[role].text) == 403, role
    operator = keys[OPERATE].text
    assert status(operator, host="evil.example") == 421
    elsewhere = {"origin": "http://evil.example"}
    if method == "POST":
        assert status(operator, headers=elsewhere) == 403
        assert status(operator, headers={"sec-fetch-site": "cross-site"}) == 403
    assert len(farm.controller._store.events()) == before  # whatever was refused changed nothing
    assert status(keys[needed].text) not in (401, 403, 421, 429, 500)
    bearer = {"authorization": f"Bearer {keys[needed].text}"}
    assert status(headers=bearer) not in (401, 403, 421, 429, 500)


def test_a_key_s_name_is_in_the_event_log_and_its_text_is_nowhere(farm, tmp_path):
    key = farm.add(OPERATE, "slicer of ann")
    assert farm.ask("POST", f"{NETWORK_PREFIX}/printers/a/cleared", key.text, json={}).status_code == 200
    assert '"by":"key slicer of ann"' in farm.controller._store.events()[-1][2]
    assert farm.services.key_uses_s.keys() == {key.id}
    secret = key.text.split("_", 2)[2].encode()
    for path in tmp_path.rglob("*"):
        assert not path.is_file() or secret not in path.read_bytes(), path


def test_a_model_is_submitted_by_a_key_that_may_print(farm):
    key = farm.add(PRINT)
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


def test_a_long_body_is_refused(farm):
    long = farm.ask(
        "POST", f"{NETWORK_PREFIX}/printers/a/cleared", farm.add(OPERATE).text, content=b"x" * 200_000
    )
    assert long.status_code == 413


def test_ten_wrong_keys_have_to_wait_but_a_valid_one_does_not(farm):
    key = farm.add(LOOK)
    for _ in range(10):
        assert farm.ask("GET", f"{NETWORK_PREFIX}/status", "nonsense").status_code == 401
    assert farm.ask("GET", f"{NETWORK_PREFIX}/status", "nonsense").status_code == 429
    assert farm.ask("GET", f"{NETWORK_PREFIX}/status", "nonsense", address="10.0.0.8").status_code == 401
    assert farm.ask("GET", f"{NETWORK_PREFIX}/status", key.text).status_code == 200


def test_every_answer_forbids_scripts_and_frames_and_no_other_site_may_read_it(farm):
    key = farm.add(LOOK).text
    answers = (
        farm.ask("GET", LIVENESS),
        farm.ask("GET", f"{NETWORK_PREFIX}/status"),
        farm.ask("GET", f"{NETWORK_PREFIX}/status", key, headers={"origin": "http://evil.example"}),
        farm.ask("GET", f"{NETWORK_PREFIX}/nothing", key),
    )
    assert [answer.status_code for answer in answers] == [200, 401, 200, 404]
    for answer in answers:
        assert answer.headers["content-security-policy"].startswith("default-src 'none'")
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "access-control-allow-origin" not in answer.headers
    assert answers[0].json() == {"status": "ok"}
    assert not re.search("key print|um2|job", answers[0].text)
