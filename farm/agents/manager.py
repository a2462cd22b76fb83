"""Manager of the fleet's agents: it starts them, connects to them, sends them requests, and ends them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Collection, Iterable
from pathlib import Path

from drivers import messages as m
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.remote import NO_AGENT_REASON, AgentClient, Route, is_alive
from farm.agents.connection import AgentConnection, AgentListener
from farm.agents.hosts import Hosts
from farm.agents.protocol_adapter import make_agent_request
from farm.agents.remote import delete_route, load_route, remove_start_file
from farm.config import Fleet
from farm.errors import NotFoundError, RefusedError
from farm.paths import StateFolder
from farm.state import Books
from farm.state import events as ev

log = logging.getLogger(__name__)


class AgentManager:
    """Manager of the connections to all agents of the fleet."""

    def __init__(self, fleet: Fleet, state: StateFolder, clock: Clock, listener: AgentListener) -> None:
        self._state, self._clock, self._listener = state, clock, listener
        self._orphan_task: asyncio.Task[None] | None = None
        self.hosts = Hosts(fleet, state, clock, listener)
        self._connections = {
            section.name: AgentConnection(
                section.name,
                section,
                state,
                clock,
                listener,
                fleet.fleet.name,
                self.hosts.find_connection(section.name),
            )
            for section in fleet.printers
            if section.enabled
        }

    def start(self, printing_printers: Iterable[str], lost_hosts: Collection[str] = ()) -> None:
        """Connect to the running agents, start the others, and listen to all of them.

        Parameters
        ----------
        printing_printers
            Names of the printers with an open print in the books. Their agents are monitored even if the
            printer was removed from `fleet.yaml`.
        lost_hosts
            Hosts whose loss the books have already recorded.
        """
        for name in printing_printers:
            if name not in self._connections:
                self._connections[name] = AgentConnection(
                    name, None, self._state, self._clock, self._listener
                )
        self.hosts.start(lost_hosts)
        for connection in self._connections.values():
            connection.start()
        self._orphan_task = asyncio.create_task(self._end_orphans())

    async def _end_orphans(self) -> None:
        """End idle agents of printers that are no longer in the fleet, because they may block a port."""
        for folder in sorted((self._state.root / "agents").glob("*/")):
            if folder.name in self._connections:
                continue
            route = remove_start_file(load_route(folder, None, "", self._clock))
            if route is not None or is_alive(folder):
                await self._end_orphan(folder, route)

    async def _end_orphan(self, folder: Path, route: Route | None) -> None:
        client, has_ended = AgentClient(folder, route), False
        try:
            await client.connect()
            reply = await client.request(m.Shutdown(id=0))
            log.info(
                "%s is not in the fleet: its agent %s",
                folder.name,
                "ends" if reply.error is None else f"does not end: {reply.error}",
                extra={"printer": folder.name},
            )
            has_ended = reply.error is None
        except DriverError as error:
            has_ended = NO_AGENT_REASON in str(error)
            if not has_ended:
                log.warning(
                    "%s is not in the fleet, and its agent does not answer: %s",
                    folder.name,
                    error,
                    extra={"printer": folder.name},
                )
        finally:
            await client.close()
        if has_ended:
            delete_route(folder)

    def watch(self) -> None:
        """Restart the agents that have died or hang, and report the hosts that are lost."""
        for connection in self._connections.values():
            connection.ensure_running()
        self.hosts.watch()

    def perform(self, instruction: ev.AnyInstruction, books: Books, files: Path) -> None:
        """Send an instruction to an agent. If that fails, it is sent again after the next snapshot."""
        request = make_agent_request(instruction, books, files)
        connection = self._connections.get(getattr(instruction, "printer", ""))
        if request is not None and connection is not None:
            connection.send(request)

    async def replace_agent(self, name: str) -> None:
        """Replace the agent of an idle printer. Raises NotFoundError or RefusedError."""
        connection = self._connections.get(name)
        if connection is None:
            raise NotFoundError(f"there is no enabled printer {name}; see `farm status`")
        try:
            await connection.replace_agent()
        except DriverError as error:
            raise RefusedError(str(error)) from error

    async def read_lines(self, name: str) -> list[m.WireLine]:
        """Read the last lines that an agent and its board exchanged. Raises NotFoundError or RefusedError."""
        connection = self._connections.get(name)
        if connection is None:
            raise NotFoundError(f"there is no enabled printer {name}; see `farm status`")
        try:
            return await connection.read_lines()
        except DriverError as error:
            raise RefusedError(f"the lines of {name} cannot be read: {error}") from error

    async def shut_down_agents(self) -> None:
        """End every agent, and switch the simulated printers off."""
        self.hosts.release_agents()
        await asyncio.gather(*(connection.shut_down() for connection in self._connections.values()))

    async def close(self) -> None:
        """Close the connections; the agents continue."""
        if self._orphan_task is not None:
            self._orphan_task.cancel()
            await asyncio.gather(self._orphan_task, return_exceptions=True)
        await asyncio.gather(*(connection.close() for connection in self._connections.values()))
        await self.hosts.close()
