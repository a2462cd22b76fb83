"""Server of a farm's pages on a real connection."""

import asyncio
import socket
from contextlib import asynccontextmanager

from farm.config import WebSection
from farm.http import NetworkState
from farm.web import NetworkServer


@asynccontextmanager
async def serve(farm):
    """Serve a farm's pages on a free port; yield the port and the server."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    server = NetworkServer(WebSection(listen=f"127.0.0.1:{port}"), farm.web, 16, NetworkState())
    server.start(lambda: True)
    async with asyncio.timeout(60):
        while server._server is None or not server._server.started:
            await asyncio.sleep(0)
    yield port, server
    await server.close()
