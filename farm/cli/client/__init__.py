"""Client of a running farm: HTTP to the daemon, over its Unix socket or the network."""

from __future__ import annotations

from farm.cli.client.connections import SocketConnection, read_address
from farm.cli.client.daemon_client import Client, connect

__all__ = [
    "Client",
    "SocketConnection",
    "connect",
    "read_address",
]
