"""HTTP application for callers on the network, who need a key with the role that a route requires.

The application serves only the routes in the table of `farm.web.access`. `Guard` checks every request before
a route handles it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cache, partial
from typing import Any

from fastapi import Depends, FastAPI, Response
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import farm
from farm.api import NETWORK_PREFIX
from farm.control import DryRuns, JobCommands, PartCommands, PrinterCommands
from farm.errors import ErrorCode, ExitCode
from farm.http import (
    UPLOAD_PATH,
    BodyLimit,
    Services,
    add_routes,
    describe_farm,
    identify_caller,
    make_problem_response,
)
from farm.views.report import load_templates as load_report_templates
from farm.web.access import LIVENESS_PATH, METRICS_PATH, SCHEMA_PAGE_PATH, SCHEMA_PATH, find_role, is_public
from farm.web.actions import (
    make_job_form_routes,
    make_part_form_routes,
    make_print_form_routes,
    make_printer_form_routes,
)
from farm.web.address_limit import find_client_network
from farm.web.callers import CallerFinder, KeyHolder, Visitor
from farm.web.cookies import SessionCookie
from farm.web.live import LivePages, make_live_routes
from farm.web.metrics import CONTENT_TYPE, format_metrics
from farm.web.notes import Notes
from farm.web.openapi import describe_routes
from farm.web.pages import (
    POLICY,
    SUBMIT_PATH,
    PageContext,
    load_page_files,
    make_all_job_routes,
    make_history_routes,
    make_home_routes,
    make_login_routes,
    make_printer_page_routes,
    make_static_routes,
    make_submit_routes,
    make_timeline_routes,
    render_api_page,
    render_message,
)
from farm.web.request_checks import Refusal, check_head, check_host, check_origin, check_session_origin
from farm.web.slicers import add_slicer_routes, is_slicer_path, is_slicer_upload, make_text_response

_GZIP_LEVEL = 5
_FILE_TYPES = ("text/plain", "model/*", "application/octet-stream", "application/vnd.ms-pki.stl")
_UNCOMPRESSED_TYPES = (*DEFAULT_EXCLUDED_CONTENT_TYPES, *_FILE_TYPES)
"""Media types that are sent uncompressed: compressing large G-code and models takes too long, and their
responses need a Content-Length."""
_HEADERS = {
    "content-security-policy": "default-src 'none'; style-src 'self'; script-src 'self'; "
    "img-src 'self'; connect-src 'self'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'",
    "x-content-type-options": "nosniff",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "same-origin",  # with no-referrer, browsers send `Origin: null` with a form
    "cache-control": "no-store",
}


def make_web_app(services: Services, dry_runs: DryRuns, names: Collection[str]) -> ASGIApp:
    """Make the application for the network.

    Parameters
    ----------
    services
        Components of the daemon.
    dry_runs
        Dry runs. A dry run ends when requests about its job cease.
    names
        Names of this host in lower case, which the header `Host` may contain.
    """
    app = FastAPI(
        title="farm", version=farm.__version__, openapi_url=None, dependencies=[Depends(identify_caller)]
    )
    add_routes(app, services, dry_runs, NETWORK_PREFIX)
    add_slicer_routes(app, services)
    app.add_middleware(GZipMiddleware, compresslevel=_GZIP_LEVEL, exclude_content_types=_UNCOMPRESSED_TYPES)
    app.add_middleware(
        BodyLimit,
        is_upload=lambda path: path in (NETWORK_PREFIX + UPLOAD_PATH, SUBMIT_PATH) or is_slicer_upload(path),
    )

    @app.get(LIVENESS_PATH)
    async def report_liveness() -> dict[str, str]:
        return {"status": "ok"}

    @app.get(METRICS_PATH, response_class=PlainTextResponse)
    async def send_metrics() -> Response:
        context = services.controller.build_view_context(services.state)
        return Response(format_metrics(context, describe_farm(services)), media_type=CONTENT_TYPE)

    @cache
    def describe_network_routes() -> dict[str, Any]:
        return describe_routes(app.routes)  # first called during a request, when all routes exist

    @app.get(SCHEMA_PATH, include_in_schema=False)
    async def send_schema() -> Response:
        return JSONResponse(describe_network_routes())

    @app.get(SCHEMA_PAGE_PATH, include_in_schema=False)
    async def show_schema_page() -> Response:
        page = render_api_page(describe_network_routes(), SCHEMA_PATH)
        return HTMLResponse(page, headers={"content-security-policy": POLICY})

    cookie = SessionCookie.for_section(services.controller.fleet.web)
    caller_finder = CallerFinder(services, cookie)
    app.include_router(make_login_routes(services, cookie, caller_finder))
    _add_page_routes(app, services, dry_runs)
    return Guard(app, services, names, cookie, caller_finder)


def _add_page_routes(app: FastAPI, services: Services, dry_runs: DryRuns) -> None:
    """Add the routes of the pages and of their forms.

    Templates and static files are loaded when the daemon starts, because an update of farm may replace them
    later.
    """
    load_page_files()
    load_report_templates()
    app.state.notes = notes = Notes()
    printers = PrinterCommands(services.controller)
    parts = PartCommands(services.controller, printers)
    jobs = JobCommands(services.controller, printers)
    live = LivePages(services.page_streams)
    pages = PageContext(services, notes, live)
    app.include_router(make_home_routes(pages))
    app.include_router(make_static_routes())
    app.include_router(make_live_routes(live, services.page_streams))
    app.include_router(make_timeline_routes(pages))
    app.include_router(make_history_routes(pages))
    app.include_router(make_printer_page_routes(pages))
    app.include_router(make_all_job_routes(pages, jobs, dry_runs))
    app.include_router(make_submit_routes(pages, jobs))
    app.include_router(make_printer_form_routes(printers))
    app.include_router(make_print_form_routes(printers, parts))
    app.include_router(make_job_form_routes(services, jobs))
    app.include_router(make_part_form_routes(parts))


class Guard:
    """Middleware that checks the host, origin, key and role of requests, and adds security headers.

    Parameters
    ----------
    app
        The application that handles allowed requests.
    services
        Source of keys, sessions and the farm's clock. The guard stores in it the time at which each key was
        last used.
    names
        Names of this host in lower case, which the header `Host` may contain.
    cookie
        Cookie of the sessions.
    caller_finder
        Finder of the caller of a request.
    """

    def __init__(
        self,
        app: ASGIApp,
        services: Services,
        names: Collection[str],
        cookie: SessionCookie,
        caller_finder: CallerFinder,
    ) -> None:
        self._app, self._names, self._cookie = app, names, cookie
        self._controller, self._uses_s = services.controller, services.key_uses_s
        self._caller_finder = caller_finder

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":  # the farm has no WebSockets
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        decision = self._check_request(scope)
        if not isinstance(decision, Refusal):
            is_allowed = partial(self._is_valid, decision)
            state = {**scope.get("state", {}), "caller": decision, "is_allowed": is_allowed}
            await self._app({**scope, "state": state}, receive, send_with_headers)
            return
        response = self._format_refusal(decision, scope["path"], Headers(scope=scope))
        response.headers["connection"] = "close"  # the body of the request is not read
        if decision.status == 401:
            response.headers["www-authenticate"] = "Bearer"
        await response(scope, receive, send_with_headers)

    def _format_refusal(self, refusal: Refusal, path: str, headers: Mapping[str, str]) -> Response:
        """Format a refusal as text for a slicer, as a page for a browser, or as JSON for other clients."""
        if is_slicer_path(path):
            return make_text_response(refusal.text, refusal.status)
        if "text/html" not in headers.get("accept", ""):
            return make_problem_response(refusal.text, ErrorCode.REFUSED, ExitCode.REFUSED, refusal.status)
        lacks_session = refusal.status == 401
        text = "You are not logged in, or your session has ended." if lacks_session else refusal.text
        page = render_message(self._controller.fleet.fleet.name, text, lacks_session)
        response = HTMLResponse(page, refusal.status)
        if lacks_session and self._cookie.read(headers.get("cookie", "")):
            self._cookie.clear(response)
        return response

    def _is_valid(self, caller: KeyHolder | Visitor) -> bool:
        """Return whether a caller's key or session is still valid and has the same role.

        A stream to the caller ends when this is no longer true.
        """
        if isinstance(caller, Visitor):
            return True
        key = self._controller.books.keys.get(caller.key.id)
        if key is None or not key.is_valid(self._controller.clock.now()):
            return False
        return self._caller_finder.find_role(key) is caller.role

    def _check_request(self, scope: Scope) -> KeyHolder | Visitor | Refusal:
        """Identify the caller and check its role; return the caller or a refusal."""
        headers = Headers(scope=scope)
        method, path, host = scope["method"], scope["path"], headers.get("host")
        site = headers.get("origin"), headers.get("sec-fetch-site")
        refusal = (
            check_head(scope.get("raw_path", b"") + scope["query_string"], scope["headers"])
            or check_host(host, self._names)
            or check_origin(method, host, *site)
        )
        if refusal is not None:
            return refusal
        client = (scope.get("client") or ("nobody",))[0]
        address = find_client_network(client) or client
        if is_public(method, path):
            # slicers do not state their origin
            refusal = None if is_slicer_path(path) else check_session_origin(method, *site)
            return refusal or Visitor(address)
        holder = self._caller_finder.find(headers, address)
        if isinstance(holder, Refusal):
            return holder
        needed_role = find_role(method, path)
        if needed_role is None:
            return Refusal(404, f"there is nothing at {path} for {method}")
        key = holder.key
        if not holder.role.allows(needed_role):
            return Refusal(403, f"this needs a key with the role {needed_role}; {key.name} has {holder.role}")
        if holder.has_session:
            refusal = check_session_origin(method, *site)
            if refusal is not None:
                return refusal
            self._caller_finder.extend_session(key)
        self._uses_s[key.id] = self._controller.clock.now()
        return holder
