"""Connections to the hosts with printers: one connection carries the data of all agents of a host."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import Protocol

from drivers.clock import Clock
from drivers.errors import AgentError, DriverError
from drivers.host import (
    MAX_LINE_BYTES,
    SILENCE_TIMEOUT_S,
    STATE_INTERVAL_S,
    HostMessage,
    HostRequest,
    HostState,
    HostTask,
    MuxConnection,
    UpdatePhase,
)
from drivers.log_file import rotate_log
from drivers.remote import build_ssh_command, runs_host_service
from farm.agents.host_record import FIRST_LOSS_DELAY_S, HostChange, HostRecord
from farm.agents.remote import make_start_file
from farm.agents.rollout import plan_rollout
from farm.config import Fleet, PrinterSection
from farm.errors import FarmError
from farm.paths import StateFolder
from farm.state import events as ev

log = logging.getLogger(__name__)

_MAX_WAIT_S = 15.0  # maximum wall seconds between two attempts to connect
_STABLE_CONNECTION_S = 30.0  # wall seconds after which a connection counts as stable
_OPEN_TIMEOUT_S = 60.0  # maximum wall seconds for which `open` waits for the connection
_MAX_REPORTS_PER_S = 200.0
_MAX_REPORT_INTERVAL_S = 5.0


class HostListener(Protocol):
    """Receiver of the events of hosts."""

    def handle(self, *events: ev.AnyEvent) -> None:
        """Record events."""

    def warn(self, topic: str, text: str | None) -> None:
        """Show a problem to people under a topic; remove the problem if `text` is None."""


def compute_report_interval_s(printer_count: int) -> float:
    """Compute the interval between two reports from a printer that is printing, in a fleet of this size.

    In a fleet of up to 200 printers, each reports every second. In a larger fleet, each reports less often,
    to limit the number of reports that the daemon reads per second, but at least every five seconds.
    """
    return min(_MAX_REPORT_INTERVAL_S, max(1.0, printer_count / _MAX_REPORTS_PER_S))


class HostConnection:
    """Connection to the service of one host. After a loss, it connects again, until `close` is called.

    Parameters
    ----------
    request
        First line sent on the connection: the name of the farm, and the agents of the host.
    command
        Command that runs `farm host` on the host, and connects its stdin and stdout.
    log_file
        File for the stderr of ssh.
    record
        Record of the host, which the connection updates.
    clock
        The farm's clock.
    """

    def __init__(
        self, request: HostRequest, command: Sequence[str], log_file: Path, record: HostRecord, clock: Clock
    ) -> None:
        self.record = record
        self._request, self._command, self._log_file, self._clock = request, command, log_file, clock
        self._mux: MuxConnection | None = None
        self._connected_event = asyncio.Event()
        self._last_message_s = 0.0
        self._task: asyncio.Task[None] | None = None

    def describe_loss(self) -> str | None:
        """Return the reason why the host cannot be reached; None if it is connected."""
        if self._connected_event.is_set() and self._mux is not None and not self._mux.is_lost:
            return None
        return f"no connection to its host {self.record.host}: {self.record.reason}"

    def start(self) -> None:
        """Start connecting, in the background."""
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._maintain_connection())

    async def open(self, printer: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Wait for the connection, then open a stream to an agent. Raises AgentError after a minute."""
        try:
            async with asyncio.timeout(_OPEN_TIMEOUT_S):
                await self._connected_event.wait()
        except TimeoutError:
            raise AgentError(f"no connection to {self.record.host}: {self.record.reason}") from None
        assert self._mux is not None
        return self._mux.open(printer)

    def send(self, message: HostMessage) -> None:
        """Send a message to the host. Raises AgentError if it is not connected."""
        if self._mux is None or not self._connected_event.is_set():
            raise AgentError(f"{self.record.host} is not connected: {self.record.reason}")
        self._mux.send_message(message.encode())

    def release_agents(self) -> None:
        """Allow the host to end its agents when they are idle; it starts none until the next connection."""
        with suppress(AgentError):
            self.send(HostMessage(do="agents"))

    async def close(self) -> None:
        """Disconnect; the service and its agents continue."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _maintain_connection(self) -> None:
        wait_s = 0.0
        while True:
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s + 1.0, _MAX_WAIT_S)
            started_s, reason = time.monotonic(), "the connection was closed"
            try:
                await self._run_connection()
            except (OSError, ValueError, DriverError, TimeoutError) as error:
                reason = str(error) or "time-out"
            except Exception as error:
                log.exception("the connection to %s failed", self.record.host)
                reason = str(error)
            log.warning("no connection to %s: %s", self.record.host, reason)
            self.record.on_lost(self._clock.now(), reason)
            if time.monotonic() - started_s > _STABLE_CONNECTION_S:
                wait_s = 0.0

    async def _run_connection(self) -> None:
        """Connect, and transfer data until the connection breaks. Raises OSError or DriverError."""
        self._log_file.parent.mkdir(parents=True, exist_ok=True)
        rotate_log(self._log_file)
        with self._log_file.open("ab") as output:
            process = await asyncio.create_subprocess_exec(
                *self._command,
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=output,
                limit=MAX_LINE_BYTES,
                start_new_session=True,
            )
        try:
            reader, writer = process.stdout, process.stdin
            assert reader is not None and writer is not None
            writer.write(self._request.serialise())
            self._mux = MuxConnection(reader, writer, self._on_message)
            mux_task = asyncio.create_task(self._mux.run())
            try:
                await self._send_heartbeats(mux_task)
            finally:
                self._connected_event.clear()
                mux_task.cancel()
                await asyncio.gather(mux_task, return_exceptions=True)
        finally:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    async def _send_heartbeats(self, mux_task: asyncio.Task[None]) -> None:
        """Send heartbeats until `mux_task` ends or the host sends nothing for too long. Raises AgentError."""
        started_s = self._last_message_s = time.monotonic()
        while True:
            done_tasks, _ = await asyncio.wait([mux_task], timeout=STATE_INTERVAL_S)
            if done_tasks:
                mux_task.result()
                raise AgentError(_read_last_line(self._log_file))
            now_s = time.monotonic()
            limit_s = SILENCE_TIMEOUT_S if self._connected_event.is_set() else FIRST_LOSS_DELAY_S
            if now_s - max(self._last_message_s, started_s) > limit_s:
                raise AgentError(f"no message for {limit_s:g} s")
            if self._connected_event.is_set():
                self.send(HostMessage(do="ping"))

    def _on_message(self, data: bytes) -> None:
        self._last_message_s = time.monotonic()
        try:
            state = HostState.model_validate_json(data)
        except ValueError as error:
            log.warning("%s: a message cannot be read: %s", self.record.host, error)
            return
        if not self._connected_event.is_set():
            log.info("connected to %s, farm %s, pid %d", self.record.host, state.version, state.pid)
        self.record.on_state(self._clock.now(), state)
        self._connected_event.set()


class Hosts:
    """Connections to all hosts that run the service `farm host`.

    Parameters
    ----------
    fleet, state, clock
        The farm's fleet, state folder and clock.
    listener
        Receiver of the events of hosts.
    """

    def __init__(self, fleet: Fleet, state: StateFolder, clock: Clock, listener: HostListener) -> None:
        self._listener, self._clock = listener, clock
        self._connections: dict[str, HostConnection] = {}
        self._connections_by_printer: dict[str, HostConnection] = {}
        # Hosts whose update has begun, in order; None while no update is in progress.
        self._updating_hosts: tuple[str, ...] | None = None
        interval_s = compute_report_interval_s(len(fleet.printers))
        for host, command, sections in _group_printers_by_host(fleet):
            start_files = tuple(make_start_file(section, clock) for section in sections)
            request = HostRequest(
                do=HostTask.CARRY, farm=fleet.fleet.name, starts=start_files, report_s=interval_s
            )
            connection = HostConnection(
                request,
                build_ssh_command(host, command),
                state.root / "hosts" / f"{host}.log",
                HostRecord(host, tuple(section.name for section in sections), clock.now()),
                clock,
            )
            self._connections[host] = connection
            self._connections_by_printer |= dict.fromkeys((section.name for section in sections), connection)

    @property
    def records(self) -> list[HostRecord]:
        """Records of all hosts, in the order of the hosts' names."""
        return [self._connections[host].record for host in sorted(self._connections)]

    def start(self, lost_hosts: Collection[str] = ()) -> None:
        """Start connecting to all hosts; the loss of those in `lost_hosts` has already been reported."""
        for connection in self._connections.values():
            connection.record.is_loss_reported = connection.record.host in lost_hosts
            connection.start()

    def find_connection(self, printer: str) -> HostConnection | None:
        """Return the connection to the host of a printer; None if its host does not run `farm host`."""
        return self._connections_by_printer.get(printer)

    def watch(self) -> None:
        """Record events for hosts that were lost or have reconnected, and continue an update.

        If an event cannot be recorded, the next call tries again.
        """
        now_s = self._clock.now()
        for record in self.records:
            change = record.find_change(now_s, self._clock.scale)
            if change is None:
                continue
            is_lost = change is HostChange.LOST
            try:
                self._listener.handle(
                    ev.HostLost(at_s=now_s, host=record.host, printers=record.printers, reason=record.reason)
                    if is_lost
                    else ev.HostConnected(at_s=now_s, host=record.host, printers=record.printers)
                )
            except FarmError as error:
                log.error("%s", error)
                continue
            record.is_loss_reported = is_lost
        if self._updating_hosts is not None:
            self._roll_out(self._updating_hosts)

    def on_clock_set(self, step_s: float) -> None:
        """Shift the times of all connections by a step of the clock, so that durations stay the same."""
        for record in self.records:
            record.shift_times(step_s)

    def begin_update(self, caller_name: str) -> tuple[str, ...]:
        """Begin to update the agents of each host to the version of the service on that host.

        Returns
        -------
        tuple of str
            The hosts whose agents and service have different versions.
        """
        outdated_hosts = tuple(
            record.host
            for record in self.records
            if record.state is not None and record.state.update.phase is not UpdatePhase.CURRENT
        )
        if outdated_hosts:
            log.info("%s is updating the agents of %s", caller_name, " ".join(outdated_hosts))
            self._updating_hosts = ()
            self._listener.warn("update", None)
        return outdated_hosts

    def _roll_out(self, updating_hosts: tuple[str, ...]) -> None:
        step = plan_rollout({record.host: record.update for record in self.records}, updating_hosts)
        for host in step.hosts_to_begin:
            connection = self._connections[host]
            try:
                connection.send(HostMessage(do="update"))
            except AgentError as error:  # the next call sends the request again
                log.info("%s", error)
                continue
            connection.record.on_update_begun()
            updating_hosts = updating_hosts if host in updating_hosts else (*updating_hosts, host)
        for host in step.hosts_to_halt:
            with suppress(AgentError):
                self._connections[host].send(HostMessage(do="halt"))
        if step.fault is not None:
            log.error("the update of the agents has stopped: %s", step.fault)
            self._listener.warn("update", f"the update of the agents has stopped: {step.fault}")
        self._updating_hosts = None if step.is_finished else updating_hosts

    def release_agents(self) -> None:
        """Allow all hosts to end their idle agents, and to start none until the next connection."""
        for connection in self._connections.values():
            connection.release_agents()

    async def close(self) -> None:
        """Disconnect from all hosts; their agents continue."""
        await asyncio.gather(*(connection.close() for connection in self._connections.values()))


def _group_printers_by_host(fleet: Fleet) -> Iterator[tuple[str, str, list[PrinterSection]]]:
    """Yield each host with its command and its enabled printers.

    Raises
    ------
    FarmError
        If printers of one host have different commands: a host can have only one service.
    """
    sections = [s for s in fleet.printers if s.enabled and runs_host_service(s.host_command) and s.host]

    def read_host(section: PrinterSection) -> str:
        return str(section.host)

    for host, group in groupby(sorted(sections, key=read_host), read_host):
        printers = list(group)
        commands = sorted({section.host_command for section in printers})
        if len(commands) > 1:
            raise FarmError(
                f"the printers of {host} have different commands ({'; '.join(commands)}): give them the same "
                "`host_command` in fleet.yaml"
            )
        yield host, commands[0], printers


def _read_last_line(path: Path) -> str:
    lines = path.read_text(errors="replace").strip().splitlines() if path.exists() else []
    return lines[-1] if lines else "the connection was closed"
