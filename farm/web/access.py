"""Table of the routes on the network, with the role that each requires.

The application does not serve a route that has no row in the table; a test reports such routes.
"""

from __future__ import annotations

import re

from farm.api import NETWORK_PREFIX
from farm.model import Role
from farm.web.slicers import PUBLIC_SLICER_ROUTES, SLICER_ROLES

METRICS_PATH = "/metrics"
SCHEMA_PATH = f"{NETWORK_PREFIX}/openapi.json"
SCHEMA_PAGE_PATH = f"{NETWORK_PREFIX}/docs"
LIVENESS_PATH = "/healthz"
_LOOK_PATHS = (
    "/status",
    "/status/summary",
    "/events",
    "/names",
    "/history",
    "/prints",
    "/jobs",
    "/queue",
    "/hosts",
    "/jobs/{number}",
    "/jobs/{number}/timeline",
    "/jobs/{number}/files",
    "/jobs/{number}/files/{name}",
    "/printers/{name}/camera",
    "/uploads/{request_id}",
)
_PRINT_PATHS = (
    "/jobs",
    "/jobs/{number}/assembled",
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
_PLAN_FORM_PATHS = ("/jobs/{number}/release", "/jobs/{number}/keep", "/jobs/{number}/replan")
_OPERATE_PATHS = (
    "/jobs/{number}/approve",
    "/jobs/{number}/move",
    "/jobs/{number}/start",
    "/printers/{name}/cleared",
    "/printers/{name}/load",
    "/printers/{name}/maintained",
    "/outage/confirm",
)
PAGE_PATHS = (
    "/",
    "/timeline",
    "/printers/{name}",
    "/history",
    "/history.csv",
    "/jobs/{number}",
    "/jobs/{number}/instructions",
    "/jobs/{number}/parts.zip",
    "/jobs/{number}/report",
    "/jobs/{number}/stills/{name}",
)
OPERATOR_PAGE_PATHS = ("/printers/{name}/wire",)
PUBLIC_ROUTES = frozenset(
    {
        ("GET", LIVENESS_PATH),
        ("GET", "/login"),
        ("POST", "/login"),
        ("GET", "/login/{token}"),
        ("POST", "/login/{token}"),
        ("GET", "/static/{name}"),
        *PUBLIC_SLICER_ROUTES,
    }
)
"""Routes that require no key. None of them shows data of the farm."""
ROLES: dict[tuple[str, str], Role] = {
    **{("GET", path): Role.LOOK for path in (METRICS_PATH, SCHEMA_PATH, SCHEMA_PAGE_PATH)},
    **{("GET", path): Role.LOOK for path in PAGE_PATHS},
    ("GET", "/live"): Role.LOOK,
    **{("GET", path): Role.OPERATE for path in OPERATOR_PAGE_PATHS},
    ("POST", "/logout"): Role.LOOK,
    **{("GET", NETWORK_PREFIX + path): Role.LOOK for path in _LOOK_PATHS},
    **{("POST", NETWORK_PREFIX + path): Role.PRINT for path in _PRINT_PATHS},
    **{("POST", NETWORK_PREFIX + path): Role.OPERATE for path in _OPERATE_PATHS},
    **{("POST", path): Role.PRINT for path in _PRINT_PATHS if path != "/jobs"},  # forms on pages
    **{("POST", path): Role.PRINT for path in (*_PLAN_FORM_PATHS, "/submit")},
    ("GET", "/submit"): Role.PRINT,
    **{("POST", path): Role.OPERATE for path in _OPERATE_PATHS},
    **SLICER_ROLES,
}
"""Required role by method and path."""
HOST_ONLY_ROUTES = frozenset(
    (method, NETWORK_PREFIX + path)
    for method, path in (
        ("POST", "/printers/{name}/replace"),
        ("POST", "/hosts/update"),
        ("POST", "/prune"),
        ("POST", "/down"),
    )
)
"""Routes that are served only on the Unix socket, because they concern the daemon's host."""


def _compile_path(path: str) -> re.Pattern[str]:
    return re.compile(re.sub(r"\{\w+\}", "[^/]+", path))


_PUBLIC_PATTERNS = [(method, _compile_path(path)) for method, path in PUBLIC_ROUTES]
_PATTERNS = [(method, _compile_path(path), role) for (method, path), role in ROLES.items()]


def is_public(method: str, path: str) -> bool:
    """Return whether a request requires no key."""
    return any(
        route_method == method and pattern.fullmatch(path) for route_method, pattern in _PUBLIC_PATTERNS
    )


def find_role(method: str, path: str) -> Role | None:
    """Find the role that a request requires; None if there is no such route on the network."""
    roles = (
        role
        for route_method, pattern, role in _PATTERNS
        if route_method == method and pattern.fullmatch(path)
    )
    return next(roles, None)
