"""Routes of pages for browsers: status, log-in by a link, log-out, and the style sheet."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse

from farm.control import KeyCommands
from farm.errors import NoSuchThing, Refused
from farm.http import Services, describe_farm
from farm.web.callers import KeyHolder
from farm.web.cookies import SessionCookie
from farm.web.pages.rendering import render_login, render_message, render_status

_SEE_OTHER = 303


def page_routes(services: Services, cookie: SessionCookie) -> APIRouter:
    """Return the routes of pages.

    Parameters
    ----------
    services
        Components of the daemon.
    cookie
        The cookie of sessions.
    """
    router, keys = APIRouter(include_in_schema=False), KeyCommands(services.controller)
    name = services.controller.fleet.fleet.name

    @router.get("/")
    async def show_status(request: Request) -> Response:
        holder = _find_holder(request)
        return HTMLResponse(
            render_status(describe_farm(services), holder.name, holder.key.role, holder.has_session)
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
        holder = _find_holder(request)
        if not holder.has_session:
            raise Refused(f"{holder.name} has no session to end: an operator revokes it by `farm key revoke`")
        keys.revoke(holder.key.id, holder.name)
        response = HTMLResponse(render_message(name, "You have logged out.", has_login_hint=True))
        cookie.clear(response)
        return response

    @router.get("/static/farm.css")
    async def style() -> Response:
        return Response(_read_style(), media_type="text/css")

    return router


def _find_holder(request: Request) -> KeyHolder:
    """Return the caller, whom the guard has identified. Raises Refused for a visitor."""
    person = request.state.person
    if isinstance(person, KeyHolder):
        return person
    raise Refused("this needs a session: `farm web` on the farm's host opens one")


@cache
def _read_style() -> bytes:
    return files("farm.web.pages").joinpath("static/farm.css").read_bytes()
