"""HTTP interface without a network: answers to broken and hostile clients."""

import asyncio
import io
import shutil
from pathlib import Path

import httpx
import pytest
import trimesh

from books.recording_controller import RecordedEffects
from browser.http_caller import DAEMON_USER, call_as
from clusters.same_process import SameProcess
from drivers.clock import Clock
from farm.config import Fleet
from farm.control import DryRuns
from farm.control.controller import Controller
from farm.http import Services, make_app
from farm.http.body_limit import MAX_BODY_BYTES
from farm.model import AgentSnapshot, FilamentState, Link
from farm.paths import StateFolder
from farm.planning.printer_settings import list_bed_boxes
from farm.state.storage.store import Store
from model_files.make_gcode import make_marlin

PRINTER_MODEL = "ultimaker2_plus"


@pytest.fixture
def daemon(tmp_path):
    """Make a controller and its application, with one printer that is ready."""
    fleet = Fleet.model_validate(
        {"printers": [{"name": "a", "model": PRINTER_MODEL, "port": f"sim://{PRINTER_MODEL}"}]}
    )
    state = StateFolder(tmp_path / "state")
    state.make()
    controller = Controller(fleet, Store(state.books), Clock(), list_bed_boxes)
    controller.start(RecordedEffects())
    controller.on_snapshot(
        AgentSnapshot(printer="a", link=Link.READY, bed_clear=True, filament=FilamentState.PARKED)
    )
    shutdowns = []

    async def shut_down(now):
        shutdowns.append(now)

    services = Services(controller, state, tmp_path / "fleet.yaml", SameProcess(), shut_down)
    app = make_app(services, DryRuns(controller))
    app.state.inspections = services.inspections
    app.state.controller, app.state.shutdowns, app.state.folder = controller, shutdowns, state
    return app


def send_request(app, method, path, **options):
    async def await_answer():
        transport = httpx.ASGITransport(call_as(DAEMON_USER, app), raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://farm") as client:
            return await client.request(method, path, **options)

    return asyncio.run(await_answer())


def make_stl():
    file = io.BytesIO()
    trimesh.creation.box((30.0, 20.0, 10.0)).export(file, "stl")
    return file.getvalue()


def submit_model(app, content, **params):
    fields = {"request_id": "r" * 8, "name": "box.stl", "size": len(content)}
    return send_request(app, "POST", "/jobs", params={**fields, **params}, content=content)


def test_own_gcode_is_submitted_like_a_model(daemon):
    content = ("\n".join(make_marlin()) + "\n").encode()
    assert submit_model(daemon, content, name="tower.gcode").json() == {"job": 1, "again": False}
    assert submit_model(daemon, content, name="tower.gcode").json() == {"job": 1, "again": True}
    job = daemon.state.controller.books.jobs[1]
    assert (daemon.state.folder.files / job.model_file).read_bytes() == content
    assert (job.name, job.own_gcode.min_mm) == ("tower.gcode", pytest.approx((-11.5, -11.5, 0.2)))
    assert list(daemon.state.folder.work.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "options", "code"),
    [
        ("t.gcode", '{"scale": 2}', "settings"),
        ("t.gcode", '{"colour": "red"}', "refused"),
        ("t.gcode.gz", "{}", "gcode"),
        ("t.stl", "{}", "model"),
    ],
)
def test_unprintable_own_gcode_is_refused_with_its_name(daemon, name, options, code):
    answer = submit_model(
        daemon, ("\n".join(make_marlin()) + "\n").encode(), name=name, options=options
    ).json()
    assert answer["code"] == code
    assert daemon.state.controller.books.jobs == {}


def test_repeated_submission_is_one_job(daemon):
    assert submit_model(daemon, make_stl()).json() == {"job": 1, "again": False}
    assert submit_model(daemon, make_stl()).json() == {"job": 1, "again": True}
    assert len(daemon.state.controller.books.jobs) == 1


@pytest.mark.parametrize("size", [0, 10, 10_000_000])
def test_truncated_upload_creates_no_job_and_no_file(daemon, size):
    answer = submit_model(daemon, make_stl(), size=size)
    assert answer.status_code == 409
    assert answer.json()["exit_code"] == 5
    assert "submit it again" in answer.json()["error"]
    assert not daemon.state.controller.books.jobs
    assert not list(daemon.state.folder.work.iterdir())


def make_endless_body(chunks):
    """Yield a JSON string without an end; append the size of each chunk that is read to `chunks`."""

    async def send_pieces():
        yield b'{"why": "'
        for _ in range(1000):
            chunks.append(4096)
            yield b"x" * 4096

    return send_pieces()


@pytest.mark.parametrize("path", ["/printers/a/fail", "/down", "/jobs/1/approve", "/jobs/1/parts/p1/reprint"])
def test_endless_body_is_refused_without_being_read_further(daemon, path):
    chunks = []
    answer = send_request(daemon, "POST", path, content=make_endless_body(chunks))
    assert sum(chunks) <= MAX_BODY_BYTES + 4096
    assert (answer.status_code, answer.json()["exit_code"]) == (413, 5)
    assert answer.json()["error"] == f"the request to {path} is longer than 64 KiB"


def test_body_of_the_largest_size_is_read(daemon):
    body_bytes = b'{"why": "w"}'
    body = body_bytes + b" " * (MAX_BODY_BYTES - len(body_bytes))
    path, json_headers = "/printers/a/maintenance", {"Content-Type": "application/json"}
    assert send_request(daemon, "POST", path, content=body, headers=json_headers).status_code == 200
    assert send_request(daemon, "POST", path, content=body + b" ", headers=json_headers).status_code == 413


def test_upload_beyond_the_quota_is_refused_before_it_is_sent(daemon, monkeypatch):
    chunks = []
    answer = send_request(
        daemon,
        "POST",
        "/jobs",
        params={"request_id": "r" * 8, "name": "big.stl", "size": 3_000_000_000},
        content=make_endless_body(chunks),
    )
    assert (answer.status_code, answer.json()["exit_code"]) == (409, 5)
    assert "big.stl is 3.0 GB; a model may be at most 2 GB" in answer.json()["error"]
    assert not chunks
    usage = shutil.disk_usage(daemon.state.folder.root)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage._replace(free=500_000_500))
    assert "free_gb" in submit_model(daemon, make_stl()).json()["error"]
    assert not daemon.state.controller.books.jobs
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage._replace(free=501_000_000))
    assert submit_model(daemon, make_stl()).status_code == 200


def test_incomplete_upload_is_refused_and_leaves_no_file(daemon):
    """End the connection in the middle of the body, as Ctrl-C at `farm submit` does."""
    messages = [{"type": "http.request", "body": b"solid", "more_body": True}, {"type": "http.disconnect"}]
    sent_messages = []

    async def receive():
        return messages.pop(0)

    async def send(message):
        sent_messages.append(message)

    query = b"request_id=rrrrrrrr&name=box.stl&size=100"
    scope = {"type": "http", "http_version": "1.1", "method": "POST", "path": "/jobs", "query_string": query}
    asyncio.run(daemon({**scope, "headers": [], "state": {}}, receive, send))
    assert sent_messages[0]["status"] == 409
    assert not daemon.state.controller.books.jobs
    assert not list(daemon.state.folder.work.iterdir())


NAMES = {
    "../../evil.stl": "evil.stl",
    "/etc/passwd.stl": "passwd.stl",
    "ein Würfel 立方体.stl": "ein Würfel 立方体.stl",
    "a\nb.stl": "a b.stl",
    "a\0b.stl": "a b.stl",
    "C:\\parts\\box.stl": "box.stl",
    "\N{SNAKE}" * 80 + ".stl": "\N{SNAKE}" * 56 + ".stl",
}


@pytest.mark.parametrize("name", NAMES)
def test_path_in_a_model_name_is_removed(daemon, name):
    answer = submit_model(daemon, make_stl(), name=name)
    assert answer.status_code == 200, answer.text
    folders = {path.parent.name for path in daemon.state.folder.root.rglob("*") if path.is_file()}
    assert folders <= {"state", "files"}
    assert daemon.state.controller.books.jobs[1].name == NAMES[name]


@pytest.mark.parametrize("name", ["..", ".", "box", "box." + "\N{SNAKE}" * 150])
def test_name_without_a_known_suffix_is_refused(daemon, name):
    answer = submit_model(daemon, make_stl(), name=name)
    assert answer.status_code == 400
    assert "not a known kind of model" in answer.json()["error"]


def test_material_that_no_printer_has_is_refused_at_once(daemon):
    answer = submit_model(daemon, make_stl(), options='{"material": "generic_pal"}')
    assert answer.status_code == 409
    assert "no printer of the fleet has generic_pal; the fleet has generic_pla" in answer.json()["error"]


BAD_OPTIONS = ("{", '{"printers": 0}', '{"x": 1}', '{"quality": "nonsense"}', '{"engine": "nonsense"}')


@pytest.mark.parametrize("options", BAD_OPTIONS)
def test_unknown_options_are_refused(daemon, options):
    answer = submit_model(daemon, make_stl(), options=options)
    assert answer.status_code == 400
    assert answer.json()["exit_code"] == 2


def test_unknown_path_is_not_found(daemon):
    for method, path in (("GET", "/jobs/9"), ("POST", "/jobs/9/cancel"), ("GET", "/nothing")):
        answer = send_request(daemon, method, path)
        assert (answer.status_code, answer.json()["exit_code"]) == (404, 4)
    answer = send_request(daemon, "POST", "/printers/z/cleared", json={})
    assert (answer.status_code, answer.json()["exit_code"]) == (404, 4)


def test_summary_of_the_farm_omits_the_parts_and_plates_of_jobs(daemon):
    submit_model(daemon, make_stl())
    status, summary = (send_request(daemon, "GET", path).json() for path in ("/status", "/status/summary"))
    assert summary.keys() == status.keys() | {"waits"}
    (job,), (job_summary,) = status["jobs"], summary["jobs"]
    assert job_summary.keys() == job.keys() - {"parts", "plates"} | {"plate_count"}


def test_status_has_the_documented_fields(daemon):
    submit_model(daemon, make_stl())
    status = send_request(daemon, "GET", "/status").json()
    sections = {"schema", "daemon", "todo", "fleet", "printers", "jobs", "night", "cluster"}
    assert status.keys() == sections
    assert status["schema"] == 1
    documented_fields = {
        "name",
        "model",
        "state",
        "bed",
        "filament",
        "reel",
        "agent_pid",
        "nozzle_c",
        "bed_c",
        "targets",
    }
    assert documented_fields | {"print"} <= set(status["printers"][0])
    job = send_request(daemon, "GET", "/jobs/1").json()["job"]
    documented_fields = {
        "id",
        "state",
        "parts",
        "plates",
        "repairs",
        "scale",
        "estimated_s",
        "eta",
        "elapsed_s",
        "serial_s",
    }
    assert documented_fields | {"speedup", "utilisation"} <= set(job)


def test_shutdown_is_refused_during_planning(daemon):
    submit_model(daemon, make_stl())
    assert daemon.state.controller.books.jobs[1].state == "planning"
    answer = send_request(daemon, "POST", "/down", json={})
    assert (answer.status_code, answer.json()["exit_code"]) == (409, 5)
    assert "being planned: job 1; use --wait" in answer.json()["error"]
    for mode in ("wait", "now"):
        assert send_request(daemon, "POST", "/down", json={mode: True}).status_code == 200
    assert daemon.state.shutdowns == [False, True]


@pytest.mark.parametrize(
    ("options", "notices"),
    [
        ('{"printers": 1}', None),
        ('{"printers": 9}', ["--printers 9: the fleet has 1 printer, so the job cannot use more"]),
        (
            '{"spares": 1}',
            ["--spares 1: the fleet has 1 printer, and at least one has to print the job"],
        ),
    ],
)
def test_request_for_too_many_printers_is_reported(daemon, options, notices):
    assert submit_model(daemon, make_stl(), options=options).json().get("notices") == notices


def test_shutdown_is_refused_during_an_inspection(daemon):
    daemon.state.inspections[Path("upload-1")] = "bunny.stl"
    answer = send_request(daemon, "POST", "/down", json={})
    assert (answer.status_code, answer.json()["exit_code"]) == (409, 5)
    assert "being checked: bunny.stl; use --wait" in answer.json()["error"]
    for mode in ("wait", "now"):
        assert send_request(daemon, "POST", "/down", json={mode: True}).status_code == 200


def test_shutdown_request_ends_the_daemon(daemon):
    assert send_request(daemon, "POST", "/down", json={"now": True}).status_code == 200
    assert daemon.state.shutdowns == [True]


def test_routes_reach_the_commands(daemon):
    body_fields = {"why": "a\x1b[2J\nnew belt"}
    assert send_request(daemon, "POST", "/printers/a/maintenance", json=body_fields).status_code == 200
    printer = send_request(daemon, "GET", "/status").json()["printers"][0]
    assert (printer["state"], printer["maintenance"]) == ("maintenance", "a [2J new belt")
    assert send_request(daemon, "POST", "/printers/a/maintained", json=body_fields).status_code == 200
    submit_model(daemon, make_stl())
    assert send_request(daemon, "POST", "/jobs/1/pause").status_code == 200
    assert send_request(daemon, "GET", "/jobs/1").json()["job"]["paused"]
    assert send_request(daemon, "POST", "/jobs/1/resume").status_code == 200
    for path in (
        *("/printers/a/fail", "/printers/a/cancel", "/printers/a/maintained", "/outage/confirm"),
        *("/jobs/1/resume", "/printers/a/cleared"),
    ):
        body = (
            None
            if path.startswith("/jobs")
            else {**body_fields, **({"bad": True} if "cleared" in path else {})}
        )
        answer = send_request(daemon, "POST", path, json=body)
        assert (answer.status_code, answer.json()["exit_code"]) == (409, 5), path
    for path in ("/jobs/1/parts/p9/reprint", "/jobs/1/parts/p9/cancel", "/jobs/7/pause", "/printers/z/fail"):
        assert send_request(daemon, "POST", path, json=body_fields).status_code == 404, path
    assert send_request(daemon, "POST", "/jobs/1/parts/p9/pause").status_code == 404
    assert send_request(daemon, "GET", "/history").json()["prints"] == []
    assert send_request(daemon, "GET", "/history?job=7").status_code == 404
