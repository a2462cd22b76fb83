"""Routes of keys for callers on the network; on the Unix socket alone."""

from __future__ import annotations

from fastapi import APIRouter

from farm import api
from farm.control import KeyCommands
from farm.http.callers import OperatorName
from farm.http.services import Services
from farm.views import list_keys


def key_routes(services: Services, keys: KeyCommands) -> APIRouter:
    """Return the routes of keys."""
    router, controller = APIRouter(), services.controller

    @router.get("/keys")
    async def show_keys(_: OperatorName) -> api.Keys:
        context = controller.build_view_context(services.state)
        return api.Keys(
            now=context.format_time(context.now_s) or "",
            network=services.network.describe(),
            keys=list_keys(context, services.key_uses_s),
        )

    @router.post("/keys")
    async def add_key(request: api.KeyRequest, by: OperatorName) -> api.NewKey:
        return keys.add(request, by)

    @router.post("/keys/{name}/revoke")
    async def revoke_key(name: str, by: OperatorName) -> None:
        keys.revoke(name, by)

    return router
