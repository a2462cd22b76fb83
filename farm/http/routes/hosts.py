"""Routes of hosts with printers."""

from __future__ import annotations

from fastapi import APIRouter

from farm import api
from farm.errors import Refused
from farm.http.callers import OperatorName
from farm.http.hosts_view import describe_host
from farm.http.services import Services


def make_host_routes(services: Services) -> APIRouter:
    """Return the routes of hosts."""
    router = APIRouter()

    @router.get("/hosts")
    async def show_hosts() -> api.HostList:
        context = services.controller.build_view_context(services.state)
        records = [] if services.hosts is None else services.hosts.records
        return api.HostList(
            now=context.format_time(context.now_s) or "",
            hosts=[describe_host(context, record) for record in records],
        )

    @router.post("/hosts/update")
    async def update_agents(by: OperatorName) -> api.HostUpdate:
        hosts = () if services.hosts is None else services.hosts.begin_update(by)
        if not hosts:
            raise Refused("no connected host has agents of a version other than its service's")
        return api.HostUpdate(hosts=list(hosts))

    return router
