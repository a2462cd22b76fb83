"""Files that pages load, such as scripts, and the route that sends them."""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from fastapi import APIRouter, Request, Response

from farm.errors import NotFoundError

_MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}
_FOLDERS = (("farm.web.pages", "static"), ("farm.web.pages", "built"), ("farm.views.charts", "static"))
"""Packages and folders of static files; `make install` builds the files in `built`, which may be missing."""
_VERSION_DIGITS = 12
_CACHE_CONTROL = "public, max-age=31536000, immutable"  # the URL changes with the contents


@dataclass(frozen=True, slots=True)
class StaticFile:
    """Content of a file, plain and compressed with gzip. The version changes with the content."""

    content: bytes
    compressed_content: bytes
    media_type: str
    version: str


@cache
def load_static_files() -> Mapping[str, StaticFile]:
    """Load all static files, and return them by name."""
    static_files: dict[str, StaticFile] = {}
    for package, folder in _FOLDERS:
        source = files(package).joinpath(folder)
        for entry in sorted(source.iterdir(), key=lambda path: path.name) if source.is_dir() else ():
            media_type = _MEDIA_TYPES.get(entry.name[entry.name.rfind(".") :])
            if media_type is None:
                continue
            content = entry.read_bytes()
            version = hashlib.sha256(content).hexdigest()[:_VERSION_DIGITS]
            static_files[entry.name] = StaticFile(
                content, gzip.compress(content, mtime=0), media_type, version
            )
    return static_files


def make_static_url(name: str) -> str:
    """Return the URL of a file, with its version so that browsers may cache it; empty if it is missing."""
    file = load_static_files().get(name)
    return "" if file is None else f"/static/{name}?v={file.version}"


def make_static_routes() -> APIRouter:
    """Return the route that sends the static files."""
    router = APIRouter(include_in_schema=False)

    @router.get("/static/{name}")
    async def send_static_file(name: str, request: Request) -> Response:
        file = load_static_files().get(name)
        if file is None:
            raise NotFoundError(f"there is nothing at /static/{name}")
        headers = {"vary": "accept-encoding"}
        if request.query_params.get("v") == file.version:
            headers["cache-control"] = _CACHE_CONTROL
        if "gzip" in request.headers.get("accept-encoding", ""):
            headers["content-encoding"] = "gzip"
            return Response(file.compressed_content, media_type=file.media_type, headers=headers)
        return Response(file.content, media_type=file.media_type, headers=headers)

    return router
