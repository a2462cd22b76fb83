"""Clients of a running farm: HTTP to the daemon, and the emergency stop's own socket."""

from __future__ import annotations

from farm.cli.client.daemon_client import Client, DaemonConnection
from farm.cli.client.estop_socket import (
    Report,
    StopReport,
    find_estop_socket,
    request_stop,
    serve_request,
)

__all__ = [
    "Client",
    "DaemonConnection",
    "Report",
    "StopReport",
    "find_estop_socket",
    "request_stop",
    "serve_request",
]
