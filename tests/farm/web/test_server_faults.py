"""Faults of the server for the network: reported, and without effect on the rest of the daemon."""

import asyncio
import socket
from contextlib import closing

from farm.config import WebSection
from farm.http import NetworkState
from farm.web import NetworkServer


def find_free_address():
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


async def do_nothing(scope, receive, send):
    pass


def serve_until(section, has_key, condition):
    """Serve until a condition holds, then close; return the reported problem."""
    state = NetworkState()

    async def serve():
        server = NetworkServer(section, do_nothing, 4, state)
        server.start(has_key)
        async with asyncio.timeout(30):
            while not condition(state):
                await asyncio.sleep(0)
        await server.close()

    asyncio.run(serve())
    return state.problem


def test_missing_certificate_is_named(tmp_path):
    tls = {"cert": tmp_path / "cert.pem", "key": tmp_path / "key.pem"}
    section = WebSection.model_validate({"listen": find_free_address(), "tls": tls})
    problem = serve_until(section, lambda: True, lambda state: state.problem)
    assert f"the certificate {tmp_path / 'cert.pem'} with the key {tmp_path / 'key.pem'}" in problem
    assert "No such file" in problem


def test_unexpected_error_is_reported_and_closing_continues():
    def raise_error():
        raise RuntimeError("no books")

    section = WebSection.model_validate({"listen": "0.0.0.0:8467"})
    assert "no books" in serve_until(section, raise_error, lambda state: state.problem)
