"""Paths of the APIs for slicers, with the roles that they require."""

from __future__ import annotations

import re

from farm.model import Role

PREFIXES = ("", "/to/{printer}")
"""Prefixes of the paths: for the whole farm, and for one printer."""
FILES_PATH = "/api/files/local"
FILE_PATH = FILES_PATH + "/{name}"
JOB_FILE_PATH = FILES_PATH + "/{number}/{name}"
MOONRAKER_UPLOAD_PATH = "/server/files/upload"
APP_KEY_PROBE_PATH = "/plugin/appkeys/probe"
APP_KEY_REQUESTS_PATH = "/plugin/appkeys/request"
APP_KEY_REQUEST_PATH = APP_KEY_REQUESTS_PATH + "/{token}"
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
    FILES_PATH,
    FILE_PATH,
    JOB_FILE_PATH,
    "/server/info",
    "/printer/info",
)
_PRINT_PATHS = (FILES_PATH, FILE_PATH, JOB_FILE_PATH, "/api/job", "/api/connection", MOONRAKER_UPLOAD_PATH)
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
    for method, path in (
        ("GET", APP_KEY_PROBE_PATH),
        ("POST", APP_KEY_REQUESTS_PATH),
        ("GET", APP_KEY_REQUEST_PATH),
    )
)
"""Routes that require no key, because programs use them to request one."""
_SLICER_PATH_PATTERN = re.compile(r"/(to|server|printer|plugin)/.*|/api/(?!v1(/|$)).*")
_UPLOAD_PATTERN = re.compile(rf"(/to/[^/]+)?({FILES_PATH}|{MOONRAKER_UPLOAD_PATH})")


def is_slicer_path(path: str) -> bool:
    """Return whether a path belongs to an API for slicers, whose errors are plain text."""
    return _SLICER_PATH_PATTERN.fullmatch(path) is not None


def is_slicer_upload(path: str) -> bool:
    """Return whether a path of an API for slicers receives uploads."""
    return _UPLOAD_PATTERN.fullmatch(path) is not None
