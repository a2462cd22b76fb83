"""Routes of other computers that run agents, and descriptions of these hosts."""

from __future__ import annotations

from fastapi import APIRouter

from farm import api
from farm.agents import HostRecord
from farm.errors import RefusedError
from farm.http.callers import OperatorName
from farm.http.services import Services
from farm.views import ViewContext


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
    async def update_agents(operator_name: OperatorName) -> api.HostUpdate:
        hosts = () if services.hosts is None else services.hosts.begin_update(operator_name)
        if not hosts:
            raise RefusedError(
                "the agents of all connected hosts already have the version of their host's service"
            )
        return api.HostUpdate(hosts=list(hosts))

    return router


def describe_host(context: ViewContext, record: HostRecord) -> api.HostView:
    """Describe a host by its current state, or by its last state if it is not connected."""
    state = record.state
    return api.HostView(
        host=record.host,
        connected=context.format_time(record.connected_s),
        lost=context.format_time(record.disconnected_s),
        waiting=record.describe_wait(),
        version=None if state is None else state.version,
        printers=list(record.printers),
        agents=[
            api.HostAgentView(
                printer=agent.printer,
                state=agent.phase,
                pid=agent.pid,
                restarts=agent.restarts,
                installation=agent.installation,
                reason=agent.reason,
            )
            for agent in (() if state is None else state.agents)
        ],
        ports=[
            api.HostPortView(port=port.port, description=port.description, printer=port.printer)
            for port in (() if state is None else state.ports)
        ],
        update=None if state is None else state.update.phase,
    )
