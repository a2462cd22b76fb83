"""Server of `estop.sock`: idle or excessive connections do not block others."""

import json
import socket

import pytest

from farm.cli import estop_server
from farm.cli.estop_server import (
    MAX_REQUESTS,
    MAX_REQUESTS_PER_USER,
    REQUEST_TIMEOUT_S,
    EstopServer,
    read_peer_uid,
)

CLIENT_COUNT = 80
REQUEST = b'{"printers":[]}\n'


class FakeEstop:
    """Emergency stop that ends on request."""

    def __init__(self):
        self.code = None

    def poll(self):
        return self.code


class ServerRig:
    """Server with a controlled clock, and users who connect."""

    def __init__(self, folder):
        self.now_s, self.uid = 100.0, 1000
        self.started_stops, self.clients = [], []
        self.listener = socket.socket(socket.AF_UNIX)
        self.path = str(folder / "s")
        self.listener.bind(self.path)
        self.listener.listen(128)
        self.server = EstopServer(self.listener, self.start_stop, lambda _: self.uid)

    def start_stop(self, connection, request):
        estop = FakeEstop()
        self.started_stops.append((request, estop))
        return estop

    def connect(self, uid, data=b""):
        self.uid = uid
        client = socket.socket(socket.AF_UNIX)
        self.clients.append(client)
        client.connect(self.path)
        client.sendall(data)
        self.serve_once()
        self.serve_once()
        return client

    def serve_once(self, elapsed_s=0.0):
        self.now_s += elapsed_s
        self.server.serve_once(self.now_s, 0.0)


@pytest.fixture
def rig(tmp_path):
    rig = ServerRig(tmp_path)
    yield rig
    for client in (rig.listener, *rig.clients, *rig.server._pending_connections):
        client.close()


def is_refused(client):
    client.settimeout(0.0)
    try:
        answer = client.recv(4096)
    except BlockingIOError:
        return False
    return not answer or "too many" in json.loads(answer)["error"]


def test_request_is_passed_on_once_complete(rig):
    client = rig.connect(1000, REQUEST[:5])
    assert rig.started_stops == []
    client.sendall(REQUEST[5:])
    rig.serve_once()
    assert [request for request, _ in rig.started_stops] == [REQUEST]


@pytest.mark.parametrize("data", [b"", REQUEST[:5]], ids=["nothing", "half a request"])
def test_connection_without_a_request_is_ended_after_two_seconds(rig, data):
    client = rig.connect(1000, data)
    rig.serve_once(REQUEST_TIMEOUT_S)
    assert not is_refused(client)
    rig.serve_once(0.1)
    assert is_refused(client) and rig.started_stops == []


def test_requests_are_limited_per_user(rig):
    clients = [rig.connect(1000) for _ in range(CLIENT_COUNT)]
    assert sum(not is_refused(client) for client in clients) == MAX_REQUESTS_PER_USER
    rig.connect(2000, REQUEST)
    assert len(rig.started_stops) == 1


def test_running_stops_count_until_they_end(rig):
    for _ in range(MAX_REQUESTS_PER_USER):
        rig.connect(1000, REQUEST)
    assert is_refused(rig.connect(1000, REQUEST)) and len(rig.started_stops) == MAX_REQUESTS_PER_USER
    rig.started_stops[0][1].code = 0
    rig.connect(1000, REQUEST)
    assert len(rig.started_stops) == MAX_REQUESTS_PER_USER + 1


def test_total_number_of_requests_is_limited(rig):
    for uid in range(MAX_REQUESTS // MAX_REQUESTS_PER_USER + 1):
        for _ in range(MAX_REQUESTS_PER_USER):
            rig.connect(uid, REQUEST)
    assert len(rig.started_stops) == MAX_REQUESTS


def test_server_continues_a_second_after_it_ran_out_of_descriptors(rig, monkeypatch):
    class FullListener:
        def fileno(self):
            return rig.listener.fileno()

        def accept(self):
            raise OSError(24, "Too many open files")

    monkeypatch.setattr(rig.server, "_listener", FullListener())
    rig.connect(1000, REQUEST)
    monkeypatch.setattr(rig.server, "_listener", rig.listener)
    rig.serve_once(0.5)
    assert rig.started_stops == []
    rig.serve_once(0.6)
    rig.serve_once()
    assert len(rig.started_stops) == 1


def test_peer_is_identified_by_the_kernel():
    own_end, peer = socket.socketpair()
    with own_end, peer:
        assert read_peer_uid(own_end) == estop_server.struct.unpack("=iII", peer.getsockopt(1, 17, 12))[1]
