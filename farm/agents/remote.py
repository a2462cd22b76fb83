"""Routes to agents on other hosts: the ssh command, and the first line to send.

Each route is stored, because an agent may be running after its printer was removed from the fleet.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from drivers.clock import Clock
from drivers.errors import AgentError
from drivers.records import StartFile
from drivers.remote import BridgeRequest, BridgeTask, Route, build_ssh_command
from farm.config import PrinterSection

ROUTE_FILE = "way.json"  # in the folder that the daemon keeps for each agent


def make_start_file(section: PrinterSection, clock: Clock) -> StartFile:
    """Return the start file of a printer's agent."""
    return StartFile(
        section.name, section.model, section.port, clock.scale, clock.anchor_s, section.power_off_cmd
    )


def _build_route(section: PrinterSection, farm_name: str, clock: Clock) -> Route | None:
    """Return the route to a printer's agent if it runs on another host, otherwise None."""
    if section.host is None:
        return None
    request = BridgeRequest(BridgeTask.SERVE, farm_name, make_start_file(section, clock))
    return build_ssh_command(section.host, section.host_command), request.serialise()


def remove_start_file(route: Route | None) -> Route | None:
    """Return a route without the agent's start file, so that no agent is started when the route is used."""
    if route is None:
        return None
    try:
        request = BridgeRequest.parse(route[1])
    except AgentError:  # an earlier version stored the route in another format
        return None
    return route[0], replace(request, do=BridgeTask.REACH).serialise()


def load_route(folder: Path, section: PrinterSection | None, farm_name: str, clock: Clock) -> Route | None:
    """Return the route to a printer's agent, and store it in a folder; None for an agent on this host.

    `section` is None for a printer that was removed from the fleet; its stored route is returned.
    """
    route_file = folder / ROUTE_FILE
    if section is None:
        try:
            command, line = json.loads(route_file.read_text())
            return list(map(str, command)), str(line).encode()
        except (OSError, ValueError, TypeError):
            return None
    route = _build_route(section, farm_name, clock)
    if route is None:
        route_file.unlink(missing_ok=True)
    else:
        folder.mkdir(parents=True, exist_ok=True)
        route_file.write_text(json.dumps((route[0], route[1].decode())))
    return route


def delete_route(folder: Path) -> None:
    """Delete the stored route to an agent that has ended."""
    (folder / ROUTE_FILE).unlink(missing_ok=True)
