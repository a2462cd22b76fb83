"""Routes of pages for browsers: Home, and the static files."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse

from farm.errors import NoSuchThing
from farm.http import Services, describe_farm
from farm.web.callers import find_holder
from farm.web.live import LivePages, publish_page
from farm.web.notes import Note, Notes, Reader
from farm.web.pages.home import render_home
from farm.web.pages.static_files import load_static_files

_KEPT = "public, max-age=31536000, immutable"  # the address changes with the contents


def page_routes(services: Services, notes: Notes, live: LivePages) -> APIRouter:
    """Return the routes of pages.

    Parameters
    ----------
    services
        Components of the daemon.
    notes
        Notes to show above the pages.
    live
        Receives the pages that are kept up to date.
    """
    router = APIRouter(include_in_schema=False)

    def show_home(reader: Reader, note: Note | None = None) -> str:
        return render_home(describe_farm(services), reader, note)

    async def show_live(reader: Reader, _variable: str, _query: str) -> str:
        return show_home(reader)

    live.add("/", show_live)

    @router.get("/")
    async def home(request: Request) -> Response:
        holder = find_holder(request)
        with notes.show(holder.key.id) as note:
            return HTMLResponse(publish_page(show_home(Reader.for_holder(holder), note)))

    @router.get("/static/{name}")
    async def static_file(name: str, request: Request) -> Response:
        found = load_static_files().get(name)
        if found is None:
            raise NoSuchThing(f"there is nothing at /static/{name}")
        headers = {"vary": "accept-encoding"}
        if request.query_params.get("v") == found.version:
            headers["cache-control"] = _KEPT
        if "gzip" in request.headers.get("accept-encoding", ""):
            headers["content-encoding"] = "gzip"
            return Response(found.compressed, media_type=found.media_type, headers=headers)
        return Response(found.content, media_type=found.media_type, headers=headers)

    return router
