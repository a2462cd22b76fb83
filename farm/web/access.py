"""Roles that the routes need on the network. A route without a row here is not served there."""

from __future__ import annotations

import re

from farm.api import NETWORK_PREFIX
from farm.model import Role

METRICS = "/metrics"
LIVENESS = "/healthz"
"""The only path that needs no key; it shows nothing of the farm."""
_LOOK = (
    "/status",
    "/names",
    "/history",
    "/jobs/{number}",
    "/jobs/{number}/timeline",
    "/uploads/{request_id}",
)
_PRINT = (
    "/jobs",
    "/jobs/{number}/cancel",
    "/jobs/{number}/pause",
    "/jobs/{number}/resume",
    "/jobs/{number}/parts/{part}/reprint",
    "/jobs/{number}/parts/{part}/cancel",
    "/jobs/{number}/parts/{part}/pause",
    "/jobs/{number}/parts/{part}/resume",
    "/printers/{name}/pause",
    "/printers/{name}/resume",
    "/printers/{name}/fail",
    "/printers/{name}/cancel",
    "/printers/{name}/maintenance",
)
_OPERATE = (
    "/jobs/{number}/approve",
    "/printers/{name}/cleared",
    "/printers/{name}/load",
    "/printers/{name}/maintained",
    "/outage/confirm",
)
ROLES: dict[tuple[str, str], Role] = {
    **{("GET", path): Role.LOOK for path in _LOOK},
    **{("POST", path): Role.PRINT for path in _PRINT},
    **{("POST", path): Role.OPERATE for path in _OPERATE},
}
"""Role by method and path, without the prefix. `/down` and agents are left to the daemon's own host."""
_PATTERNS = [
    (method, re.compile(re.sub(r"\{\w+\}", "[^/]+", path)), role) for (method, path), role in ROLES.items()
]


def find_role(method: str, path: str) -> Role | None:
    """Return the role that a request needs; None if there is no such route on the network."""
    if (method, path) == ("GET", METRICS):
        return Role.LOOK
    if not path.startswith(f"{NETWORK_PREFIX}/"):
        return None
    own = path.removeprefix(NETWORK_PREFIX)
    return next(
        (role for verb, pattern, role in _PATTERNS if verb == method and pattern.fullmatch(own)), None
    )
