"""Paths of the interfaces for slicers, with the roles that they require."""

from __future__ import annotations

import re

from farm.model import Role

PREFIXES = ("", "/to/{printer}")
"""Prefixes of the paths: for the whole farm, and for one printer."""
FILES = "/api/files/local"
FILE = FILES + "/{name}"
FILE_OF_JOB = FILES + "/{number}/{name}"
MOONRAKER_UPLOAD = "/server/files/upload"
APP_KEY_PROBE = "/plugin/appkeys/probe"
APP_KEY_REQUESTS = "/plugin/appkeys/request"
APP_KEY_REQUEST = APP_KEY_REQUESTS + "/{token}"
_LOOK_PATHS = (
    "/api/version",
    "/api/server",
    "/api/settings",
    "/api/currentuser",
    "/api/printer",
    "/api/printerprofiles",
    "/api/job",
    "/api/connection",
    "/api/files",
    FILES,
    FILE,
    FILE_OF_JOB,
    "/server/info",
    "/printer/info",
)
_PRINT_PATHS = (FILES, FILE, FILE_OF_JOB, "/api/job", "/api/connection", MOONRAKER_UPLOAD)
SLICER_ROLES: dict[tuple[str, str], Role] = {
    (method, prefix + path): role
    for prefix in PREFIXES
    for method, paths, role in (
        ("GET", _LOOK_PATHS, Role.LOOK),
        ("POST", ("/api/login",), Role.LOOK),
        ("POST", _PRINT_PATHS, Role.PRINT),
    )
    for path in paths
}
"""Required role by method and path."""
PUBLIC_SLICER_ROUTES = frozenset(
    (method, prefix + path)
    for prefix in PREFIXES
    for method, path in (("GET", APP_KEY_PROBE), ("POST", APP_KEY_REQUESTS), ("GET", APP_KEY_REQUEST))
)
"""Routes that require no key, because a program requests a key with them."""
_SLICER_PATH_PATTERN = re.compile(r"/(to|server|printer|plugin)/.*|/api/(?!v1(/|$)).*")
_UPLOAD_PATTERN = re.compile(rf"(/to/[^/]+)?({FILES}|{MOONRAKER_UPLOAD})")


def is_slicer_path(path: str) -> bool:
    """Return whether a path belongs to an interface for slicers, which gets errors as plain text."""
    return _SLICER_PATH_PATTERN.fullmatch(path) is not None


def is_slicer_upload(path: str) -> bool:
    """Return whether a path receives uploads."""
    return _UPLOAD_PATTERN.fullmatch(path) is not None
