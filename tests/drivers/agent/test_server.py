"""The agent's socket: clients that ask for nothing, or never end what they ask."""

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

MANY = 40


class Desk:
    """A server on a selector, with time in hand."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 1000.0
        monkeypatch.setattr(module, "wall_s", lambda: self.now_s)
        self.selector = selectors.DefaultSelector()
        snapshot = m.Snapshot.model_construct()
        self.server = Server(folder, self.selector, lambda request: m.Reply(id=request.id), lambda: snapshot)
        self.path = str(folder / AGENT_SOCKET)
        self.clients: list[socket.socket] = []

    def client(self, said: bytes = b"") -> socket.socket:
        one = socket.socket(socket.AF_UNIX)
        self.clients.append(one)
        one.connect(self.path)
        one.settimeout(5.0)
        self.turn()
        one.sendall(said)
        self.turn()
        return one

    def turn(self) -> None:
        """Do what is there to be done."""
        for _ in range(3):
            for key, mask in self.selector.select(0.0):
                work: Callable[[int], None] = key.data
                work(mask)


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    monkeypatch.setattr(module, "_line", lambda message: b"{}\n")
    desk = Desk(tmp_path, monkeypatch)
    yield desk
    desk.server.close()
    for one in desk.clients:
        one.close()


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


def test_of_many_idle_clients_only_some_are_kept_and_one_that_asked_is_among_them(desk: Desk):
    asks = desk.client(b'{"do": "hello", "id": 1}\n')
    idle = [desk.client() for _ in range(MANY)]
    assert is_open(asks) and is_open(idle[-1])
    assert sum(map(is_open, idle)) == module._MAX_CLIENTS - 1


def test_half_a_request_is_ended_after_its_time_and_a_whole_or_no_request_is_not(desk: Desk):
    half, whole, none = desk.client(b'{"do": "he'), desk.client(b'{"do": "hello", "id": 1}\n'), desk.client()
    desk.now_s += 9.0
    half.sendall(b"l")  # a byte now and then is no more time
    desk.turn()
    desk.server.end_stalled()
    assert is_open(half)
    desk.now_s += 2.0
    desk.server.end_stalled()
    assert not is_open(half) and is_open(whole) and is_open(none)


def test_where_no_descriptor_is_left_the_loop_does_not_spin_and_goes_on_later(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    class Full:
        def __init__(self, listener: socket.socket) -> None:
            self.listener, self.tries = listener, 0

        def fileno(self) -> int:
            return self.listener.fileno()

        def accept(self) -> None:
            self.tries += 1
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    listener = desk.server._listener
    full = Full(listener)
    monkeypatch.setattr(desk.server, "_listener", full)
    with caplog.at_level(logging.WARNING):
        waiting = desk.client()
        assert full.tries == 1
        desk.now_s += 2.0
        desk.server.end_stalled()
        desk.turn()
        assert full.tries == 2
    assert len(caplog.records) == 1
    monkeypatch.setattr(desk.server, "_listener", listener)
    desk.now_s += 2.0
    desk.server.end_stalled()
    desk.turn()
    assert waiting.recv(16) == b"{}\n"
