"""Limit on the number of connections from one address, so that one client cannot use up all connections."""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from collections.abc import Mapping

import uvicorn

from farm.errors import RefusedError
from farm.http import BoundedServer, WaitingConnection, find_longest_waiting_connection

_SHARE_DIVISOR = 4  # one address may have a quarter of all connections
_MIN_CONNECTIONS = 4  # one address may always have this number
_IPV6_PREFIX_BITS = 64  # all addresses with the same prefix may belong to one client


def find_client_network(host: str) -> str | None:
    """Return the address or network under which the connections of a client are counted.

    Parameters
    ----------
    host
        The client's IP address. Any other text is returned unchanged.

    Returns
    -------
    str or None
        IPv4 address, or IPv6 network of one client. None for this host, whose connections are not counted,
        because it may run a proxy.
    """
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is not None:
        address = address.ipv4_mapped
    if address.is_loopback:
        return None
    if isinstance(address, ipaddress.IPv4Address):
        return str(address)
    return str(ipaddress.ip_network((address, _IPV6_PREFIX_BITS), strict=False))


class AddressLimitedServer(BoundedServer):
    """TCP server that accepts at most a quarter of its maximum number of connections from one address.

    At the limit, a new connection replaces the connection of the same address that has waited longest for
    its client; if none waits, the new connection is closed.

    Parameters
    ----------
    config
        uvicorn's configuration.
    limit
        Maximum number of open connections.
    """

    def __init__(self, config: uvicorn.Config, limit: int) -> None:
        super().__init__(config, limit)
        self._address_limit = max(_MIN_CONNECTIONS, limit // _SHARE_DIVISOR)

    async def make_room(self, connection: socket.socket) -> None:
        """Make room for a new connection within the limit of its address, then within the total limit.

        Raises
        ------
        RefusedError
            If the address has reached its limit, and none of its connections waits for the client.
        """
        client = find_client_network(connection.getpeername()[0])
        while (
            client is not None
            and len(client_connections := self._list_connections(client)) >= self._address_limit
        ):
            waiting_connection = find_longest_waiting_connection(client_connections)
            if waiting_connection is None:
                raise RefusedError(f"{client} has {len(client_connections)} connections")
            waiting_connection.transport.abort()
            await asyncio.sleep(0.0)
        await super().make_room(connection)

    def find_handshake_to_abandon(
        self, handshakes: Mapping[asyncio.Task[None], socket.socket], connection: socket.socket
    ) -> asyncio.Task[None] | None:
        """Return the oldest handshake of an address at its limit; otherwise decide as the base class does."""
        client = _find_peer_network(connection)
        client_handshakes = [
            task for task, other in handshakes.items() if _find_peer_network(other) == client
        ]
        if client is not None and len(client_handshakes) >= self._address_limit:
            return client_handshakes[0]
        return super().find_handshake_to_abandon(handshakes, connection)

    def _list_connections(self, client: str) -> list[WaitingConnection]:
        """List the connections of a client."""
        peers = (
            (connection, connection.transport.get_extra_info("peername")) for connection in self.connections
        )
        return [connection for connection, peer in peers if peer and find_client_network(peer[0]) == client]


def _find_peer_network(connection: socket.socket) -> str | None:
    try:
        return find_client_network(connection.getpeername()[0])
    except OSError:  # the connection has been closed
        return None
