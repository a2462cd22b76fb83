"""Descriptions of hosts with printers. Pure."""

from __future__ import annotations

from farm import api
from farm.agents import HostRecord
from farm.views import ViewContext


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
