"""Server of `estop.sock`: starts a process for each request, with a limit for each user.

``python -m farm.cli.estop_server [OPTIONS]``, with the listening socket as stdin (farm-estop.service).
The options (`--state`, `--fleet`) are passed on to these processes. This module imports only the standard
library, so that it starts quickly and can refuse connections faster than clients can open them.
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

REQUEST_TIMEOUT_S = 2.0  # wall seconds within which the line of a request must arrive
MAX_REQUESTS, MAX_REQUESTS_PER_USER = 64, 8  # simultaneous requests
MAX_REQUEST_BYTES = 1 << 16
_MAX_WAIT_S = 0.2
_ACCEPT_PAUSE_S = 1.0  # pause after an error of `accept`, such as a lack of descriptors
_CREDENTIALS = struct.Struct("=iII")  # struct ucred: pid, uid, gid
_OVERLOAD_RESPONSE = {
    "over": True,
    "error": "too many emergency stops at the same time: try again, or switch the printers off by hand",
}


class RequestProcess(Protocol):
    """Process that serves a request."""

    def poll(self) -> int | None: ...


@dataclass(slots=True)
class _PendingConnection:
    """Connection whose request has not arrived yet."""

    uid: int
    accepted_s: float
    received_bytes: bytes = b""


class EstopServer:
    """Server that limits the number of requests, counting each until the process that serves it has ended.

    Parameters
    ----------
    listener
        Socket on which connections are accepted.
    start_process
        Function that starts the process that serves a request and responds on its connection.
    read_uid
        Function that returns the id of the user at the other end of a connection.
    """

    def __init__(
        self,
        listener: socket.socket,
        start_process: Callable[[socket.socket, bytes], RequestProcess],
        read_uid: Callable[[socket.socket], int],
    ) -> None:
        listener.setblocking(False)
        self._listener, self._start_process, self._read_uid = listener, start_process, read_uid
        self._pending_connections: dict[socket.socket, _PendingConnection] = {}
        self._running_requests: list[tuple[int, RequestProcess]] = []
        self._next_accept_s = -math.inf

    def serve_once(self, now_s: float, wait_s: float) -> None:
        """Handle pending connections and requests; wait at most `wait_s` for a connection."""
        with selectors.DefaultSelector() as selector:
            if now_s >= self._next_accept_s:
                selector.register(self._listener, selectors.EVENT_READ)
            for connection in self._pending_connections:
                selector.register(connection, selectors.EVENT_READ)
            ready_sockets = [key.fileobj for key, _ in selector.select(wait_s)]
        self._running_requests = [
            (uid, process) for uid, process in self._running_requests if process.poll() is None
        ]
        for connection in tuple(self._pending_connections):
            if connection in ready_sockets:
                self._read_request(connection)
            if (
                connection in self._pending_connections
                and now_s - self._pending_connections[connection].accepted_s > REQUEST_TIMEOUT_S
            ):
                self._end_connection(connection)
        if self._listener in ready_sockets:
            self._accept_connection(now_s)

    def _accept_connection(self, now_s: float) -> None:
        try:
            connection, _ = self._listener.accept()
        except (BlockingIOError, ConnectionAbortedError):
            return
        except OSError:
            self._next_accept_s = now_s + _ACCEPT_PAUSE_S
            return
        connection.setblocking(False)
        uid = self._read_uid(connection)
        busy_uids = [request.uid for request in self._pending_connections.values()] + [
            uid for uid, _ in self._running_requests
        ]
        if len(busy_uids) >= MAX_REQUESTS or busy_uids.count(uid) >= MAX_REQUESTS_PER_USER:
            with connection, suppress(OSError):
                connection.send(json.dumps(_OVERLOAD_RESPONSE).encode() + b"\n")
            return
        self._pending_connections[connection] = _PendingConnection(uid, now_s)

    def _read_request(self, connection: socket.socket) -> None:
        """Read more of a request; once the request is complete, start a process for it."""
        request = self._pending_connections[connection]
        try:
            data = connection.recv(MAX_REQUEST_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        request.received_bytes += data
        if b"\n" in request.received_bytes and len(request.received_bytes) <= MAX_REQUEST_BYTES:
            connection.setblocking(True)
            with suppress(OSError):
                self._running_requests.append(
                    (request.uid, self._start_process(connection, request.received_bytes))
                )
        elif data and len(request.received_bytes) < MAX_REQUEST_BYTES:
            return
        self._end_connection(connection)

    def _end_connection(self, connection: socket.socket) -> None:
        del self._pending_connections[connection]
        connection.close()


def read_peer_uid(connection: socket.socket) -> int:
    """Return the user id of the peer of a Unix socket (SO_PEERCRED)."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    uid: int = _CREDENTIALS.unpack(credentials)[1]
    return uid


def _start_process(connection: socket.socket, request: bytes) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "farm.cli.main", "estop", "--asked", *sys.argv[1:]]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=connection.fileno(), start_new_session=True
    )
    assert process.stdin is not None
    with process.stdin as stdin, suppress(BrokenPipeError):
        stdin.write(request)  # a pipe can buffer the longest request
    return process


def main() -> None:
    """Serve requests until the process is killed."""
    with socket.socket(fileno=0) as listener:
        server = EstopServer(listener, _start_process, read_peer_uid)
        while True:
            server.serve_once(time.monotonic(), _MAX_WAIT_S)


if __name__ == "__main__":
    main()
