"""Identification of callers by the kernel, and commands reserved for operators."""

import asyncio
import grp
import os
import pwd
import socket
import stat
import subprocess
import sys

import httpx
import pytest
import uvicorn

from books.recording_controller import RecordedEffects
from browser.http_caller import call_as
from clusters.same_process import AcceptingWorkers
from drivers.clock import Clock
from farm.config import Fleet
from farm.control import DryRuns
from farm.control.controller import Controller
from farm.errors import FleetFileError, RefusedError
from farm.http import PeerProtocol, Services, check_operator_group, listen, make_app
from farm.http.callers import Person, find_user_role
from farm.model import AgentSnapshot, FilamentState, Link, Role
from farm.paths import StateFolder
from farm.planning.printer_settings import list_bed_boxes
from farm.state.storage.store import Store

PRINTER_MODEL = "ultimaker2_plus"
NON_MEMBER = Person(uid=54321, gid=54321)
GROUP = grp.getgrgid(os.getgid()).gr_name
NO_GROUP = "no-such-group-here"


def build_app(folder, **fleet):
    rows = [{"name": "a", "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"}]
    checked_fleet = Fleet.model_validate({"fleet": fleet, "printers": rows})
    state = StateFolder(folder / "state")
    state.make()
    controller = Controller(checked_fleet, Store(state.books), Clock(), list_bed_boxes)
    controller.start(RecordedEffects())
    controller.on_snapshot(
        AgentSnapshot(printer="a", link=Link.READY, bed_clear=True, filament=FilamentState.PARKED)
    )

    async def shut_down(now):
        pass

    return make_app(
        Services(controller, state, folder / "fleet.yaml", AcceptingWorkers(), shut_down), DryRuns(controller)
    )


def send_request(app, person, method, path, **options):
    async def await_answer():
        transport = httpx.ASGITransport(call_as(person, app))
        async with httpx.AsyncClient(transport=transport, base_url="http://farm") as client:
            return await client.request(method, path, **options)

    return asyncio.run(await_answer())


OPERATOR_REQUESTS = (
    ("/printers/a/cleared", {}),
    ("/printers/a/load", {"grams": 500}),
    ("/printers/a/maintained", {}),
    ("/jobs/1/approve", {"plan": ""}),
    ("/outage/confirm", {}),
    ("/down", {}),
    ("/prune", {}),
)


@pytest.mark.parametrize(("path", "body"), OPERATOR_REQUESTS)
def test_commands_that_continue_prints_are_for_operators(tmp_path, path, body):
    app = build_app(tmp_path, operators=NO_GROUP)
    answer = send_request(app, NON_MEMBER, "POST", path, json=body)
    assert (answer.status_code, answer.json()["exit_code"]) == (409, 5)
    assert "is not an operator: only members of the group no-such-group-here may" in answer.json()["error"]


@pytest.mark.parametrize("group", [None, NO_GROUP])
def test_request_without_a_caller_is_refused_on_every_route(tmp_path, group):
    app = build_app(tmp_path, operators=group)
    values = {"number": "1", "name": "a", "part": "p01", "request_id": "r" * 8, "code": "1234", "key_id": "k"}
    routes = [
        (verb, path.format(**values)) for path, verbs in app.openapi()["paths"].items() for verb in verbs
    ]
    assert len(routes) > 20
    for method, path in routes:
        answer = send_request(app, None, method, path, json={})
        assert answer.status_code == 409, (method, path, answer.text)
        assert "the sender of this request is unknown" in answer.json()["error"], (method, path)


@pytest.mark.parametrize("group", [None, GROUP])
def test_operators_are_members_of_the_group_or_all_users_without_one(tmp_path, group):
    app = build_app(tmp_path, operators=group)
    member = Person(uid=54321, gid=os.getgid())
    assert send_request(app, member, "POST", "/printers/a/cleared", json={}).status_code == 200
    assert app.state.controller._store.read_all_events()[-1][2].count('"by":"uid 54321"') == 1


def test_owner_of_the_daemon_is_an_operator(tmp_path):
    app = build_app(tmp_path, operators=NO_GROUP)
    assert (
        send_request(app, Person(os.getuid(), 0), "POST", "/printers/a/cleared", json={}).status_code == 200
    )


def test_commands_that_stop_prints_are_for_all_users(tmp_path):
    app = build_app(tmp_path, operators=NO_GROUP)
    params = {"request_id": "r" * 8, "name": "box.stl", "size": 1}
    assert send_request(app, NON_MEMBER, "POST", "/jobs", params=params, content=b"x").status_code == 200
    job = send_request(app, NON_MEMBER, "GET", "/jobs/1").json()["job"]
    assert job["submitted_by"] == "uid 54321"
    assert send_request(app, NON_MEMBER, "POST", "/jobs/1/pause").status_code == 200
    answer = send_request(app, NON_MEMBER, "POST", "/jobs/1/cancel").json()["job"]
    assert (answer["state"], answer["reason"]) == ("cancelled", "cancelled by uid 54321")
    assert (
        send_request(app, NON_MEMBER, "POST", "/printers/a/maintenance", json={"why": "smoke"}).status_code
        == 200
    )


def test_role_of_a_user_follows_the_databases_of_the_host(monkeypatch):
    ann, groups = pwd.struct_passwd(("ann", "x", 54321, 54321, "", "/", "/bin/sh")), [54321]
    monkeypatch.setattr(pwd, "getpwnam", {"ann": ann}.__getitem__)
    monkeypatch.setattr(pwd, "getpwuid", {54321: ann}.__getitem__)
    monkeypatch.setattr(os, "getgrouplist", lambda name, gid: groups)
    assert find_user_role("ann", None) is Role.OPERATE
    assert find_user_role("ann", GROUP) is Role.PRINT
    groups.append(os.getgid())
    assert find_user_role("ann", GROUP) is Role.OPERATE
    groups.remove(os.getgid())
    assert find_user_role("ann", GROUP) is Role.PRINT
    assert find_user_role("bob", None) is None
    # The user database has no such user.
    assert find_user_role(Person(54322, 54322).name, GROUP) is Role.PRINT
    assert find_user_role(f"uid {os.getuid()}", NO_GROUP) is Role.OPERATE


def test_unknown_operator_group_is_an_error():
    check_operator_group(None)
    check_operator_group(GROUP)
    with pytest.raises(FleetFileError, match="`groupadd no-such-group-here`"):
        check_operator_group(NO_GROUP)


@pytest.mark.parametrize(("group", "mode"), [(GROUP, 0o660), (NO_GROUP, 0o600)])
def test_socket_belongs_to_its_group_or_else_its_owner(tmp_path, caplog, group, mode):
    caplog.set_level("INFO")
    path = tmp_path / "farm.sock"
    with listen(path, group):
        assert stat.S_IMODE(path.stat().st_mode) == mode
    assert (f"for group {group}" if mode == 0o660 else "for this user alone") in caplog.text


def test_unusable_socket_path_is_reported(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RefusedError, match="name another --socket"):
        listen(tmp_path / "file" / "farm.sock", GROUP)
    with listen(tmp_path / "new" / "farm.sock", NO_GROUP):
        assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o700


REQUEST_AS_USER = """
import os, socket, sys
os.setgroups([]); os.setgid(int(sys.argv[2])); os.setuid(int(sys.argv[2]))
client = socket.socket(socket.AF_UNIX)
client.connect(bytes.fromhex(sys.argv[1]))
client.sendall(b"POST /printers/a/cleared HTTP/1.1\\r\\nHost: farm\\r\\nConnection: close\\r\\n"
            b"Content-Type: application/json\\r\\nContent-Length: 2\\r\\n\\r\\n{}")
while data := client.recv(4096):
    sys.stdout.write(data.decode())
"""


async def post_as_users(app, *uids):
    """Serve the app on a socket that all users can reach; return the answer to each user."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(b"\0farm-test-" + os.urandom(8))
    listener.listen()
    server = uvicorn.Server(uvicorn.Config(app, http=PeerProtocol, log_config=None, lifespan="off"))
    serve_task = asyncio.create_task(server.serve(sockets=[listener]))
    answers = []
    for uid in uids:
        command = [sys.executable, "-c", REQUEST_AS_USER, listener.getsockname().hex(), str(uid)]
        process = await asyncio.create_subprocess_exec(*command, stdout=subprocess.PIPE)
        answers.append((await process.communicate())[0].decode())
    server.should_exit = True
    await serve_task
    return answers


@pytest.mark.skipif(os.getuid() != 0, reason="needs root to switch to another user")
def test_caller_is_identified_by_the_kernel(tmp_path):
    other_answer, root_answer = asyncio.run(post_as_users(build_app(tmp_path, operators=NO_GROUP), 54321, 0))
    assert "uid 54321 is not an operator" in other_answer
    assert root_answer.startswith("HTTP/1.1 200")
