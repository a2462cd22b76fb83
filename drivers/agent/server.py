"""Socket of an agent, which receives requests and sends replies and snapshots as one JSON object per line."""

from __future__ import annotations

import logging
import math
import os
import selectors
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path

from pydantic import ValidationError

from drivers.clock import read_wall_s
from drivers.messages import AGENT_SOCKET, FromAgent, Reply, Request, Snapshot, request_adapter

log = logging.getLogger(__name__)

_MAX_REQUEST_BYTES = 64 * 1024
_MAX_CLIENTS = 16  # the daemon, a bridge and a few users; each takes a descriptor
_REQUEST_TIMEOUT_S = 10.0  # wall seconds between the first and the last byte of a request
_ACCEPT_PAUSE_S = 1.0  # wall seconds for which no client is accepted after the descriptors have run out
_LOG_INTERVAL_S = 60.0  # wall seconds between two warnings
_MAX_BACKLOG_BYTES = 1024 * 1024  # a client that reads too slowly is dropped; it can reconnect


class _Client:
    """Connection of one client."""

    __slots__ = ("incoming_bytes", "last_request_s", "outgoing_bytes", "partial_since_s", "socket")

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self.last_request_s = -math.inf  # time of its last request
        self.partial_since_s = math.inf  # arrival time of an incomplete request
        self.incoming_bytes = b""
        self.outgoing_bytes = b""


class Server:
    """Server for the clients of one agent, on the agent's selector.

    Parameters
    ----------
    folder
        Folder for `agent.sock`, which only the agent's user can access. The path may exceed 107 bytes.
    selector
        The agent's selector; the data of its keys is a callable that takes the ready mask.
    answer
        Function that answers a request.
    make_snapshot
        Function that makes the first message for a new client.
    """

    def __init__(
        self,
        folder: Path,
        selector: selectors.BaseSelector,
        answer: Callable[[Request], Reply],
        make_snapshot: Callable[[], Snapshot],
    ) -> None:
        self._selector = selector
        self._answer = answer
        self._make_snapshot = make_snapshot
        self._clients: dict[_Client, None] = {}  # in order of arrival
        self._is_listening = False
        self._paused_until_s = self._next_warning_s = -math.inf
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        (folder / AGENT_SOCKET).unlink(missing_ok=True)  # unused, as the agent holds the folder's lock
        descriptor = os.open(folder, os.O_PATH | os.O_DIRECTORY)
        old_mask = os.umask(0o177)
        try:
            self._listener.bind(f"/proc/self/fd/{descriptor}/{AGENT_SOCKET}")
        finally:
            os.umask(old_mask)
            os.close(descriptor)
        self._listener.listen()
        self._listener.setblocking(False)
        self._set_listening(True)

    def push(self, snapshot: Snapshot) -> None:
        """Send a snapshot to every client."""
        line = _encode_line(snapshot)
        for client in tuple(self._clients):
            self._send_bytes(client, line)

    def drop_stalled_clients(self) -> None:
        """Drop clients whose request has been incomplete for 10 s, and accept clients again after a pause.

        Call it every few seconds.
        """
        now_s = read_wall_s()
        for client in tuple(self._clients):
            if now_s - client.partial_since_s > _REQUEST_TIMEOUT_S:
                self._drop_client(client)
        self._set_listening(now_s >= self._paused_until_s)

    def close(self) -> None:
        """Drop all clients, and stop listening."""
        for client in tuple(self._clients):
            self._drop_client(client)
        self._set_listening(False)
        self._listener.close()

    def _set_listening(self, is_enabled: bool) -> None:
        """Start or stop accepting new clients."""
        if is_enabled and not self._is_listening:
            self._selector.register(self._listener, selectors.EVENT_READ, self._accept_client)
        elif self._is_listening and not is_enabled:
            self._selector.unregister(self._listener)
        self._is_listening = is_enabled

    def _accept_client(self, _: int) -> None:
        now_s = read_wall_s()
        try:
            connection, _address = self._listener.accept()
        except (BlockingIOError, ConnectionAbortedError):
            return  # the client has disconnected already
        except OSError as error:  # no free descriptor: pause, as the loop would spin otherwise
            self._paused_until_s = now_s + _ACCEPT_PAUSE_S
            self._set_listening(False)
            if now_s >= self._next_warning_s:
                self._next_warning_s = now_s + _LOG_INTERVAL_S
                log.warning("cannot accept a client: %s", error)
            return
        if len(self._clients) >= _MAX_CLIENTS:  # a live client that is dropped will reconnect
            self._drop_client(min(self._clients, key=lambda client: client.last_request_s))
        connection.setblocking(False)
        client = _Client(connection)
        self._clients[client] = None
        self._selector.register(connection, selectors.EVENT_READ, partial(self._serve_client, client))
        self._send_bytes(client, _encode_line(self._make_snapshot()))

    def _serve_client(self, client: _Client, mask: int) -> None:
        if mask & selectors.EVENT_WRITE:
            self._send_bytes(client, b"")
        if mask & selectors.EVENT_READ and client in self._clients:
            self._read_requests(client)

    def _read_requests(self, client: _Client) -> None:
        try:
            data = client.socket.recv(_MAX_REQUEST_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        *lines, client.incoming_bytes = (client.incoming_bytes + data).split(b"\n")
        if not data or len(client.incoming_bytes) > _MAX_REQUEST_BYTES:
            self._drop_client(client)
            return
        now_s = read_wall_s()
        if lines or not client.incoming_bytes:
            client.partial_since_s = math.inf
        if client.incoming_bytes:
            client.partial_since_s = min(client.partial_since_s, now_s)
        if lines:
            client.last_request_s = now_s
        for line in lines:
            try:
                request = request_adapter.validate_json(line)
            except ValidationError as error:
                log.warning("a client sent an invalid request: %s", error.errors()[0]["msg"])
                self._drop_client(client)
                return
            self._send_bytes(client, _encode_line(self._answer(request)))

    def _send_bytes(self, client: _Client, data: bytes) -> None:
        if client not in self._clients:
            return
        client.outgoing_bytes += data
        try:
            client.outgoing_bytes = client.outgoing_bytes[client.socket.send(client.outgoing_bytes) :]
        except BlockingIOError:
            pass
        except OSError:
            self._drop_client(client)
            return
        if len(client.outgoing_bytes) > _MAX_BACKLOG_BYTES:
            self._drop_client(client)
            return
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.outgoing_bytes else 0)
        key = self._selector.get_key(client.socket)
        if key.events != events:
            self._selector.modify(client.socket, events, key.data)

    def _drop_client(self, client: _Client) -> None:
        if client in self._clients:
            del self._clients[client]
            self._selector.unregister(client.socket)
            client.socket.close()


def _encode_line(message: FromAgent) -> bytes:
    return message.model_dump_json().encode() + b"\n"
