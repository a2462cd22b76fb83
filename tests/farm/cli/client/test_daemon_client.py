"""Messages when the daemon does not answer, or when its answer cannot be read."""

import itertools
import json
import socket
import threading
from http.server import BaseHTTPRequestHandler
from socketserver import UnixStreamServer

import pytest

from farm.api import ClearedRequest
from farm.cli.client import Client, SocketConnection
from farm.errors import DaemonUnreachable, ErrorCode, FarmError, NotFoundError
from farm.model import JobOptions


class FakeDaemon(BaseHTTPRequestHandler):
    """Server that records requests, and sends a given answer."""

    protocol_version = "HTTP/1.1"

    def do_POST(self):
        if self.server.answers_early:
            self.do_GET()
            self.close_connection = True
            return
        length = self.headers.get("Content-Length")
        if length is None:  # an upload, in chunks
            body = b""
            while size := int(self.rfile.readline(), 16):
                body += self.rfile.read(size)
                self.rfile.readline()
            self.rfile.readline()
        else:
            body = self.rfile.read(int(length))
        self.server.requests.append((self.path, body))
        self.do_GET()

    def do_GET(self):
        status, text = self.server.answer
        self.send_response(status)
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    def log_message(self, *_):
        pass


@pytest.fixture
def daemon(tmp_path):
    with UnixStreamServer(str(tmp_path / "farm.sock"), FakeDaemon) as server:
        server.requests, server.answer, server.answers_early = [], (200, b"{}"), False
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture
def client(tmp_path):
    return Client(tmp_path / "farm.sock")


def test_missing_daemon_is_reported_with_the_command_to_start_it(client):
    with pytest.raises(DaemonUnreachable, match=r"\(No such file or directory\); `farm up` starts one"):
        client.fetch_status()  # an open socket would cause a warning, which is an error here


def test_hanging_daemon_is_not_reported_as_missing(tmp_path):
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "farm.sock"))
        listener.listen()
        with pytest.raises(DaemonUnreachable, match=r"not answered for 0\.01 s.*`farm estop` works without"):
            Client(tmp_path / "farm.sock", response_timeout_s=0.01).fetch_status()


def test_user_outside_the_group_gets_a_reason(client, monkeypatch):
    def deny_access(self):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(SocketConnection, "connect", deny_access)
    with pytest.raises(DaemonUnreachable, match=r"you may not use .* members of its group"):
        client.fetch_status()


def test_daemon_that_dies_during_an_answer_is_unreachable(tmp_path, client):
    def drop_connection(listener):
        connection, _ = listener.accept()
        connection.close()

    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "farm.sock"))
        listener.listen()
        thread = threading.Thread(target=drop_connection, args=[listener])
        thread.start()
        with pytest.raises(DaemonUnreachable, match="`farm up` starts one"):
            client.fetch_status()
        thread.join()


def test_refusal_of_the_daemon_keeps_its_code_and_message(daemon, client):
    problem = {"error": "there is no job 9", "code": "no_such_thing", "exit_code": 4}
    daemon.answer = (404, json.dumps(problem).encode())
    with pytest.raises(FarmError, match="there is no job 9") as error:
        client.fetch_job(9)
    assert error.value.exit_code == NotFoundError("").exit_code
    for text in (b"<html>", b'{"detail": "no"}', b'{"error": "no", "code": "a newer one", "exit_code": 9}'):
        daemon.answer = (502, text)
        with pytest.raises(FarmError, match="the daemon answered 502: "):
            client.fetch_job(9)


def test_daemon_of_another_version_is_reported(daemon, client):
    for text in (b"{}", b"[]", b'{"daemon": {"pid": 1, "version": "9", "since": "", "news": 1}, "job": 3}'):
        daemon.answer = (200, text)
        with pytest.raises(FarmError, match=r"different version from this command .*: end it with SIGTERM"):
            client.fetch_job(9)


def test_requests_arrive_unchanged(daemon, client, tmp_path, monkeypatch):
    daemon.answer = (200, b'{"again": null}')
    client.clear_bed("um2-01", ClearedRequest(bad=True, why="warped: 3 mm & more"))
    ((path, body),) = daemon.requests
    assert path == "/printers/um2-01/cleared"
    assert json.loads(body)["why"] == "warped: 3 mm & more"
    model = tmp_path / "a part & more.stl"
    model.write_bytes(bytes(range(256)) * 10_000)
    daemon.answer = (200, b'{"job": 3, "again": false}')
    monkeypatch.setattr(Client, "fetch_status", lambda self: None)
    assert client.submit(model, JobOptions(scale=2.0)).job == 3
    path, body = daemon.requests[-1]
    assert "name=a+part+%26+more.stl" in path and "size=2560000" in path
    assert body == model.read_bytes()


def test_early_refusal_of_an_upload_keeps_its_message(daemon, client, tmp_path, monkeypatch):
    model = tmp_path / "part.stl"
    model.write_bytes(bytes(4_000_000))  # more than the socket buffers
    problem = {"error": "the farm is going down", "code": "refused", "exit_code": 5}
    daemon.answer, daemon.answers_early = (409, json.dumps(problem).encode()), True
    monkeypatch.setattr(Client, "fetch_status", lambda self: None)
    with pytest.raises(FarmError, match="going down"):
        client.submit(model, JobOptions())


class SlowDaemonClient(Client):
    """Client of a daemon that answers a submission after several requests for its progress."""

    def __init__(self, path, answers):
        super().__init__(path, response_timeout_s=10.0)
        self.answers, self.all_answers_sent = list(answers), threading.Event()

    def _send(self, method, path, **options):
        if path == "/jobs":
            assert self.all_answers_sent.wait(60.0)
            return {"job": 7, "again": False}
        if not path.startswith("/uploads/"):
            return STATUS
        answer = self.answers.pop(0)
        if not self.answers:
            self.all_answers_sent.set()
        if isinstance(answer, Exception):
            raise answer
        return answer


STATUS = {
    "schema": 1,
    "daemon": {"pid": 1, "version": "1", "since": ""},
    "todo": [],
    "printers": [],
    "jobs": [],
    "fleet": {"name": "", "timezone": "", "time_scale": 1.0, "now": "", "file": ""},
    "night": None,
}
NO_UPLOAD_ERROR = FarmError("there is no open upload", ErrorCode.NO_SUCH_THING)
UNREACHABLE_ERROR = DaemonUnreachable("the daemon has not answered for 10 s and may hang")
REPAIR_PROGRESS = {"step": "repairing", "received": 5, "size": 5}


@pytest.fixture
def minute_clock(monkeypatch):
    """Advance the client's clock by a minute at each reading, and skip its sleeps."""
    clock = itertools.count(0.0, 60.0)
    monkeypatch.setattr("farm.cli.client.daemon_client.time.monotonic", lambda: next(clock))
    monkeypatch.setattr("farm.cli.client.daemon_client.time.sleep", lambda _: None)
    monkeypatch.setattr("farm.cli.client.daemon_client._POLL_INTERVAL_S", 0.01)


def test_client_waits_while_the_daemon_reports_progress(tmp_path, minute_clock):
    """Wait an hour for a submission: for a worker, and for the repair of a large broken model."""
    model, reports = tmp_path / "box.stl", []
    model.write_bytes(b"solid")
    daemon = SlowDaemonClient(tmp_path, [NO_UPLOAD_ERROR, *[REPAIR_PROGRESS] * 60])
    assert daemon.submit(model, JobOptions(), report=reports.append).job == 7
    assert {view.step for view in reports} == {"repairing"}


def test_client_gives_up_when_the_daemon_is_silent(tmp_path, minute_clock):
    model = tmp_path / "box.stl"
    model.write_bytes(b"solid")
    daemon = SlowDaemonClient(tmp_path, [REPAIR_PROGRESS, *[UNREACHABLE_ERROR] * 9])
    with pytest.raises(DaemonUnreachable, match="may hang"):
        daemon.submit(model, JobOptions(), retry_s=0.0)
    daemon.all_answers_sent.set()
