"""Limits on connections by address, on handshakes, and on the heads of requests."""

import asyncio
import socket
from contextlib import ExitStack, closing

import pytest
import uvicorn
from hypothesis import given
from hypothesis import strategies as st

from farm.http import PeerProtocol
from farm.web import address_limit
from farm.web.address_limit import AddressLimitedServer, find_client_network
from farm.web.request_checks import MAX_HEAD_BYTES, check_head

INCOMPLETE_REQUEST = b"GET / HTTP/1.1\r\nHost: farm\r\n"
COMPLETE_REQUEST = INCOMPLETE_REQUEST + b"Connection: close\r\n\r\n"
SLOW_REQUEST = INCOMPLETE_REQUEST + b"X-Slow: yes\r\n\r\n"


@pytest.mark.parametrize(
    ("host", "client"),
    [
        ("10.0.0.9", "10.0.0.9"),
        ("127.0.0.1", None),
        ("::1", None),
        ("::ffff:127.0.0.1", None),
        ("::ffff:10.0.0.9", "10.0.0.9"),
        ("2001:db8:1:2:3::4", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("nobody", "nobody"),
    ],
)
def test_client_is_counted_by_its_address_or_network(host, client):
    assert find_client_network(host) == client


@given(st.ip_addresses())
def test_network_address_of_a_group_belongs_to_the_group(address):
    group = find_client_network(str(address))
    assert group is None or find_client_network(group.partition("/")[0]) == group


async def answer_request(scope, receive, send):
    """Answer immediately, or never if the request says so."""
    if (b"x-slow", b"yes") in scope["headers"]:
        await asyncio.Event().wait()
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"well"})


def run_with_server(run_scenario, limit=16):
    """Run a scenario with a server on loopback, whose addresses 127.0.0.X are separate clients here."""

    async def run():
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            listener.listen(64)
            listener.setblocking(False)
            config = uvicorn.Config(
                answer_request,
                http=PeerProtocol,
                log_config=None,
                lifespan="off",
                timeout_graceful_shutdown=0,
            )
            server = AddressLimitedServer(config, limit)
            serve_task = asyncio.create_task(server.serve([listener]))
            try:
                async with asyncio.timeout(30.0):
                    await run_scenario(server, listener.getsockname())
            finally:
                server.should_exit = True
                await serve_task

    asyncio.run(run())


@pytest.fixture(autouse=True)
def loopback_clients(monkeypatch):
    monkeypatch.setattr(address_limit, "find_client_network", lambda host: host)


async def connect_client(address, host, sent_bytes=b""):
    reader, writer = await asyncio.open_connection(*address, local_addr=(host, 0))
    writer.write(sent_bytes)
    return reader, writer


async def wait_until(condition):
    while not condition():
        await asyncio.sleep(0.0)


def test_idle_connections_are_closed_only_in_favour_of_the_same_client():
    async def run_scenario(server, address):
        other_client = await connect_client(address, "127.0.0.2", INCOMPLETE_REQUEST)
        await wait_until(lambda: len(server.connections) == 1)
        flood = [await connect_client(address, "127.0.0.1", INCOMPLETE_REQUEST) for _ in range(40)]
        reader, writer = await connect_client(address, "127.0.0.1", COMPLETE_REQUEST)
        assert b"well" in await reader.read()
        assert len(server._list_connections("127.0.0.1")) <= 4
        # This connection was not closed in favour of the others.
        other_client[1].write(b"Connection: close\r\n\r\n")
        assert b"well" in await other_client[0].read()
        for _, connection in (*flood, (reader, writer), other_client):
            connection.close()

    run_with_server(run_scenario)


def test_client_with_too_many_open_requests_gets_no_connection_and_others_do():
    async def run_scenario(server, address):
        busy_clients = [await connect_client(address, "127.0.0.1", SLOW_REQUEST) for _ in range(4)]
        await wait_until(
            lambda: sum(connection.waiting_since_s is None for connection in server.connections) == 4
        )
        reader, refused_writer = await connect_client(address, "127.0.0.1")
        assert await reader.read() == b""
        reader, writer = await connect_client(address, "127.0.0.2", COMPLETE_REQUEST)
        assert b"well" in await reader.read()
        assert len(server._list_connections("127.0.0.1")) == 4
        for _, connection in (*busy_clients, (reader, writer), (reader, refused_writer)):
            connection.close()

    run_with_server(run_scenario)


def test_oldest_handshake_of_a_client_with_too_many_is_abandoned():
    config = uvicorn.Config(answer_request, http=PeerProtocol, log_config=None, lifespan="off")
    server = AddressLimitedServer(config, 16)
    with ExitStack() as stack:
        listener = stack.enter_context(closing(socket.create_server(("127.0.0.1", 0))))

        def accept_from(host):
            stack.enter_context(closing(socket.create_connection(listener.getsockname(), 30, (host, 0))))
            return stack.enter_context(closing(listener.accept()[0]))

        handshakes = {"other": accept_from("127.0.0.2")}
        handshakes |= {number: accept_from("127.0.0.1") for number in range(4)}
        assert server.find_handshake_to_abandon(handshakes, accept_from("127.0.0.1")) == 0
        assert server.find_handshake_to_abandon(handshakes, accept_from("127.0.0.2")) is None
        handshakes |= {f"client {number}": accept_from(f"127.0.1.{number}") for number in range(60)}
        assert server.find_handshake_to_abandon(handshakes, accept_from("127.0.0.3")) == "other"


def test_long_head_is_refused():
    long_headers = [(b"cookie", b"x" * MAX_HEAD_BYTES)]
    assert check_head(b"/", long_headers).status == 431
    assert check_head(b"/" * (MAX_HEAD_BYTES + 1), []).status == 431
    assert check_head(b"/", [(b"x", b"y")] * MAX_HEAD_BYTES).status == 431
    assert check_head(b"/", [(b"cookie", b"x" * 8000)]) is None
