"""Socket of the agent: clients that send no requests, or incomplete ones."""

import errno
import logging
import os
import selectors
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers import messages as m
from drivers.agent import server as module
from drivers.agent.server import Server
from drivers.messages import AGENT_SOCKET

IDLE_CLIENT_COUNT = 40


class ServerRig:
    """A server on a selector, with a controlled clock."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 1000.0
        monkeypatch.setattr(module, "read_wall_s", lambda: self.now_s)
        self.selector = selectors.DefaultSelector()
        snapshot = m.Snapshot.model_construct()
        self.server = Server(folder, self.selector, lambda request: m.Reply(id=request.id), lambda: snapshot)
        self.path = str(folder / AGENT_SOCKET)
        self.clients: list[socket.socket] = []

    def connect(self, content: bytes = b"") -> socket.socket:
        client = socket.socket(socket.AF_UNIX)
        self.clients.append(client)
        client.connect(self.path)
        client.settimeout(5.0)
        self.run_once()
        client.sendall(content)
        self.run_once()
        return client

    def run_once(self) -> None:
        """Handle all pending events."""
        for _ in range(3):
            for key, mask in self.selector.select(0.0):
                handle_event: Callable[[int], None] = key.data
                handle_event(mask)


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ServerRig]:
    monkeypatch.setattr(module, "_encode_line", lambda message: b"{}\n")
    rig = ServerRig(tmp_path, monkeypatch)
    yield rig
    rig.server.close()
    for client in rig.clients:
        client.close()


def is_open(client: socket.socket) -> bool:
    client.setblocking(False)
    try:
        while data := client.recv(4096):
            assert data
    except BlockingIOError:
        return True
    except ConnectionResetError:
        pass
    return False


def test_idle_clients_are_limited_and_the_latest_requester_is_kept(rig: ServerRig):
    requester = rig.connect(b'{"do": "hello", "id": 1}\n')
    idle_clients = [rig.connect() for _ in range(IDLE_CLIENT_COUNT)]
    assert is_open(requester) and is_open(idle_clients[-1])
    assert sum(map(is_open, idle_clients)) == module._MAX_CLIENTS - 1


def test_incomplete_request_is_dropped_after_its_time_limit(rig: ServerRig):
    partial_client, complete_client, silent_client = (
        rig.connect(b'{"do": "he'),
        rig.connect(b'{"do": "hello", "id": 1}\n'),
        rig.connect(),
    )
    rig.now_s += 9.0
    partial_client.sendall(b"l")  # single bytes do not extend the time limit
    rig.run_once()
    rig.server.drop_stalled_clients()
    assert is_open(partial_client)
    rig.now_s += 2.0
    rig.server.drop_stalled_clients()
    assert not is_open(partial_client) and is_open(complete_client) and is_open(silent_client)


def test_loop_pauses_without_free_descriptors_and_continues_later(
    rig: ServerRig, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    class FullListener:
        def __init__(self, listener: socket.socket) -> None:
            self.listener, self.attempts = listener, 0

        def fileno(self) -> int:
            return self.listener.fileno()

        def accept(self) -> None:
            self.attempts += 1
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    listener = rig.server._listener
    full_listener = FullListener(listener)
    monkeypatch.setattr(rig.server, "_listener", full_listener)
    with caplog.at_level(logging.WARNING):
        waiting_client = rig.connect()
        assert full_listener.attempts == 1
        rig.now_s += 2.0
        rig.server.drop_stalled_clients()
        rig.run_once()
        assert full_listener.attempts == 2
    assert len(caplog.records) == 1
    monkeypatch.setattr(rig.server, "_listener", listener)
    rig.now_s += 2.0
    rig.server.drop_stalled_clients()
    rig.run_once()
    assert waiting_client.recv(16) == b"{}\n"
