"""Socket of the agent: clients without requests, or with incomplete ones."""

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

IDLE_CLIENTS = 40


class ServerBench:
    """A server on a selector, with a controlled clock."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 1000.0
        monkeypatch.setattr(module, "read_wall_s", lambda: self.now_s)
        self.selector = selectors.DefaultSelector()
        snapshot = m.Snapshot.model_construct()
        self.server = Server(folder, self.selector, lambda request: m.Reply(id=request.id), lambda: snapshot)
        self.path = str(folder / AGENT_SOCKET)
        self.clients: list[socket.socket] = []

    def client(self, content: bytes = b"") -> socket.socket:
        printer = socket.socket(socket.AF_UNIX)
        self.clients.append(printer)
        printer.connect(self.path)
        printer.settimeout(5.0)
        self.run_once()
        printer.sendall(content)
        self.run_once()
        return printer

    def run_once(self) -> None:
        """Handle all pending events."""
        for _ in range(3):
            for key, mask in self.selector.select(0.0):
                work: Callable[[int], None] = key.data
                work(mask)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ServerBench]:
    monkeypatch.setattr(module, "_encode_line", lambda message: b"{}\n")
    bench = ServerBench(tmp_path, monkeypatch)
    yield bench
    bench.server.close()
    for client in bench.clients:
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


def test_idle_clients_are_limited_and_the_latest_requester_is_kept(bench: ServerBench):
    requester = bench.client(b'{"do": "hello", "id": 1}\n')
    idle = [bench.client() for _ in range(IDLE_CLIENTS)]
    assert is_open(requester) and is_open(idle[-1])
    assert sum(map(is_open, idle)) == module._MAX_CLIENTS - 1


def test_incomplete_request_is_dropped_after_its_time_limit(bench: ServerBench):
    half_client, whole_client, silent_client = (
        bench.client(b'{"do": "he'),
        bench.client(b'{"do": "hello", "id": 1}\n'),
        bench.client(),
    )
    bench.now_s += 9.0
    half_client.sendall(b"l")  # single bytes do not extend the time limit
    bench.run_once()
    bench.server.drop_stalled_clients()
    assert is_open(half_client)
    bench.now_s += 2.0
    bench.server.drop_stalled_clients()
    assert not is_open(half_client) and is_open(whole_client) and is_open(silent_client)


def test_loop_pauses_without_free_descriptors_and_continues_later(
    bench: ServerBench, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    class FullListener:
        def __init__(self, listener: socket.socket) -> None:
            self.listener, self.tries = listener, 0

        def fileno(self) -> int:
            return self.listener.fileno()

        def accept(self) -> None:
            self.tries += 1
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    listener = bench.server._listener
    full_listener = FullListener(listener)
    monkeypatch.setattr(bench.server, "_listener", full_listener)
    with caplog.at_level(logging.WARNING):
        waiting_client = bench.client()
        assert full_listener.tries == 1
        bench.now_s += 2.0
        bench.server.drop_stalled_clients()
        bench.run_once()
        assert full_listener.tries == 2
    assert len(caplog.records) == 1
    monkeypatch.setattr(bench.server, "_listener", listener)
    bench.now_s += 2.0
    bench.server.drop_stalled_clients()
    bench.run_once()
    assert waiting_client.recv(16) == b"{}\n"
