"""Routes of the home page and of the static files."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from farm.errors import NotFoundError
from farm.http import describe_farm
from farm.web.notes import Note, Reader
from farm.web.pages.home import render_home
from farm.web.pages.page_context import PageContext
from farm.web.pages.static_files import load_static_files

_CACHE_CONTROL = "public, max-age=31536000, immutable"  # the URL changes with the contents


def make_page_routes(pages: PageContext) -> APIRouter:
    """Return the routes of the home page and of the static files."""
    router = APIRouter(include_in_schema=False)

    async def render_home_page(reader: Reader, note: Note | None = None) -> str:
        return render_home(describe_farm(pages.services), reader, note)

    pages.live_pages.add("/", lambda reader, _variable, _query: render_home_page(reader))

    @router.get("/")
    async def show_home(request: Request) -> Response:
        return await pages.answer(request, render_home_page)

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
