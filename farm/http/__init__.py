"""HTTP interface of the daemon: application, server, and identification of callers."""

from __future__ import annotations

from farm.http.app import make_app
from farm.http.callers import PeerProtocol, Person, check_operators, listen
from farm.http.connections import BoundedServer, connection_limit, descriptor_limit
from farm.http.services import Services

__all__ = [
    "BoundedServer",
    "PeerProtocol",
    "Person",
    "Services",
    "check_operators",
    "connection_limit",
    "descriptor_limit",
    "listen",
    "make_app",
]
