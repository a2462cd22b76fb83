"""Clients of a running farm: HTTP to the daemon, and the emergency stop's own socket."""

from __future__ import annotations

from farm.cli.client.connections import SocketConnection, read_address
from farm.cli.client.daemon_client import Client, connect
from farm.cli.client.estop_socket import (
    Report,
    StopReport,
    find_estop_socket,
    request_stop,
    serve_request,
)

__all__ = [
    "Client",
    "Report",
    "SocketConnection",
    "StopReport",
    "connect",
    "find_estop_socket",
    "read_address",
    "request_stop",
    "serve_request",
]
