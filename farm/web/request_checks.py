"""Checks of requests from the network: host, origin, size and wrong keys. `app.Guard` applies them. Pure.

Another site may make a browser send requests to the farm (cross-site request forgery), or may resolve its
own name to this host (DNS rebinding). Requests that either of these attacks could have caused are refused.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass

_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
_OWN_SITE = frozenset({"same-origin", "none"})
_LOCAL_NAME = "localhost"
_HOST_PATTERN = re.compile(r"(\[[0-9A-Fa-f:.]{2,45}\]|[A-Za-z0-9._-]{1,253})(:[0-9]{1,5})?")
MAX_HEAD_BYTES = 16 * 1024
"""Limit on the size of a request's path and headers."""
MAX_WRONG_KEYS = 10
"""Number of wrong keys after which a client's address must wait."""
WRONG_KEY_WAIT_S = 60.0
"""Seconds that an address must wait after its last wrong key."""
_MAX_ADDRESSES = 1000


@dataclass(frozen=True, slots=True)
class Refusal:
    """Response to a refused request: HTTP status and message."""

    status: int
    text: str


def check_host(host: str | None, names: Collection[str]) -> Refusal | None:
    """Check the name by which a client addresses this server, as a protection against DNS rebinding.

    Parameters
    ----------
    host
        The header `Host`, with or without a port.
    names
        Names of this host in lower case, besides `localhost` and all IP addresses.
    """
    match = _HOST_PATTERN.fullmatch(host or "")
    if match is None:
        return Refusal(400, "the header Host is neither a name nor an address")
    name = match[1].lower().rstrip(".")
    if name == _LOCAL_NAME or name in names or _is_address(name.strip("[]")):
        return None
    return Refusal(421, f"{name} is not a name of this farm: add it to `web.names` in fleet.yaml")


def check_origin(method: str, host: str | None, origin: str | None, fetch_site: str | None) -> Refusal | None:
    """Check that a request with an unsafe method does not come from a page of another site.

    Browsers send `Origin` with such a request, and send `Sec-Fetch-Site` only to trustworthy addresses (HTTPS
    or localhost). Other programs send neither.

    Parameters
    ----------
    method
        The request's method.
    host, origin, fetch_site
        The headers `Host`, `Origin` and `Sec-Fetch-Site`; None if missing.
    """
    if method in _SAFE_METHODS:
        return None
    if fetch_site is not None:
        is_allowed = fetch_site in _OWN_SITE
    else:
        is_allowed = origin is None or origin in (f"http://{host}", f"https://{host}")
    return None if is_allowed else Refusal(403, "this request comes from a page of another site")


def check_session_origin(method: str, origin: str | None, fetch_site: str | None) -> Refusal | None:
    """Check that a request with an unsafe method and a session states its origin, as current browsers do.

    `check_origin` has already checked that the origin is this site. Without this check, a form from another
    site would be accepted from an old browser, which sends neither header.

    Parameters
    ----------
    method
        The request's method.
    origin, fetch_site
        The headers `Origin` and `Sec-Fetch-Site`; None if missing.
    """
    if method in _SAFE_METHODS or origin is not None or fetch_site is not None:
        return None
    return Refusal(403, "a session is valid only on the farm's own pages: use a key (`farm key add`)")


def check_head(path: bytes, headers: Iterable[tuple[bytes, bytes]]) -> Refusal | None:
    """Check the size of a request's head: the server limits it only if the head arrives in several pieces.

    Parameters
    ----------
    path
        The request's path with its query.
    headers
        Names and values of the headers.
    """
    size_bytes = len(path) + sum(len(name) + len(value) for name, value in headers)
    if size_bytes <= MAX_HEAD_BYTES:
        return None
    return Refusal(431, f"the headers are longer than {MAX_HEAD_BYTES // 1024} KiB")


class WrongKeys:
    """Count of wrong keys by client address.

    After ten wrong keys, each less than a minute after the one before, the address must wait for a minute.
    """

    def __init__(self) -> None:
        # by address: number of wrong keys, and time at which they are forgotten
        self._counts: dict[str, tuple[int, float]] = {}

    def check(self, address: str, now_s: float) -> Refusal | None:
        """Return a refusal if an address must wait, otherwise None."""
        count, end_s = self._counts.get(address, (0, 0.0))
        if count < MAX_WRONG_KEYS or now_s >= end_s:
            return None
        return Refusal(429, f"too many wrong keys from {address}: wait for a minute")

    def add(self, address: str, now_s: float) -> None:
        """Count a wrong key from an address."""
        count, end_s = self._counts.pop(address, (0, 0.0))
        self._counts[address] = (count + 1 if now_s < end_s else 1, now_s + WRONG_KEY_WAIT_S)
        if len(self._counts) > _MAX_ADDRESSES:
            del self._counts[next(iter(self._counts))]  # the address whose last wrong key is oldest


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
