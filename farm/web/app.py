"""HTTP application for callers on the network: the routes of `farm.web.access`, for keys with their roles.

Only what the table of roles lists is served. Every request passes the guard before a route sees it.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from fastapi import Depends, FastAPI, Response
from fastapi.responses import HTMLResponse, JSONResponse, PlainTextResponse
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import farm
from farm.api import NETWORK_PREFIX
from farm.control import Controller, DryRuns, JobCommands, PrinterCommands, find_key
from farm.errors import ErrorCode, ExitCode
from farm.http import (
    UPLOAD_PATH,
    BodyLimit,
    Services,
    add_routes,
    describe_farm,
    identify_caller,
    make_problem,
)
from farm.model import Key, Role
from farm.web.access import LIVENESS, METRICS, SCHEMA, SCHEMA_PAGE, find_role, is_open
from farm.web.api_page import POLICY, render_api_page
from farm.web.guard import Refusal, WrongKeys, check_host, check_origin
from farm.web.metrics import CONTENT_TYPE, write_metrics
from farm.web.openapi import describe_routes
from farm.web.slicers import PREFIXES, is_slicer_path, is_slicer_upload, make_text, octoprint_routes

log = logging.getLogger(__name__)

_HEADERS = {
    "content-security-policy": "default-src 'none'; frame-ancestors 'none'; base-uri 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-store",
}
_BEARER = "bearer "


@dataclass(frozen=True, slots=True)
class KeyHolder:
    """Caller on the network with a key."""

    key: Key

    @property
    def name(self) -> str:
        """Name for the event log."""
        return f"key {self.key.name}"

    def is_operator(self, group: str | None) -> bool:
        """Return whether the key has the role of an operator."""
        return self.key.role is Role.OPERATE


@dataclass(frozen=True, slots=True)
class Visitor:
    """Caller on the network without a key, at a route that needs none."""

    address: str

    @property
    def name(self) -> str:
        """Name for the event log."""
        return f"visitor at {self.address}"

    def is_operator(self, group: str | None) -> bool:
        """Return False: a visitor may do nothing."""
        return False


def make_web_app(services: Services, dry_runs: DryRuns, names: Collection[str]) -> ASGIApp:
    """Make the application for the network.

    Parameters
    ----------
    services
        Components of the daemon.
    dry_runs
        Kept alive by requests about their jobs.
    names
        Names of this host in lower case.
    """
    app = FastAPI(
        title="farm", version=farm.__version__, openapi_url=None, dependencies=[Depends(identify_caller)]
    )
    add_routes(app, services, dry_runs, NETWORK_PREFIX)
    jobs = JobCommands(services.controller, PrinterCommands(services.controller))
    for prefix in PREFIXES:
        app.include_router(octoprint_routes(services, jobs), prefix=prefix)
    app.add_middleware(
        BodyLimit, is_upload=lambda path: path == NETWORK_PREFIX + UPLOAD_PATH or is_slicer_upload(path)
    )

    @app.get(LIVENESS)
    async def liveness() -> dict[str, str]:
        return {"status": "ok"}

    @app.get(METRICS, response_class=PlainTextResponse)
    async def metrics() -> Response:
        context = services.controller.build_view_context(services.state)
        return Response(write_metrics(context, describe_farm(services)), media_type=CONTENT_TYPE)

    @app.get(SCHEMA, include_in_schema=False)
    async def schema() -> Response:
        return JSONResponse(describe_routes(app.routes))

    @app.get(SCHEMA_PAGE, include_in_schema=False)
    async def schema_page() -> Response:
        page = render_api_page(describe_routes(app.routes), SCHEMA)
        return HTMLResponse(page, headers={"content-security-policy": POLICY})

    controller = services.controller
    return Guard(app, controller, names, services.key_uses_s)


class Guard:
    """Middleware that refuses requests by host, origin, key and role, and adds security headers.

    Parameters
    ----------
    app
        The application behind it.
    controller
        Has the keys, and the farm's clock.
    names
        Names of this host in lower case.
    uses_s
        Receives the time of each key's last use.
    """

    def __init__(
        self, app: ASGIApp, controller: Controller, names: Collection[str], uses_s: dict[str, float]
    ) -> None:
        self._app, self._controller, self._names, self._uses_s = app, controller, names, uses_s
        self._wrong = WrongKeys()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":  # no web sockets
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        judged = self._judge(scope)
        if not isinstance(judged, Refusal):
            state = {**scope.get("state", {}), "person": judged}
            await self._app({**scope, "state": state}, receive, send_with_headers)
            return
        response = (
            make_text(judged.text, judged.status)
            if is_slicer_path(scope["path"])
            else make_problem(judged.text, ErrorCode.REFUSED, ExitCode.REFUSED, judged.status)
        )
        response.headers["connection"] = "close"  # the rest of its body is not read
        if judged.status == 401:
            response.headers["www-authenticate"] = "Bearer"
        await response(scope, receive, send_with_headers)

    def _judge(self, scope: Scope) -> KeyHolder | Visitor | Refusal:
        """Return the caller, or a refusal."""
        headers = Headers(scope=scope)
        method, path, host = scope["method"], scope["path"], headers.get("host")
        refusal = check_host(host, self._names) or check_origin(
            method, host, headers.get("origin"), headers.get("sec-fetch-site")
        )
        if refusal is not None:
            return refusal
        address = (scope.get("client") or ("nobody",))[0]
        if is_open(method, path):
            return Visitor(address)
        now_s = self._controller.clock.now()
        key = self._find_key(headers, address, now_s)
        if isinstance(key, Refusal):
            return key
        needed = find_role(method, path)
        if needed is None:
            return Refusal(404, f"there is nothing at {path} for {method}")
        if not key.role.allows(needed):
            return Refusal(403, f"this needs a key with the role {needed}; {key.name} has {key.role}")
        self._uses_s[key.id] = now_s
        return KeyHolder(key)

    def _find_key(self, headers: Mapping[str, str], address: str, now_s: float) -> Key | Refusal:
        text = headers.get("x-api-key") or _read_bearer(headers.get("authorization", ""))
        if not text:
            return Refusal(401, "this needs a key: an operator makes one by `farm key add NAME`")
        key = find_key(text, self._controller.books.keys, now_s)
        if key is not None:
            return key
        refusal = self._wrong.check(address, now_s)
        if refusal is None:
            self._wrong.add(address, now_s)
            log.warning("a wrong, expired or revoked key from %s", address)
        return refusal or Refusal(
            401, "this key is wrong, expired or revoked: `farm key` lists the valid ones"
        )


def _read_bearer(authorization: str) -> str:
    return authorization[len(_BEARER) :].strip() if authorization.lower().startswith(_BEARER) else ""
