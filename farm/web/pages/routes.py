"""Routes of pages for browsers: status, and the static files."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse

from farm.errors import NoSuchThing
from farm.http import Services, describe_farm
from farm.web.callers import find_holder
from farm.web.notes import Notes, Reader
from farm.web.pages.rendering import render_page
from farm.web.pages.static_files import load_static_files

_KEPT = "public, max-age=31536000, immutable"  # the address changes with the contents


def page_routes(services: Services, notes: Notes) -> APIRouter:
    """Return the routes of pages.

    Parameters
    ----------
    services
        Components of the daemon.
    notes
        Notes to show above the pages.
    """
    router = APIRouter(include_in_schema=False)
    name = services.controller.fleet.fleet.name

    @router.get("/")
    async def show_status(request: Request) -> Response:
        holder = find_holder(request)
        reader, note = Reader.for_holder(holder), notes.take(holder.key.id)
        return HTMLResponse(
            render_page("status.html", name, "/", reader, note, status=describe_farm(services))
        )

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
