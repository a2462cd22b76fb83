"""Service of a host with printers: ``python -m drivers.host.service FARM``, started by `farm host`.

It starts the agents of one farm on this host, watches them, and continues without the daemon. The daemon
connects to the service's socket; each stream of that connection leads to the socket of one agent. When the
service ends, the agents continue, and the next service finds them.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import time
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

from drivers.discovery import list_plugged_devices
from drivers.errors import AgentError, DriverError
from drivers.host.agent_supervisor import AgentSupervisor
from drivers.host.connection import MAX_LINE_BYTES, MuxConnection, MuxStream
from drivers.host.messages import (
    SILENCE_TIMEOUT_S,
    STATE_INTERVAL_S,
    HostMessage,
    HostRequest,
    HostState,
    PortState,
)
from drivers.host.paths import HostPaths, read_version
from drivers.host.relay import relay_stream
from drivers.host.update import AgentsUpdate
from drivers.locks import acquire_lock, write_pid
from drivers.log_file import rotate_log
from drivers.records import StartFile
from drivers.remote import Installation

log = logging.getLogger(__name__)

_CHECK_INTERVAL_S = 0.5
_PORT_INTERVAL_S = 10.0  # wall seconds between two lists of the ports
_UNUSED_TIMEOUT_S = 60.0  # wall seconds without agents and daemon after which the service ends


class HostService:
    """Agents of one farm on this host, and the connection to its daemon.

    Parameters
    ----------
    paths
        The service's files.
    """

    def __init__(self, paths: HostPaths) -> None:
        self._paths = paths
        self._supervisors: dict[str, AgentSupervisor] = {}
        self._daemon: MuxConnection | None = None
        self._daemon_writer: asyncio.StreamWriter | None = None
        self._last_message_s = time.monotonic()
        self._ports: tuple[PortState, ...] = ()
        self._change_event = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._report_interval_s = 1.0
        self._version, self._installation = read_version(), Installation.from_this_process()
        self._update = AgentsUpdate(self._installation, self._on_update)
        for start_file, kept_installation in paths.read_agents().values():
            self._add_agent(start_file, kept_installation)

    async def run(self) -> None:
        """Serve until there has been neither an agent nor a daemon for `_UNUSED_TIMEOUT_S`."""
        with self._paths.open_socket_path() as path:
            server = await asyncio.start_unix_server(self._serve_daemon, path, limit=MAX_LINE_BYTES)
        state_task = asyncio.create_task(self._send_states())
        port_task = asyncio.create_task(self._watch_ports())
        try:
            while self._supervisors or time.monotonic() - self._last_message_s < _UNUSED_TIMEOUT_S:
                self._check_agents()
                await asyncio.sleep(_CHECK_INTERVAL_S)
        finally:
            server.close()
            for task in (state_task, port_task, *self._tasks):
                task.cancel()
            await asyncio.gather(state_task, port_task, *self._tasks, return_exceptions=True)
            for supervisor in self._supervisors.values():
                await supervisor.close()

    # -- agents -----------------------------------------------------------------------------------------

    def _check_agents(self) -> None:
        for supervisor in list(self._supervisors.values()):
            supervisor.ensure_running()
            if not supervisor.is_wanted and not supervisor.is_alive:
                del self._supervisors[supervisor.printer]
                self._spawn(supervisor.close())
        self._update.step(list(self._supervisors.values()), self._spawn)
        if self._daemon_writer is not None and time.monotonic() - self._last_message_s > SILENCE_TIMEOUT_S:
            log.warning("the daemon is silent: closing its connection")
            self._daemon_writer.transport.abort()
        rotate_log(self._paths.log_file)

    def _set_agents(self, start_files: tuple[StartFile, ...]) -> None:
        """Run these agents from now on; end all others when they are idle."""
        for start_file in start_files:
            if start_file.printer in self._supervisors:
                supervisor = self._supervisors[start_file.printer]
                supervisor.start, supervisor.is_wanted = start_file, True
            else:
                try:
                    self._add_agent(start_file, None)
                except AgentError as error:
                    log.error("%s has no agent: %s", start_file.printer, error)
        names = {start_file.printer for start_file in start_files}
        for supervisor in self._supervisors.values():
            if supervisor.printer not in names and supervisor.is_wanted:
                supervisor.is_wanted = False
                self._spawn(self._retire_agent(supervisor))
        self._store_agents()
        self._check_agents()

    def _add_agent(self, start_file: StartFile, kept_installation: Installation | None) -> None:
        folder = self._paths.find_agent_folder(start_file.printer)
        self._supervisors[start_file.printer] = AgentSupervisor(
            start_file, folder, kept_installation, self._change_event.set
        )

    async def _retire_agent(self, supervisor: AgentSupervisor) -> None:
        """End an agent whose printer is no longer in the fleet, as soon as it is idle."""
        while not supervisor.is_wanted and supervisor.is_alive:
            with suppress(DriverError):
                await supervisor.end()
                log.info("%s is not in the fleet: its agent has ended", supervisor.printer)
            await asyncio.sleep(_CHECK_INTERVAL_S)

    def _on_update(self) -> None:
        self._store_agents()  # an agent may now keep another version
        self._change_event.set()

    def _store_agents(self) -> None:
        try:
            agents = [
                (supervisor.start, supervisor.kept_installation)
                for supervisor in self._supervisors.values()
                if supervisor.is_wanted
            ]
            self._paths.write_agents(agents)
        except OSError as error:
            log.error("%s: cannot be written (%s); check its disk", self._paths.folder, error)

    # -- daemon -----------------------------------------------------------------------------------------

    async def _serve_daemon(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(SILENCE_TIMEOUT_S):
                request = HostRequest.parse(await reader.readline())
        except (TimeoutError, OSError, ValueError, AgentError) as error:
            log.warning(
                "the first line of a daemon cannot be read: %s; install the same version on both hosts", error
            )
            writer.close()
            return
        if self._daemon_writer is not None:
            self._daemon_writer.transport.abort()  # the old connection may have ended unnoticed
        connection = MuxConnection(reader, writer, self._on_message, self._on_stream)
        self._daemon, self._daemon_writer = connection, writer
        self._last_message_s, self._report_interval_s = time.monotonic(), request.report_s
        log.info("the daemon has connected; it names %d printers", len(request.starts))
        self._set_agents(request.starts)
        self._change_event.set()
        try:
            await connection.run()
        except (OSError, DriverError) as error:
            log.warning("the connection to the daemon broke: %s", error)
        else:
            log.info("the daemon has disconnected")
        if self._daemon is connection:
            self._daemon = self._daemon_writer = None
            self._last_message_s = time.monotonic()

    def _on_message(self, data: bytes) -> None:
        self._last_message_s = time.monotonic()
        try:
            message = HostMessage.model_validate_json(data)
        except ValueError as error:
            log.warning("a message of the daemon cannot be read: %s", error)
            return
        if message.do == "agents":
            self._set_agents(message.starts)
        elif message.do == "update":
            self._update.begin()
            self._send_state()  # the daemon ignores results until it has seen that the update is running
        elif message.do == "halt":
            self._update.stop()
        self._change_event.set()

    def _on_stream(self, stream: MuxStream, name: str) -> None:
        supervisor = self._supervisors.get(name)
        if supervisor is None:
            stream.close(f"this host has no printer {name}")
            return
        self._spawn(relay_stream(stream, self._paths.find_agent_folder(name), self._report_interval_s))

    async def _send_states(self) -> None:
        """Send the host's state when it changes, and every `STATE_INTERVAL_S` as the heartbeat."""
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(STATE_INTERVAL_S):
                    await self._change_event.wait()
            self._change_event.clear()
            self._send_state()
            await asyncio.sleep(_CHECK_INTERVAL_S / 2)  # so that one state has the changes of many agents

    def _send_state(self) -> None:
        if self._daemon is not None:
            self._daemon.send_message(self._describe_host().encode())

    def _describe_host(self) -> HostState:
        return HostState(
            version=self._version,
            installation=self._installation.folder,
            pid=os.getpid(),
            agents=tuple(supervisor.describe() for supervisor in self._supervisors.values()),
            ports=self._ports,
            update=self._update.describe(list(self._supervisors.values())),
        )

    async def _watch_ports(self) -> None:
        while True:
            printer_ports = [
                (supervisor.printer, supervisor.start.port) for supervisor in self._supervisors.values()
            ]
            try:
                devices = await asyncio.to_thread(list_plugged_devices, printer_ports)
            except OSError as error:
                log.warning("the ports cannot be listed: %s", error)
            else:
                ports = tuple(
                    PortState(port=str(d.port), description=d.description, printer=d.printer) for d in devices
                )
                if ports != self._ports:
                    self._ports = ports
                    self._change_event.set()
            await asyncio.sleep(_PORT_INTERVAL_S)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


async def _run(paths: HostPaths) -> None:
    service = asyncio.ensure_future(HostService(paths).run())
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, service.cancel)
    with suppress(asyncio.CancelledError):
        await service


def run_service(farm: str) -> int:
    """Run the service of a farm on this host until it ends."""
    os.umask(0o077)
    paths = HostPaths(farm)
    logging.basicConfig(
        stream=sys.stdout, level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )
    paths.create_folder()
    lock = acquire_lock(paths.lock_file)
    if lock is None:
        logging.error("%s: another service has this host's agents", paths.folder)
        return 1
    paths.write_version()
    write_pid(lock)
    asyncio.run(_run(paths))
    return 0


if __name__ == "__main__":
    sys.exit(run_service(sys.argv[1]))
