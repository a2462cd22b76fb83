"""Components of the daemon that its routes use."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path

import farm
from drivers.messages import WireLine
from farm import api
from farm.agents import Hosts
from farm.cameras import Image
from farm.compute import Pool
from farm.compute.cluster import ClusterPool
from farm.control import AppKeyRequests, Controller, SessionCommands
from farm.errors import NotFoundError, RefusedError
from farm.http.callers import find_user_role
from farm.http.event_streams import EmptyEventLog, EventStreams
from farm.http.stream_limit import StreamLimit
from farm.http.uploads import Uploads
from farm.model import Role
from farm.paths import StateFolder
from farm.views import ViewContext


async def refuse_replacement(name: str) -> None:
    """Refuse to replace an agent, because the farm has no agents."""
    raise RefusedError(f"{name} has no agent")


async def refuse_stills(printer: str) -> Image:
    """Refuse to fetch a camera picture, because the farm has no cameras."""
    raise NotFoundError(f"{printer} has no camera")


async def refuse_reading(printer: str) -> list[WireLine]:
    """Refuse to read the last lines on a printer's serial port, because the farm has no agents."""
    raise RefusedError(f"{printer} has no agent")


async def refuse_pruning(operator_name: str, dry_run: bool) -> api.PruneResponse:
    """Refuse to delete old files, because the daemon runs without `Upkeep`."""
    action = "preview a prune" if dry_run else "prune"
    raise RefusedError(f"{operator_name} cannot {action}: this daemon keeps the files of all jobs")


@dataclass(slots=True)
class NetworkState:
    """State of the server for callers on the network.

    Attributes
    ----------
    address
        URL of the address on which the server listens; None if fleet.yaml configures no such server.
    browser_url
        URL at which browsers reach the server.
    problem
        Reason why the server accepts no connections; None if it accepts them.
    """

    address: str | None = None
    browser_url: str | None = None
    problem: str | None = None

    def describe(self) -> api.NetworkView:
        """Describe the server for operators."""
        return api.NetworkView(address=self.address, problem=self.problem)


@dataclass(frozen=True)
class Services:
    """Components of the daemon that its routes use.

    Attributes
    ----------
    controller
        Controller of the farm's state.
    state
        The state folder.
    fleet_file
        Path of `fleet.yaml`, for display.
    workers
        Processes that inspect models.
    cluster
        The cluster that computes plans; None if the daemon's host computes them.
    hosts
        Other computers that run agents, and the connections to them; None for a farm without agents.
    shut_down
        Function that shuts the farm down; given True, it stops all prints first.
    prune
        Function that deletes files and events that exceed the limits of `fleet.keep`, at the request of the
        named user; given True, it only lists them.
    replace_agent
        Function that replaces the agent of an idle printer.
    fetch_still
        Function that returns a picture from the camera of a printer.
    read_lines
        Function that reads the last lines on the serial port of a printer.
    network
        State of the server for callers on the network.
    key_uses_s
        Time of the last use of each key since the daemon started, by the key's id.
    inspections
        Names of the models that are being inspected, by the files of their uploads.
    streams
        Streams of the event log.
    page_streams
        Streams of pages in browsers.
    sessions
        Commands on the sessions of browsers.
    uploads
        Open uploads of all callers, which are limited in number and total size.
    app_key_requests
        Requests of programs for keys.
    find_user_role
        Function that returns the current role of a user, given the user's name and the group of operators.
    """

    controller: Controller
    state: StateFolder
    fleet_file: Path
    workers: Pool
    shut_down: Callable[[bool], Awaitable[None]]
    replace_agent: Callable[[str], Awaitable[None]] = refuse_replacement
    prune: Callable[[str, bool], Awaitable[api.PruneResponse]] = refuse_pruning
    fetch_still: Callable[[str], Awaitable[Image]] = refuse_stills
    read_lines: Callable[[str], Awaitable[list[WireLine]]] = refuse_reading
    network: NetworkState = field(default_factory=NetworkState)
    key_uses_s: dict[str, float] = field(default_factory=dict)
    inspections: dict[Path, str] = field(default_factory=dict)
    streams: EventStreams = field(default_factory=lambda: EventStreams(EmptyEventLog()))
    page_streams: StreamLimit = field(default_factory=StreamLimit)
    app_key_requests: AppKeyRequests = field(default_factory=AppKeyRequests)
    find_user_role: Callable[[str, str | None], Role | None] = find_user_role
    cluster: ClusterPool | None = None
    hosts: Hosts | None = None
    sessions: SessionCommands = field(init=False)
    uploads: Uploads = field(init=False)
    started_s: float = field(init=False)

    def __post_init__(self) -> None:
        uploads = Uploads(self.controller, self.state, self.workers, self.inspections)
        object.__setattr__(self, "uploads", uploads)
        object.__setattr__(self, "started_s", self.controller.started_s)
        object.__setattr__(self, "sessions", SessionCommands(self.controller))

    def describe_daemon(self, context: ViewContext) -> api.DaemonView:
        """Describe this daemon: process, version and start time."""
        return api.DaemonView(
            pid=os.getpid(), version=farm.__version__, since=context.format_time(self.started_s) or ""
        )
