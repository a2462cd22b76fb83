"""Server for callers on the network, in addition to the server on the Unix socket."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable
from contextlib import suppress
from urllib.parse import urlsplit

import uvicorn
from starlette.types import ASGIApp

from drivers.clock import Clock
from farm.config import WebSection
from farm.http import NetworkState, PeerProtocol
from farm.state import Books
from farm.web.address_limit import AddressLimitedServer
from farm.web.request_checks import MAX_HEAD_BYTES

log = logging.getLogger(__name__)

_KEY_CHECK_INTERVAL_S = 1.0  # time between two checks for a valid key
_RETRY_INTERVAL_S = 10.0  # time between two attempts to listen
_BACKLOG = 128
_GRACE_PERIOD_S = 3  # time for open requests to finish when the daemon ends


class NetworkServer:
    """Server for callers on the network. It begins to listen as soon as it may, and stops when it is closed.

    While there is no valid key, it may listen only on a loopback address. If the address is in use or the
    certificate cannot be read, it reports the problem in `state` and tries again, while prints continue.

    Parameters
    ----------
    section
        Section `web` of fleet.yaml.
    app
        The application.
    limit
        Maximum number of open connections.
    state
        State in which the server records its address, and the reason why it does not listen.
    """

    def __init__(self, section: WebSection, app: ASGIApp, limit: int, state: NetworkState) -> None:
        self._section, self._limit, self._state = section, limit, state
        tls = section.tls
        self._config = uvicorn.Config(
            app,
            http=PeerProtocol,
            ws="none",
            log_config=None,
            access_log=False,
            lifespan="off",
            proxy_headers=False,
            server_header=False,
            h11_max_incomplete_event_size=MAX_HEAD_BYTES,
            timeout_graceful_shutdown=_GRACE_PERIOD_S,
            ssl_certfile=None if tls is None else tls.cert,
            ssl_keyfile=None if tls is None else tls.key,
        )
        self._server: AddressLimitedServer | None = None
        self._task: asyncio.Task[None] | None = None
        state.address, state.browser_url = section.listen_url, section.find_browser_url(socket.gethostname())

    def start(self, has_key: Callable[[], bool]) -> None:
        """Start a task that serves requests; `has_key` returns whether a valid key exists."""
        self._task = asyncio.get_running_loop().create_task(self._serve(has_key))

    async def close(self) -> None:
        """End the server; wait at most a few seconds for open requests."""
        if self._task is None:
            return
        if self._server is None:
            self._task.cancel()
        else:
            self._server.should_exit = True
        with suppress(asyncio.CancelledError):
            await self._task

    async def _serve(self, has_key: Callable[[], bool]) -> None:
        """Serve requests. An error ends only this server; prints and the Unix socket's server continue."""
        try:
            await self._serve_when_allowed(has_key)
        except Exception as error:
            log.exception("the server for the network failed on %s", self._section.listen_url)
            self._state.problem = f"it failed ({error!r}): see the daemon's log, then restart the daemon"

    async def _serve_when_allowed(self, has_key: Callable[[], bool]) -> None:
        while not self._section.is_local and not has_key():
            self._report_problem("there is no key yet: add one with `farm key add NAME`")
            await asyncio.sleep(_KEY_CHECK_INTERVAL_S)
        while True:
            try:
                listener = self._open_socket()
                break
            except OSError as error:
                self._report_problem(error.strerror or str(error))
                await asyncio.sleep(_RETRY_INTERVAL_S)
        self._report_problem(None)
        self._server = AddressLimitedServer(self._config, self._limit)
        with listener:
            await self._server.serve(sockets=[listener])

    def _open_socket(self) -> socket.socket:
        """Load the certificate and open the socket. Raises OSError."""
        tls = self._section.tls
        if not self._config.loaded:
            try:
                self._config.load()
            except (OSError, ValueError) as error:
                pair = "" if tls is None else f" {tls.cert} with the key {tls.key}"
                raise OSError(f"the certificate{pair} cannot be used ({error})") from error
        host, port = self._section.address
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                with suppress(OSError):
                    listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, int(host != "::"))
            listener.bind((host, port))
            listener.listen(_BACKLOG)
            listener.setblocking(False)
        except OSError:
            listener.close()
            raise
        return listener

    def _report_problem(self, problem: str | None) -> None:
        if problem is None:
            log.info("listening on %s", self._section.listen_url)
        elif problem != self._state.problem:
            log.warning("not listening on %s: %s", self._section.listen_url, problem)
        self._state.problem = problem


def find_host_names(section: WebSection) -> frozenset[str]:
    """Return the names of this host, with and without `.local`, and those in fleet.yaml, in lower case."""
    name = socket.gethostname().lower()
    names = {name, name.partition(".")[0], f"{name.partition('.')[0]}.local"}
    url_host = urlsplit(section.url or "").hostname
    return frozenset({*names, *section.names, *([url_host] if url_host else [])})


def has_valid_key(books: Books, clock: Clock) -> bool:
    """Return whether any key is valid now."""
    now_s = clock.now()
    return any(key.is_valid(now_s) for key in books.keys.values())
