"""Routes of network keys and browser sessions; the daemon offers them only on the Unix socket."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Depends

from farm import api
from farm.control import LINK_LIFETIME_S, KeyCommands
from farm.errors import RefusedError
from farm.http.callers import Caller, OperatorName, find_session_role, identify_caller
from farm.http.services import Services
from farm.views import ViewContext


def make_key_routes(services: Services, keys: KeyCommands) -> APIRouter:
    """Return the routes of keys, and of the requests of programs for keys."""
    router, controller = APIRouter(), services.controller

    @router.get("/keys")
    async def show_keys(_: OperatorName) -> api.Keys:
        context = controller.build_view_context(services.state)
        return api.Keys(
            now=context.format_time(context.now_s) or "",
            network=services.network.describe(),
            keys=list_keys(context, services.key_uses_s),
            requests=[
                api.AppKeyRequestView(code=request.code, app=request.app, address=request.address)
                for request in services.app_key_requests.list_open_requests(time.monotonic())
            ],
        )

    @router.post("/keys")
    async def add_key(request: api.KeyRequest, operator_name: OperatorName) -> api.NewKey:
        return keys.add(request, operator_name)

    @router.post("/keys/{key_id}/revoke")
    async def revoke_key(key_id: str, operator_name: OperatorName) -> None:
        keys.revoke(key_id, operator_name)

    @router.post("/keys/requests/{code}/grant")
    async def grant_key(code: str, grant: api.AppKeyGrant, operator_name: OperatorName) -> api.NameResponse:
        return api.NameResponse(
            name=services.app_key_requests.grant(code, grant, operator_name, keys, time.monotonic())
        )

    @router.post("/keys/requests/{code}/deny")
    async def deny_key(code: str, _: OperatorName) -> None:
        services.app_key_requests.deny(code, time.monotonic())

    return router


def make_session_routes(services: Services) -> APIRouter:
    """Return the routes of browser sessions."""
    router, controller = APIRouter(), services.controller

    @router.post("/sessions/link")
    async def make_link(caller: Annotated[Caller, Depends(identify_caller)]) -> api.LoginLink:
        network = services.network
        if network.browser_url is None:
            raise RefusedError(
                "the farm does not listen on the network: write `web: {}` into fleet.yaml, then `farm up`"
            )
        if network.problem is not None:
            raise RefusedError(f"the farm does not listen on the network: {network.problem}")
        role = find_session_role(caller, controller.fleet.fleet.operators)
        token = services.sessions.make_link(caller.name, role)
        return api.LoginLink(
            url=f"{network.browser_url}/login/{token}", user=caller.name, role=role, valid_s=LINK_LIFETIME_S
        )

    @router.post("/sessions/end")
    async def end_sessions(operator_name: OperatorName) -> api.EndedSessions:
        return services.sessions.end_all_sessions(operator_name)

    return router


def list_keys(context: ViewContext, last_uses_s: Mapping[str, float]) -> list[api.KeyView]:
    """List all keys and sessions, the newest last.

    Parameters
    ----------
    context
        State of the farm, and the present time.
    last_uses_s
        Time of the last use of each key since the daemon started, by the key's id.
    """
    return [
        api.KeyView(
            id=key.id,
            kind=key.kind,
            name=key.name,
            role=key.role,
            valid=key.is_valid(context.now_s),
            by=key.by,
            created=context.format_time(key.created_s) or "",
            used=context.format_time(last_uses_s.get(key.id)),
            expires=context.format_time(key.expires_s),
            revoked=context.format_time(key.revoked_s),
        )
        for key in sorted(context.books.keys.values(), key=lambda key: key.created_s)
    ]
