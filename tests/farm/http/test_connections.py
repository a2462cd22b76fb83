"""Limits on connections: idle clients do not affect others."""

import asyncio
import errno
import json
import logging
import os
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack, closing
from dataclasses import dataclass

import pytest
import uvicorn

from farm.http import BoundedServer, PeerProtocol, compute_connection_limit, connections
from farm.http.connections import (
    MAX_CONNECTIONS,
    REQUEST_TIMEOUT_S,
    RateLimitedLog,
    find_longest_waiting_connection,
    find_overdue_connections,
)
from farms.real_farm import RealFarm, wait_for

DESCRIPTOR_LIMIT = 64
IDLE_CLIENT_COUNT = 80
INCOMPLETE_REQUEST = b"GET /status HTTP/1.1\r\nHost: farm\r\n"
LARGE_ANSWER_BYTES = 20_000_000
COMPLETE_REQUEST = INCOMPLETE_REQUEST + b"Connection: close\r\n\r\n"


@dataclass
class WaitingClient:
    waiting_since_s: float | None


@pytest.mark.parametrize(
    ("descriptors", "printers", "workers", "max_connections"),
    [(1024, 100, 2, MAX_CONNECTIONS), (2**20, 3, 8, MAX_CONNECTIONS), (64, 1, 2, 11), (32, 1, 2, 4)],
)
def test_descriptors_are_reserved_for_the_farm(descriptors, printers, workers, max_connections):
    assert compute_connection_limit(descriptors, printers, workers) == max_connections


def test_oldest_incomplete_request_is_ended_first():
    busy_connection, old_connection, young_connection = (
        WaitingClient(None),
        WaitingClient(0.0),
        WaitingClient(5.0),
    )
    assert find_overdue_connections(
        [busy_connection, old_connection, young_connection], REQUEST_TIMEOUT_S + 0.1
    ) == [old_connection]
    assert (
        find_longest_waiting_connection([busy_connection, young_connection, old_connection]) is old_connection
    )
    assert find_longest_waiting_connection([busy_connection]) is None


def test_repeated_error_is_logged_once_a_minute(caplog):
    limited_log = RateLimitedLog()
    with caplog.at_level(logging.WARNING):
        for number in range(1000):
            limited_log.warn("no room", number / 100)
        limited_log.warn("no room", 60.0)
    assert [record.getMessage() for record in caplog.records] == ["no room (1 times)", "no room (1000 times)"]


async def serve_hello(scope, receive, send):
    while (await receive()).get("more_body"):
        pass
    await send({"type": "http.response.start", "status": 200, "headers": []})
    size_bytes = LARGE_ANSWER_BYTES if scope["path"] == "/large" else 0
    await send({"type": "http.response.body", "body": b"well" + bytes(size_bytes), "more_body": True})
    await send({"type": "http.response.body", "body": b""})


def serve(tmp_path, max_connections, run_scenario):
    """Run a scenario on a server with a limited number of connections."""

    async def run():
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(tmp_path / "s"))
            listener.listen(64)
            listener.setblocking(False)
            config = uvicorn.Config(serve_hello, http=PeerProtocol, log_config=None, lifespan="off")
            server = BoundedServer(config, max_connections)
            serve_task = asyncio.create_task(server._serve([listener]))
            try:
                async with asyncio.timeout(30.0):
                    await run_scenario(server, str(tmp_path / "s"))
            finally:
                server.should_exit = True
                await serve_task

    asyncio.run(run())


async def send_request(path, *pieces):
    reader, writer = await asyncio.open_unix_connection(path)
    for piece in pieces:
        writer.write(piece)
        await writer.drain()
    answer = await reader.read()
    writer.close()
    return answer


def test_idle_connections_are_closed_to_serve_a_request(tmp_path):
    async def run_scenario(server, path):
        idle_clients = [await asyncio.open_unix_connection(path) for _ in range(40)]
        for _, writer in idle_clients[::2]:
            writer.write(INCOMPLETE_REQUEST)
        assert b"well" in await send_request(path, COMPLETE_REQUEST)
        assert len(server.server_state.connections) <= 4
        for _, writer in idle_clients:
            writer.close()

    serve(tmp_path, 4, run_scenario)


def test_connection_of_a_client_that_does_not_read_is_closed_to_serve_a_request(tmp_path):
    async def run_scenario(server, path):
        unread_connections = [await asyncio.open_unix_connection(path, limit=1) for _ in range(4)]
        for _, writer in unread_connections:
            writer.write(COMPLETE_REQUEST.replace(b"/status", b"/large"))
        while not all(connection.flow.write_paused for connection in server.server_state.connections):
            await asyncio.sleep(0.001)
        assert b"well" in await send_request(path, COMPLETE_REQUEST)
        for _, writer in unread_connections:
            writer.close()

    serve(tmp_path, 4, run_scenario)


@pytest.mark.parametrize(
    "sent_bytes",
    [
        b"",
        INCOMPLETE_REQUEST,
        b"POST / HTTP/1.1\r\nHost: farm\r\nContent-Length: 100\r\n\r\nhalf",
        COMPLETE_REQUEST.replace(b"close", b"keep"),
    ],
    ids=["nothing", "half a head", "half a body", "idle after its answer"],
)
def test_connection_with_an_incomplete_request_is_ended(tmp_path, monkeypatch, sent_bytes):
    monkeypatch.setattr(connections, "REQUEST_TIMEOUT_S", -1.0)
    monkeypatch.setattr(connections, "_CHECK_INTERVAL_S", 0.01)

    async def run_scenario(server, path):
        await send_request(path, sent_bytes)  # the call returns when the server closes

    serve(tmp_path, 4, run_scenario)


def test_time_limit_applies_to_the_head_and_to_each_chunk(tmp_path):
    async def run_scenario(server, path):
        async def read_waiting_since_s():
            await asyncio.sleep(0.01)
            [item] = server.server_state.connections
            return item.waiting_since_s

        _, writer = await asyncio.open_unix_connection(path)
        while not server.server_state.connections:
            await asyncio.sleep(0.0)
        started_s = await read_waiting_since_s()
        writer.write(INCOMPLETE_REQUEST)
        assert await read_waiting_since_s() == started_s
        writer.write(b"Content-Length: 9\r\n\r\nhalf")
        body_since_s = await read_waiting_since_s()
        assert body_since_s > started_s
        writer.write(b"more")
        assert await read_waiting_since_s() > body_since_s
        writer.close()

    serve(tmp_path, 4, run_scenario)


def test_lack_of_descriptors_is_logged_once_and_accept_is_retried(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(connections, "_CHECK_INTERVAL_S", 0.01)

    async def run_scenario(server, path):
        loop, attempts = asyncio.get_running_loop(), []
        accept = loop.sock_accept

        async def accept_when_free(listener):
            attempts.append(1)
            if len(attempts) < 20:
                raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
            return await accept(listener)

        monkeypatch.setattr(loop, "sock_accept", accept_when_free)
        assert b"well" in await send_request(path, COMPLETE_REQUEST)  # served after the accept in progress
        assert b"well" in await send_request(path, COMPLETE_REQUEST)
        assert len(attempts) >= 20

    with caplog.at_level(logging.WARNING, logger="farm"):
        serve(tmp_path, 4, run_scenario)
    assert len([record for record in caplog.records if "accepted" in record.getMessage()]) == 1


def test_errors_of_accept_are_logged_and_accepting_continues(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(connections, "_CHECK_INTERVAL_S", 0.01)
    monkeypatch.setattr(connections, "_LOG_INTERVAL_S", 0.0)

    async def run_scenario(server, path):
        loop, make_protocol = asyncio.get_running_loop(), server._make_protocol
        accept, faults = loop.sock_accept, [MemoryError("no room"), ValueError("no socket")]

        async def fail_to_accept(listener):
            if faults:
                raise faults.pop()
            return await accept(listener)

        def raise_error():
            server._make_protocol = make_protocol
            raise RuntimeError("no protocol")

        monkeypatch.setattr(loop, "sock_accept", fail_to_accept)
        server._make_protocol = raise_error
        assert await send_request(path) == b""  # refused after the accept in progress
        assert b"well" in await send_request(path, COMPLETE_REQUEST)
        assert not faults

    with caplog.at_level(logging.WARNING, logger="farm"):
        serve(tmp_path, 4, run_scenario)
    log_text = " ".join(record.getMessage() for record in caplog.records)
    for error_text in ("no socket", "no room", "no protocol"):
        assert error_text in log_text


SERVER_SCRIPT = """
import asyncio, sys, uvicorn
from farm.http import BoundedServer, PeerProtocol, stop_on_signals, listen

async def app(scope, receive, send):
    await send({"type": "http.response.start", "status": 204, "headers": []})
    await send({"type": "http.response.body"})

async def serve(path):
    config = uvicorn.Config(app, http=PeerProtocol, log_config=None, lifespan="off")
    listening = listen(path, "no-such-group-here")
    print("listening", flush=True)
    try:
        server = BoundedServer(config, 4)
        with stop_on_signals(server):
            await server.serve(sockets=[listening])
        print("served", flush=True)
    finally:
        print("closed", flush=True)

from pathlib import Path
asyncio.run(serve(Path(sys.argv[1])))
"""


@pytest.mark.parametrize("signal_number", [signal.SIGTERM, signal.SIGINT])
def test_code_after_the_server_runs_when_a_signal_ends_it(tmp_path, signal_number):
    command = [sys.executable, "-c", SERVER_SCRIPT, str(tmp_path / "farm.sock")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "listening\n"
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(60.0)
            client.connect(str(tmp_path / "farm.sock"))
            client.send(COMPLETE_REQUEST)
            assert client.recv(100).startswith(b"HTTP/1.1 204")  # the server has started
        process.send_signal(signal_number)
        output, _ = process.communicate(timeout=30)
    assert (process.returncode, output) == (0, "served\nclosed\n")


@pytest.mark.system
def test_killed_agent_is_restarted_despite_many_idle_clients(tmp_path):
    farm = RealFarm(tmp_path, {"um2-01": ("ultimaker2_plus", "sim://ultimaker2_plus")})
    farm.wrapper = ["prlimit", f"--nofile={DESCRIPTOR_LIMIT}:{DESCRIPTOR_LIMIT}"]
    try:
        farm.up()
        farm.wrapper = []
        killed_pid = farm.read_printer("um2-01")["agent_pid"]
        with ExitStack() as idle_clients:
            for number in range(IDLE_CLIENT_COUNT):
                client = idle_clients.enter_context(closing(socket.socket(socket.AF_UNIX)))
                client.settimeout(30.0)
                client.connect(str(farm.state / "farm.sock"))
                if number % 2:
                    client.send(INCOMPLETE_REQUEST)
            os.kill(killed_pid, signal.SIGKILL)

            def has_restarted():
                result = farm.run("status", "--json")
                [printer] = json.loads(result.stdout)["printers"] if result.returncode == 0 else [{}]
                return printer.get("agent_pid") not in (None, killed_pid) and printer["state"] == "idle"

            wait_for("another agent", has_restarted, 60.0)
        assert len((farm.state / "daemon.log").read_text().splitlines()) < 200
    finally:
        farm.end()
