"""Random requests to the server for the network: no request fails or does more than its caller may."""

import asyncio
import random
import socket

import pytest
import uvicorn

from bench.web.fuzz import send
from bench.web.requests import FuzzedRequest, make_request
from farm.http import BoundedServer, PeerProtocol
from farm.model import Role
from farm.web.access import ROLES
from farms.network_farm import NetworkFarm

CONCURRENT_CLIENTS = 8
TIME_LIMIT_S = 60.0


@pytest.fixture
def farm(tmp_path):
    farm = NetworkFarm(tmp_path)
    yield farm
    farm.store.close()


async def send_requests(farm, requests):
    """Send requests to a server, several at once; return each with its statuses."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.setblocking(False)
    config = uvicorn.Config(
        farm.web, http=PeerProtocol, ws="none", log_config=None, lifespan="off", access_log=False
    )
    server = BoundedServer(config, 64)
    serve_task = asyncio.create_task(server.serve(sockets=[listener]))
    port, waiting_requests, answers = listener.getsockname()[1], list(requests), []

    async def send_waiting_requests():
        while waiting_requests:
            request = waiting_requests.pop()
            answers.append((request, await send(port, request, TIME_LIMIT_S)))

    await asyncio.gather(*(send_waiting_requests() for _ in range(CONCURRENT_CLIENTS)))
    server.should_exit = True
    await asyncio.wait_for(serve_task, TIME_LIMIT_S)
    listener.close()
    return answers


def run_fuzz(farm, keys, request_count, seed):
    rng = random.Random(seed)
    return asyncio.run(send_requests(farm, [make_request(rng, keys) for _ in range(request_count)]))


def list_failures(answers):
    """List the requests that the server failed to serve; 503 is allowed, because no camera answers."""
    return [
        (request.data, statuses)
        for request, statuses in answers
        if any(status >= 500 and status != 503 for status in statuses) or (request.intact and not statuses)
    ]


def is_guarded(request):
    return (request.method, request.path) in ROLES


def test_requests_with_the_role_look_change_nothing(farm):
    revoked_key = farm.add_key(Role.OPERATE, "revoked")
    farm.keys.revoke(revoked_key.id, "ann")
    look_key = farm.add_key(Role.LOOK).text
    keys = {"": "", "wrong": "farm_key_x", "revoked": revoked_key.text, "look": look_key}
    events = farm.store.read_all_events()
    answers = run_fuzz(farm, keys, 250, seed=1)
    assert list_failures(answers) == []
    assert farm.store.read_all_events() == events
    assert farm.controller.books.jobs == {} and not list(farm.state.work.iterdir())
    served_callers = {
        request.caller for request, statuses in answers if 200 in statuses and is_guarded(request)
    }
    assert served_callers == {"look"}


def test_requests_with_every_role_do_not_fail(farm):
    keys = {str(role): farm.add_key(role).text for role in (Role.PRINT, Role.OPERATE)}
    event_count = len(farm.store.read_all_events())
    answers = run_fuzz(farm, keys, 250, seed=2)
    assert list_failures(answers) == []
    change_count = sum(  # a request takes effect even if its sender does not wait for the answer
        request.method != "GET" and (not statuses or any(200 <= status < 300 for status in statuses))
        for request, statuses in answers
    )
    assert 0 < len(farm.store.read_all_events()) - event_count <= 5 * change_count
    assert farm.shutdowns == [] and not list(farm.state.work.iterdir())


def test_stream_is_read_until_its_first_event():
    """Stop reading a stream at its first event, because streams do not end."""

    async def send_stream(reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        while not writer.is_closing():
            writer.write(b"HTTP/1.1 200 OK\r\ncontent-type: text/event-stream\r\n\r\n: quiet\n\n")
            await writer.drain()
            await asyncio.sleep(0)
        writer.close()

    async def read_stream():
        async with await asyncio.start_server(send_stream, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            data = b"GET /live HTTP/1.1\r\nHost: localhost\r\n\r\n"
            request = FuzzedRequest(data, "look", "GET", "/live", intact=True)
            return await asyncio.wait_for(send(port, request), TIME_LIMIT_S)

    assert 200 in asyncio.run(read_stream())
