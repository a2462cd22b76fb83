"""Routes of the pages on which people log in with a link or a key, and log out."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse, RedirectResponse

from farm.control import KeyCommands
from farm.errors import NotFoundError, RefusedError
from farm.http import Services
from farm.web.callers import CallerFinder, find_holder
from farm.web.cookies import SessionCookie
from farm.web.forms import BadForm, read_fields
from farm.web.pages.rendering import render_login, render_message
from farm.web.request_checks import Refusal

_SEE_OTHER = 303


def make_login_routes(services: Services, cookie: SessionCookie, caller_finder: CallerFinder) -> APIRouter:
    """Return the routes of the pages on which people log in and out.

    Parameters
    ----------
    services
        Components of the daemon.
    cookie
        The cookie of sessions.
    caller_finder
        Finder of the caller who logs in with a key.
    """
    router, keys = APIRouter(include_in_schema=False), KeyCommands(services.controller)
    name = services.controller.fleet.fleet.name
    _add_link_login_routes(router, services, cookie)

    @router.get("/login")
    async def show_key_login() -> Response:
        return HTMLResponse(render_message(name, "You are not logged in.", has_login_hint=True))

    @router.post("/login")
    async def log_in_with_key(request: Request) -> Response:
        holder = caller_finder.find_key_holder(await _read_key(request), request.state.caller.address)
        if isinstance(holder, Refusal):
            page = render_message(name, holder.text, has_login_hint=True)
            return HTMLResponse(page, holder.status, {"www-authenticate": "Bearer"})
        services.key_uses_s[holder.key.id] = services.controller.clock.now()
        return _redirect_home(cookie, services.sessions.open_with_key(holder.key))

    @router.post("/logout")
    async def log_out(request: Request) -> Response:
        holder = find_holder(request)
        if not holder.has_session:
            raise RefusedError(
                f"{holder.name} has a key, not a session: an operator revokes it with `farm key revoke`"
            )
        keys.revoke(holder.key.id, holder.name)
        response = HTMLResponse(render_message(name, "You have logged out.", has_login_hint=True))
        cookie.clear(response)
        return response

    return router


def _add_link_login_routes(router: APIRouter, services: Services, cookie: SessionCookie) -> None:
    """Add the routes with which people log in by a link."""
    name = services.controller.fleet.fleet.name

    @router.get("/login/{token}")
    async def show_login(token: str) -> Response:
        try:
            link = services.sessions.find_link(token)
        except NotFoundError as error:
            return HTMLResponse(render_message(name, str(error)), 404)
        return HTMLResponse(render_login(name, link.user, link.role))

    @router.post("/login/{token}")
    async def log_in(token: str) -> Response:
        try:
            key_text = services.sessions.open(token)
        except NotFoundError as error:
            return HTMLResponse(render_message(name, str(error)), 404)
        return _redirect_home(cookie, key_text)


def _redirect_home(cookie: SessionCookie, key_text: str) -> Response:
    """Redirect to the home page, and store the key text of a session in the cookie."""
    response = RedirectResponse("/", _SEE_OTHER)
    cookie.set(response, key_text)
    return response


async def _read_key(request: Request) -> str:
    """Return the key in a form, or an empty text if there is none."""
    try:
        return (await read_fields(request)).get("key", "").strip()
    except BadForm:
        return ""
