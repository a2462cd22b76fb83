"""Server of a farm's pages, for a browser."""

import asyncio
import socket
from contextlib import asynccontextmanager, closing

from farm.config import WebSection
from farm.http import NetworkState
from farm.web import NetworkServer


@asynccontextmanager
async def serve(farm):
    """Serve a farm's pages on a free port; yield the port."""
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    state = NetworkState()
    server = NetworkServer(WebSection(listen=f"127.0.0.1:{port}"), farm.web, 16, state)
    server.start(lambda: True)
    async with asyncio.timeout(30):
        while server._server is None or not server._server.started:
            await asyncio.sleep(0)
    yield port
    await server.close()
