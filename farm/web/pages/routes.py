"""Routes of pages for browsers: status, log-in by a link, log-out, and the static files."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse

from farm.control import KeyCommands
from farm.errors import NoSuchThing, Refused
from farm.http import Services, describe_farm
from farm.web.callers import find_holder
from farm.web.cookies import SessionCookie
from farm.web.notes import Notes, Reader
from farm.web.pages.rendering import render_login, render_message, render_page
from farm.web.pages.static_files import load_static_files

_SEE_OTHER = 303
_KEPT = "public, max-age=31536000, immutable"  # the address changes with the contents


def page_routes(services: Services, cookie: SessionCookie, notes: Notes) -> APIRouter:
    """Return the routes of pages.

    Parameters
    ----------
    services
        Components of the daemon.
    cookie
        The cookie of sessions.
    notes
        Notes to show above the pages.
    """
    router, keys = APIRouter(include_in_schema=False), KeyCommands(services.controller)
    name = services.controller.fleet.fleet.name

    @router.get("/")
    async def show_status(request: Request) -> Response:
        holder = find_holder(request)
        reader, note = Reader.for_holder(holder), notes.take(holder.key.id)
        return HTMLResponse(
            render_page("status.html", name, "/", reader, note, status=describe_farm(services))
        )

    @router.get("/login/{token}")
    async def show_login(token: str) -> Response:
        try:
            link = services.sessions.find_link(token)
        except NoSuchThing as error:
            return HTMLResponse(render_message(name, str(error)), 404)
        return HTMLResponse(render_login(name, link.user, link.role))

    @router.post("/login/{token}")
    async def log_in(token: str) -> Response:
        try:
            text = services.sessions.open(token)
        except NoSuchThing as error:
            return HTMLResponse(render_message(name, str(error)), 404)
        response = RedirectResponse("/", _SEE_OTHER)
        cookie.set(response, text)
        return response

    @router.post("/logout")
    async def log_out(request: Request) -> Response:
        holder = find_holder(request)
        if not holder.has_session:
            raise Refused(f"{holder.name} has no session to end: an operator revokes it by `farm key revoke`")
        keys.revoke(holder.key.id, holder.name)
        response = HTMLResponse(render_message(name, "You have logged out.", has_login_hint=True))
        cookie.clear(response)
        return response

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
