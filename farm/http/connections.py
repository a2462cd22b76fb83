"""Server with a limited number of connections, and a time limit for requests.

Idle clients must not prevent an agent from starting, so some file descriptors are reserved for agents,
workers and the database. When the limit is reached, a new connection replaces the connection that has waited
longest for its client.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import resource
import signal
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Protocol, cast

import uvicorn

log = logging.getLogger(__name__)

REQUEST_TIMEOUT_S = 10.0
"""Wall seconds for the head of a request, for each chunk of its body, and for reading the response."""
MAX_CONNECTIONS = 64
_MIN_CONNECTIONS = 4
_RESERVED_DESCRIPTORS = 32  # descriptors for database, socket, timers, log, and the start of an agent
_MAX_HANDSHAKES = 64
_DESCRIPTORS_PER_DEVICE, _DESCRIPTORS_PER_WORKER = 3, 3
_DESCRIPTORS_PER_CONNECTION = 2  # the connection and the file of an upload
_CHECK_INTERVAL_S = 1.0
_RETRY_INTERVAL_S = 0.1
_LOG_INTERVAL_S = 60.0
_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class WaitingConnection(Protocol):
    """Connection that may wait for its client to send the rest of a request or to read the response."""

    transport: asyncio.Transport

    @property
    def waiting_since_s(self) -> float | None:
        """Time at which the connection began to wait, on the event loop's clock; None if it does not wait."""


def compute_connection_limit(descriptor_limit: int, device_count: int, worker_count: int) -> int:
    """Return the number of connections that leaves enough descriptors for agents and workers.

    Parameters
    ----------
    descriptor_limit
        Soft limit on the descriptors of this process (RLIMIT_NOFILE).
    device_count, worker_count
        Number of printers and cameras, and number of workers.
    """
    reserved_descriptors = (
        _RESERVED_DESCRIPTORS
        + _DESCRIPTORS_PER_DEVICE * device_count
        + _DESCRIPTORS_PER_WORKER * worker_count
    )
    return max(
        _MIN_CONNECTIONS,
        min(MAX_CONNECTIONS, (descriptor_limit - reserved_descriptors) // _DESCRIPTORS_PER_CONNECTION),
    )


def read_descriptor_limit() -> int:
    """Return the number of descriptors that this process may have open."""
    soft_limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return 2**20 if soft_limit == resource.RLIM_INFINITY else soft_limit


def find_overdue_connections(
    connections: Iterable[WaitingConnection], now_s: float
) -> list[WaitingConnection]:
    """Return the connections that have waited too long for their clients."""
    return [
        connection
        for connection in connections
        if (since_s := connection.waiting_since_s) is not None and now_s - since_s > REQUEST_TIMEOUT_S
    ]


def find_longest_waiting_connection(connections: Iterable[WaitingConnection]) -> WaitingConnection | None:
    """Return the connection that has waited longest for its client; None if none waits."""
    waiting_connections = [connection for connection in connections if connection.waiting_since_s is not None]
    return min(waiting_connections, key=lambda connection: connection.waiting_since_s or 0.0, default=None)


class RateLimitedLog:
    """Log of a repeated error: at most one line a minute, with the number of occurrences."""

    def __init__(self) -> None:
        self._next_line_s = -math.inf
        self._suppressed_count = 0

    def warn(self, text: str, now_s: float) -> None:
        """Count an error, and log it unless a line was logged less than a minute ago."""
        self._suppressed_count += 1
        if now_s >= self._next_line_s:
            log.warning("%s (%d times)", text, self._suppressed_count)
            self._next_line_s, self._suppressed_count = now_s + _LOG_INTERVAL_S, 0


@contextlib.contextmanager
def stop_on_signals(server: uvicorn.Server) -> Iterator[None]:
    """Stop a server on SIGINT and SIGTERM, without ending the process."""
    loop = asyncio.get_running_loop()
    for number in _STOP_SIGNALS:
        loop.add_signal_handler(number, server.handle_exit, number, None)
    try:
        yield
    finally:
        for number in _STOP_SIGNALS:
            loop.remove_signal_handler(number)


class BoundedServer(uvicorn.Server):
    """Server on one socket that takes a limited number of connections at a time.

    The server accepts connections itself, because asyncio's servers accept without a limit, and log every
    error when descriptors run out.

    Parameters
    ----------
    config
        uvicorn's configuration.
    limit
        Maximum number of connections at a time.
    stop_work
        Function that ends the tasks for which open requests wait; the server then waits for these requests.
    """

    def __init__(
        self, config: uvicorn.Config, limit: int, stop_work: Callable[[], None] = lambda: None
    ) -> None:
        super().__init__(config)
        self._limit, self._stop_work = limit, stop_work
        self._tasks: list[asyncio.Task[None]] = []
        self._handshakes: dict[asyncio.Task[None], socket.socket] = {}  # TLS handshakes, the oldest first
        self._rate_limited_log = RateLimitedLog()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Do nothing: `stop_on_signals` handles signals.

        After a server has ended, uvicorn's own method raises the signal again. That would end the process
        before the workers are ended and the database is closed. Besides, this process has several servers.
        """
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets=[])
        for listener in sockets or ():
            self._tasks.append(asyncio.create_task(self._accept_connections(listener)))
        self._tasks.append(asyncio.create_task(self._close_overdue_connections()))

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        tasks = [*self._tasks, *self._handshakes]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._stop_work()
        await super().shutdown(sockets)

    @property
    def connections(self) -> set[WaitingConnection]:
        """Open connections."""
        return cast(set[WaitingConnection], self.server_state.connections)

    def _make_protocol(self) -> asyncio.Protocol:
        protocol_class = cast(type, self.config.http_protocol_class)
        protocol: asyncio.Protocol = protocol_class(
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )
        return protocol

    async def _accept_connections(self, listener: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                connection, _ = await loop.sock_accept(listener)
            except Exception as error:  # the only task that accepts connections must not end
                self._rate_limited_log.warn(f"no connection can be accepted: {error!r}", loop.time())
                await asyncio.sleep(_CHECK_INTERVAL_S)
                continue
            if self.config.ssl is None:
                await self._connect_client(connection)
            else:
                self._begin_handshake(connection)

    def _begin_handshake(self, connection: socket.socket) -> None:
        """Connect a client in a separate task, because a client may delay its TLS handshake.

        If too many handshakes are open, the oldest is abandoned.
        """
        oldest = self.find_handshake_to_abandon(self._handshakes, connection)
        if oldest is not None:
            oldest.cancel()
        task = asyncio.create_task(self._connect_client(connection))
        self._handshakes[task] = connection
        task.add_done_callback(lambda handshake: self._handshakes.pop(handshake, None))

    def find_handshake_to_abandon(
        self, handshakes: Mapping[asyncio.Task[None], socket.socket], connection: socket.socket
    ) -> asyncio.Task[None] | None:
        """Return the handshake to abandon for a new connection; None if none needs to be abandoned.

        Parameters
        ----------
        handshakes
            Open handshakes, the oldest first.
        connection
            The new connection.
        """
        return next(iter(handshakes)) if len(handshakes) >= _MAX_HANDSHAKES else None

    async def _connect_client(self, connection: socket.socket) -> None:
        loop, tls = asyncio.get_running_loop(), self.config.ssl
        try:
            await self.make_room(connection)
            await loop.connect_accepted_socket(
                self._make_protocol,
                connection,
                ssl=tls,
                ssl_handshake_timeout=REQUEST_TIMEOUT_S if tls else None,
            )
        except asyncio.CancelledError:
            connection.close()
            raise
        except Exception as error:
            connection.close()
            if not isinstance(error, OSError):  # OSError: the client has disconnected
                self._rate_limited_log.warn(f"a connection was refused: {error!r}", loop.time())

    async def make_room(self, connection: socket.socket) -> None:
        """Wait until the limit allows a new connection; close the connection that has waited longest.

        Raises
        ------
        RefusedError
            If the new connection must be closed.
        """
        while len(self.connections) >= self._limit:
            waiting_connection = find_longest_waiting_connection(self.connections)
            if waiting_connection is not None:
                waiting_connection.transport.abort()
                self._rate_limited_log.warn(
                    "too many connections: the one that waited longest for its client was closed",
                    self._read_clock_s(),
                )
            await asyncio.sleep(0.0 if waiting_connection is not None else _RETRY_INTERVAL_S)

    async def _close_overdue_connections(self) -> None:
        while True:
            for connection in find_overdue_connections(self.connections, self._read_clock_s()):
                connection.transport.abort()
            await asyncio.sleep(_CHECK_INTERVAL_S)

    @staticmethod
    def _read_clock_s() -> float:
        return asyncio.get_running_loop().time()
