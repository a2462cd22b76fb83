"""Connections to a daemon: over its Unix socket, or over the network with a key."""

from __future__ import annotations

import re
import socket
import stat
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPSConnection
from pathlib import Path
from urllib.parse import urlsplit

from farm.api import NETWORK_PREFIX
from farm.errors import ErrorCode, FarmError

_CHUNK_BYTES = 1 << 20  # size of a chunk of an upload
_KEY_PATTERN = re.compile(r"[\x21-\x7e]{1,200}")


@dataclass(frozen=True, slots=True)
class NetworkAddress:
    """Address of a daemon on another host, with this user's key.

    Attributes
    ----------
    scheme
        `http` or `https`.
    netloc
        Name or IP address, with the port if there is one.
    path_prefix
        Prefix of each path, without a final slash, for a daemon behind a proxy.
    key
        The key's text.
    """

    scheme: str
    netloc: str
    path_prefix: str
    key: str

    def __str__(self) -> str:
        return f"{self.scheme}://{self.netloc}{self.path_prefix}"


Address = Path | NetworkAddress
"""The daemon's Unix socket, or its address on the network."""


class SocketConnection(HTTPConnection):
    """HTTP connection over the daemon's Unix socket.

    The class uses the HTTP client of the standard library, because that is fast to import. A failed request
    raises OSError or HTTPException.
    """

    def __init__(self, path: Path, connect_timeout_s: float, response_timeout_s: float) -> None:
        super().__init__("farm", timeout=response_timeout_s, blocksize=_CHUNK_BYTES)
        self._path, self._connect_timeout_s, self._response_timeout_s = (
            path,
            connect_timeout_s,
            response_timeout_s,
        )

    def connect(self) -> None:
        connection = socket.socket(socket.AF_UNIX)
        try:
            connection.settimeout(self._connect_timeout_s)
            connection.connect(str(self._path))
            connection.settimeout(self._response_timeout_s)
        except OSError:
            connection.close()
            raise
        self.sock = connection


def open_connection(address: Address, connect_timeout_s: float, response_timeout_s: float) -> HTTPConnection:
    """Make an HTTP connection; its first request opens it.

    Parameters
    ----------
    address
        The daemon.
    connect_timeout_s, response_timeout_s
        Seconds to wait for a connection, and for a response; on the network, the latter is used for both.
    """
    if isinstance(address, Path):
        return SocketConnection(address, connect_timeout_s, response_timeout_s)
    connection_class = HTTPSConnection if address.scheme == "https" else HTTPConnection
    return connection_class(address.netloc, timeout=response_timeout_s, blocksize=_CHUNK_BYTES)


def make_headers(address: Address) -> dict[str, str]:
    """Return the headers for each request; over the network, they contain the key."""
    return {} if isinstance(address, Path) else {"X-Api-Key": address.key}


def make_target(address: Address, path: str) -> str:
    """Return the path of a request, with the prefix that a daemon on the network expects."""
    return path if isinstance(address, Path) else f"{address.path_prefix}{NETWORK_PREFIX}{path}"


def read_address(url: str, key_file: Path | None) -> NetworkAddress:
    """Read the address of a daemon on the network, and the key from its file.

    Raises
    ------
    FarmError
        If the URL is not valid, or the key cannot be read, or other users can read it too.
    """
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.username:
        raise FarmError(f"{url!r} is not the address of a farm: use https://HOST:8467", ErrorCode.SETTINGS)
    if key_file is None:
        raise FarmError(
            "--url needs --key-file FILE (FARM_KEY_FILE): a key that an operator created with "
            "`farm key add NAME`",
            ErrorCode.SETTINGS,
        )
    try:
        mode = key_file.stat().st_mode
        text = key_file.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        cause = (error.strerror if isinstance(error, OSError) else None) or error
        raise FarmError(f"{key_file}: the key cannot be read ({cause})", ErrorCode.SETTINGS) from error
    if stat.S_IMODE(mode) & 0o077:
        raise FarmError(
            f"{key_file}: other users can read this key: `chmod 600 {key_file}`", ErrorCode.SETTINGS
        )
    if _KEY_PATTERN.fullmatch(text) is None:
        raise FarmError(f"{key_file}: must contain one key and nothing else", ErrorCode.SETTINGS)
    return NetworkAddress(parts.scheme, parts.netloc, parts.path.rstrip("/"), text)
