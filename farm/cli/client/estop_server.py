"""The other end of `estop.sock`: hands each request to a process of its own, and nobody all of its places.

``python -m farm.cli.client.estop_server [OPTIONS]``, with the listening socket as stdin (farm-estop.service).
Options (`--state`, `--fleet`) are handed on. It imports nothing slow, as a crowd that connects must be turned
away faster than it comes. Python's own library alone: what stops printers must not wait for anything else.
"""

from __future__ import annotations

import json
import math
import selectors
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

REQUEST_S = 2.0  # wall seconds for the one line of a request to come
MOST, MOST_EACH = 64, 8  # requests at a time, and of one user
LONGEST = 1 << 16  # bytes of a request
_LOOK_S = 0.2
_PAUSE_S = 1.0  # without accepting, where no descriptor is left
_CREDENTIALS = struct.Struct("=iII")  # struct ucred: pid, uid, gid
_FULL = {
    "over": True,
    "error": "too many emergency stops at the same time: try again, or switch the printers off by hand",
}


class Work(Protocol):
    """A process that carries out a request."""

    def poll(self) -> int | None: ...


@dataclass(slots=True)
class _Asking:
    """A connection whose request has not come yet."""

    uid: int
    since_s: float
    said: bytes = b""


class EstopServer:
    """Connections, from their opening to the end of the stop that they ask for.

    Parameters
    ----------
    listening
        The socket to accept on.
    begin
        Starts the process that carries out a request and answers on its connection.
    uid_of
        Who is at the other end.
    """

    def __init__(
        self,
        listening: socket.socket,
        begin: Callable[[socket.socket, bytes], Work],
        uid_of: Callable[[socket.socket], int],
    ) -> None:
        listening.setblocking(False)
        self._listening, self._begin, self._uid_of = listening, begin, uid_of
        self._asking: dict[socket.socket, _Asking] = {}
        self._working: list[tuple[int, Work]] = []
        self._accepts_from_s = -math.inf

    def turn(self, now_s: float, wait_s: float) -> None:
        """Do what is there to be done; where there is nothing, wait so long for it at most."""
        with selectors.DefaultSelector() as ready:
            if now_s >= self._accepts_from_s:
                ready.register(self._listening, selectors.EVENT_READ)
            for one in self._asking:
                ready.register(one, selectors.EVENT_READ)
            found = [key.fileobj for key, _ in ready.select(wait_s)]
        self._working = [(uid, work) for uid, work in self._working if work.poll() is None]
        for one in tuple(self._asking):
            if one in found:
                self._read(one)
            if one in self._asking and now_s - self._asking[one].since_s > REQUEST_S:
                self._end(one)
        if self._listening in found:
            self._accept(now_s)

    def _accept(self, now_s: float) -> None:
        try:
            one, _ = self._listening.accept()
        except (BlockingIOError, ConnectionAbortedError):
            return
        except OSError:
            self._accepts_from_s = now_s + _PAUSE_S
            return
        one.setblocking(False)
        uid = self._uid_of(one)
        busy = [asking.uid for asking in self._asking.values()] + [uid for uid, _ in self._working]
        if len(busy) >= MOST or busy.count(uid) >= MOST_EACH:
            with one, suppress(OSError):
                one.send(json.dumps(_FULL).encode() + b"\n")
            return
        self._asking[one] = _Asking(uid, now_s)

    def _read(self, one: socket.socket) -> None:
        """Take what came of a request; have it carried out once it is whole."""
        asking = self._asking[one]
        try:
            data = one.recv(LONGEST)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        asking.said += data
        if b"\n" in asking.said and len(asking.said) <= LONGEST:
            one.setblocking(True)
            with suppress(OSError):
                self._working.append((asking.uid, self._begin(one, asking.said)))
        elif data and len(asking.said) < LONGEST:
            return
        self._end(one)

    def _end(self, one: socket.socket) -> None:
        del self._asking[one]
        one.close()


def peer_uid(connection: socket.socket) -> int:
    """The user at the other end of a Unix socket, by the kernel's word."""
    said = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    uid: int = _CREDENTIALS.unpack(said)[1]
    return uid


def _begin(connection: socket.socket, request: bytes) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", "farm.cli.main", "estop", "--asked", *sys.argv[1:]]
    work = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=connection.fileno(), start_new_session=True)
    assert work.stdin is not None
    with work.stdin as to, suppress(BrokenPipeError):
        to.write(request)  # a pipe has room for the longest
    return work


def main() -> None:
    """Serve until killed."""
    with socket.socket(fileno=0) as listening:
        server = EstopServer(listening, _begin, peer_uid)
        while True:
            server.turn(time.monotonic(), _LOOK_S)


if __name__ == "__main__":
    main()
