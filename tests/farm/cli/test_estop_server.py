"""Server of `estop.sock`: idle or excessive connections do not block others."""

import json
import socket

import pytest

from farm.cli import estop_server
from farm.cli.estop_server import MAX_PER_USER, MAX_TOTAL, REQUEST_S, EstopServer, read_peer_uid

CLIENT_COUNT = 80
REQUEST = b'{"printers":[]}\n'


class FakeEstop:
    """Emergency stop that ends on request."""

    def __init__(self):
        self.code = None

    def poll(self):
        return self.code


class Bench:
    """Server with a controlled clock, and users who connect."""

    def __init__(self, folder):
        self.now_s, self.uid = 100.0, 1000
        self.started, self.ends = [], []
        self.listening = socket.socket(socket.AF_UNIX)
        self.path = str(folder / "s")
        self.listening.bind(self.path)
        self.listening.listen(128)
        self.server = EstopServer(self.listening, self.begin, lambda _: self.uid)

    def begin(self, connection, request):
        estop = FakeEstop()
        self.started.append((request, estop))
        return estop

    def connect(self, uid, data=b""):
        self.uid = uid
        client = socket.socket(socket.AF_UNIX)
        self.ends.append(client)
        client.connect(self.path)
        client.sendall(data)
        self.serve_once()
        self.serve_once()
        return client

    def serve_once(self, elapsed_s=0.0):
        self.now_s += elapsed_s
        self.server.serve_once(self.now_s, 0.0)


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    yield bench
    for client in (bench.listening, *bench.ends, *bench.server._pending):
        client.close()


def is_refused(client):
    client.settimeout(0.0)
    try:
        answer = client.recv(4096)
    except BlockingIOError:
        return False
    return not answer or "too many" in json.loads(answer)["error"]


def test_request_is_passed_on_once_complete(bench):
    client = bench.connect(1000, REQUEST[:5])
    assert bench.started == []
    client.sendall(REQUEST[5:])
    bench.serve_once()
    assert [request for request, _ in bench.started] == [REQUEST]


@pytest.mark.parametrize("data", [b"", REQUEST[:5]], ids=["nothing", "half a request"])
def test_connection_without_a_request_is_ended_after_two_seconds(bench, data):
    client = bench.connect(1000, data)
    bench.serve_once(REQUEST_S)
    assert not is_refused(client)
    bench.serve_once(0.1)
    assert is_refused(client) and bench.started == []


def test_requests_are_limited_per_user(bench):
    clients = [bench.connect(1000) for _ in range(CLIENT_COUNT)]
    assert sum(not is_refused(client) for client in clients) == MAX_PER_USER
    bench.connect(2000, REQUEST)
    assert len(bench.started) == 1


def test_running_stops_count_until_they_end(bench):
    for _ in range(MAX_PER_USER):
        bench.connect(1000, REQUEST)
    assert is_refused(bench.connect(1000, REQUEST)) and len(bench.started) == MAX_PER_USER
    bench.started[0][1].code = 0
    bench.connect(1000, REQUEST)
    assert len(bench.started) == MAX_PER_USER + 1


def test_total_number_of_requests_is_limited(bench):
    for uid in range(MAX_TOTAL // MAX_PER_USER + 1):
        for _ in range(MAX_PER_USER):
            bench.connect(uid, REQUEST)
    assert len(bench.started) == MAX_TOTAL


def test_server_continues_a_second_after_missing_descriptors(bench, monkeypatch):
    class FullListener:
        def fileno(self):
            return bench.listening.fileno()

        def accept(self):
            raise OSError(24, "Too many open files")

    monkeypatch.setattr(bench.server, "_listener", FullListener())
    bench.connect(1000, REQUEST)
    monkeypatch.setattr(bench.server, "_listener", bench.listening)
    bench.serve_once(0.5)
    assert bench.started == []
    bench.serve_once(0.6)
    bench.serve_once()
    assert len(bench.started) == 1


def test_peer_is_identified_by_the_kernel():
    own_end, peer = socket.socketpair()
    with own_end, peer:
        assert read_peer_uid(own_end) == estop_server.struct.unpack("=iII", peer.getsockopt(1, 17, 12))[1]
