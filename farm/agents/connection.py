"""Connection to one agent: it starts the agent, receives its snapshots, and sends it requests."""

from __future__ import annotations

import asyncio
import base64
import logging
import subprocess
import time
from collections import deque
from collections.abc import Coroutine, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import Command, control
from drivers.emulator.launch import is_running as emulator_is_running
from drivers.errors import AgentError, AgentTooOld, DriverError
from drivers.remote import (
    RETRY_INTERVAL_S,
    AgentClient,
    Heartbeat,
    agents_are_units,
    find_agent_pid,
    is_alive,
    kill_agent,
    sample_process,
    spawn_agent,
)
from farm.agents.hosts import HostConnection, HostListener
from farm.agents.protocol_adapter import (
    compute_clock_offset_s,
    to_agent_clock,
    to_farm_lines,
    to_farm_print,
    to_farm_snapshot,
)
from farm.agents.remote import load_route
from farm.config import PrinterSection
from farm.errors import FarmError
from farm.log_format import PrinterLog
from farm.model import AgentPrint, AgentSnapshot, Link
from farm.paths import StateFolder

log = logging.getLogger(__name__)

_MAX_STARTS_PER_MINUTE = 6
_SILENCE_TIMEOUT_S = 30.0  # wall seconds; an agent that works reports at least every 5 s
_END_TIMEOUT_S = 30.0  # wall seconds within which an idle agent must end
_MAX_WAIT_S = 15.0  # wall seconds between two attempts to reach an agent
_STABLE_CONNECTION_S = 30.0  # wall seconds after which a connection counts as stable
_CHUNK_BYTES = 32 * 1024  # size of a chunk of an uploaded file; an agent accepts lines up to 64 KiB
_START_TIMEOUT_S = 120.0  # wall seconds after which an agent refuses to start a print
_CLEARED_KEY = ("cleared", "")  # key of a pending `BedCleared`
_EMULATOR_FOLDER = "emulator"  # folder of the emulator of a sim:// port, in the agent's folder


class AgentListener(HostListener, Protocol):
    """Receiver of reports from agents, and of events of their hosts."""

    def on_snapshot(self, snapshot: AgentSnapshot) -> None:
        """Handle a snapshot."""

    def on_refusal(self, print_id: str, reason: str, is_late: bool) -> None:
        """Handle a refusal to start a print; `is_late` also stands for an agent of an older version."""

    def find_unreported_since_s(self, printer: str) -> float | None:
        """Return the time after which the books may lack prints of an agent; None if they have all prints."""

    def on_journal(self, snapshot: AgentSnapshot, prints: Sequence[AgentPrint]) -> None:
        """Handle an agent's snapshot and the prints in its journal that the books may lack."""


class AgentConnection:
    """Connection to one agent: it starts the agent, receives its snapshots, and sends it requests.

    Parameters
    ----------
    name
        The printer.
    section
        The printer's section of `fleet.yaml`. If it is None, the connection uses an agent that is running,
        but starts none.
    state, clock
        The farm's state folder and clock.
    listener
        Receiver of the agent's reports.
    farm_name
        Name of the farm. It is sent to an agent on another host that is not reached through `host`.
    host
        Connection to the agent's host; None if the agent runs on this host, or its host does not run
        `farm host`.
    """

    def __init__(
        self,
        name: str,
        section: PrinterSection | None,
        state: StateFolder,
        clock: Clock,
        listener: AgentListener,
        farm_name: str = "",
        host: HostConnection | None = None,
    ) -> None:
        self._name = name
        self._log = PrinterLog(log, name)
        self._section = section
        self._folder = state.find_agent_folder(name)
        self._clock = clock
        self._listener = listener
        self._host = host
        route = load_route(self._folder, section, farm_name, clock)
        self._is_remote = route is not None
        self._heartbeat = Heartbeat()
        open_route = route if host is None else partial(host.open, name)
        self._client = AgentClient(self._folder, open_route, self._heartbeat.reset)
        self._process: subprocess.Popen[bytes] | None = None
        self._start_times_s: deque[float] = deque(maxlen=_MAX_STARTS_PER_MINUTE)  # monotonic times
        self._pending_requests: set[tuple[str, str]] = set()  # being sent, or not yet answered
        self._unsupported_requests: set[tuple[str, str]] = set()  # unknown to the agent's older version
        self._cancelled_prints: set[str] = set()  # prints that must no longer start
        self._tasks: set[asyncio.Task[Any]] = set()
        self._base_offset_s = 0.0  # the farm's clock minus the agent's, before steps of this host's clock
        self._is_stopping = False

    @property
    def _clock_offset_s(self) -> float:
        """Seconds by which the farm's clock is ahead of the agent's."""
        return self._base_offset_s + self._clock.host_shift_s

    def start(self) -> None:
        self.ensure_running()
        self._spawn_task(self._listen())

    def ensure_running(self) -> None:
        """Start the agent if it is not running; kill it if it hangs."""
        if self._process is not None and self._process.poll() is not None:
            # If systemctl ended with 0, it has started the agent's unit.
            if self._process.returncode or not agents_are_units():
                self._log.warning("its agent ended with exit code %s", self._process.returncode)
            self._process = None
        if self._is_stopping or self._is_remote:
            return  # a process on the other host starts and watches the agent
        if self._process is not None or is_alive(self._folder):
            self._kill_if_hung()
            return
        if self._section is None:
            reason = "it was removed from fleet.yaml, and its agent has ended"
            self._report(AgentSnapshot(printer=self._name, link=Link.ABSENT, reason=reason))
            return
        now_s = time.monotonic()
        if len(self._start_times_s) == self._start_times_s.maxlen and now_s - self._start_times_s[0] < 60.0:
            return
        self._start_times_s.append(now_s)
        self._heartbeat.reset()
        try:
            section = self._section
            self._process = spawn_agent(
                section.name,
                section.model,
                section.port,
                self._folder,
                self._clock,
                section.power_off_cmd,
            )
            self._log.info("agent started, pid %d", self._process.pid)
        except DriverError as error:
            self._report(AgentSnapshot(printer=self._name, link=Link.ABSENT, reason=str(error)))

    def _kill_if_hung(self) -> None:
        """Kill the agent if it hangs. The next `ensure_running` starts another, which resets the board."""
        pid = find_agent_pid(self._folder)
        if pid is not None and self._heartbeat.is_hung(time.monotonic(), lambda: sample_process(pid)):
            self._log.error("its agent (pid %d) hangs: replacing it", pid)
            self._spawn_task(self._kill_agent())

    async def _kill_agent(self) -> None:
        if not await asyncio.to_thread(kill_agent, self._folder):
            self._log.error("its agent hangs and cannot be killed; switch the printer off")

    async def _listen(self) -> None:
        wait_s = 0.0
        # `shut_down` may be called just after the agent was started: connect, to send it the request to end.
        while not self._is_stopping or self._is_agent_alive(self._process):
            try:
                await asyncio.sleep(wait_s)
                wait_s = min(2 * wait_s + (1.0 if self._is_remote else RETRY_INTERVAL_S), _MAX_WAIT_S)
                await self._client.connect()
                connected_s = time.monotonic()
                snapshots = self._client.receive_snapshots()
                while True:
                    async with asyncio.timeout(_SILENCE_TIMEOUT_S):
                        report = await anext(snapshots, None)
                    if report is None:
                        break
                    offset_s = compute_clock_offset_s(report, self._clock)
                    self._base_offset_s = offset_s - self._clock.host_shift_s
                    if self._check_port(report):
                        report = await self._import_journal(report)
                        self._report(self._convert_snapshot(report))
                if time.monotonic() - connected_s > _STABLE_CONNECTION_S:
                    wait_s = 0.0
                self._log.info("the connection to its agent was lost")
            except TimeoutError:
                self._log.warning("its agent has not reported for %g s", _SILENCE_TIMEOUT_S)
            except (DriverError, FarmError) as error:
                self._log.warning("%s", error)
            except Exception:
                self._log.exception("listening to its agent failed")
            loss = None if self._host is None else self._host.describe_loss()
            is_lost = loss is not None
            self._report(
                AgentSnapshot(printer=self._name, link=Link.STARTING, reason=loss, host_lost=is_lost)
            )

    async def _import_journal(self, report: m.Snapshot) -> m.Snapshot:
        """Import the agent's journal if the books are a restored backup; return its latest snapshot."""
        since_s = self._listener.find_unreported_since_s(self._name)
        if since_s is None:
            return report
        request = to_agent_clock(m.ListPrints(id=0, since_s=since_s), self._clock_offset_s, self._clock.now())
        try:
            reply = await self._client.request(request)
        except AgentTooOld:
            return report
        latest = reply.snapshot or report
        prints = [to_farm_print(record, self._clock_offset_s) for record in reply.prints]
        self._listener.on_journal(self._convert_snapshot(latest), prints)
        return latest

    def _report(self, snapshot: AgentSnapshot) -> None:
        if snapshot.agent_pid is not None and self._listener.find_unreported_since_s(self._name) is not None:
            return  # the agent's list of prints must arrive first
        try:
            self._listener.on_snapshot(snapshot)
        except FarmError as error:
            # The books could not be written: nothing has changed, and the next snapshot is handled in full.
            self._log.error("%s", error)
        except Exception:  # a bug in the handling of one snapshot must not stop all later ones
            self._log.exception("the snapshot of its agent could not be handled")

    def _convert_snapshot(self, report: m.Snapshot) -> AgentSnapshot:
        """Convert a snapshot to the farm's record; see `to_farm_snapshot`."""
        is_simulated = self._section is not None and self._section.is_simulated
        is_cleared = _CLEARED_KEY in self._pending_requests
        return to_farm_snapshot(report, self._clock, self._name, is_simulated, is_cleared)

    def _check_port(self, report: m.Snapshot) -> bool:
        """Return whether the agent has the model and port in fleet.yaml; end an idle agent with others.

        An agent that is printing is accepted in any case.
        """
        section = self._section
        if section is None or (report.model, report.port) == (section.model, section.port):
            return True
        if report.print is not None:
            return True  # the books have this print, which must end before the agent is replaced
        self._log.warning("its agent has %s at %s: replacing it", report.model, report.port)
        self._spawn_task(self._end_agent())
        return False

    def send(self, request: m.Request) -> None:
        """Send a request in the background.

        Failures are only logged; the agent's next snapshot shows whether the request must be repeated.
        """
        key = (request.do, getattr(request, "print_id", ""))
        if isinstance(request, m.CancelPrint):
            self._cancelled_prints.add(request.print_id)
        if key not in self._pending_requests:
            self._pending_requests.add(key)
            self._spawn_task(self._deliver_request(key, request))

    async def _deliver_request(self, key: tuple[str, str], request: m.Request) -> None:
        try:
            if self._is_remote and isinstance(request, m.StartPrint) and request.gcode:
                await self._upload_file(request.print_id, Path(request.gcode))
                if request.print_id in self._cancelled_prints:
                    return  # cancelled during the upload
                request = request.model_copy(update={"gcode": None})
            latest_start_s = self._clock.now() + _START_TIMEOUT_S * self._clock.scale
            reply = await self._client.request(to_agent_clock(request, self._clock_offset_s, latest_start_s))
            if reply.error:
                self._log.warning("%s refused: %s", request.do, reply.error)
                if isinstance(request, m.StartPrint):
                    self._listener.on_refusal(request.print_id, reply.error, reply.late)
            elif isinstance(request, m.CancelPrint) and reply.snapshot is not None:
                report = self._convert_snapshot(reply.snapshot)
                self._report(report.model_copy(update={"acknowledged_cancel": request.print_id}))
        except AgentTooOld as error:
            if key not in self._unsupported_requests:
                self._log.warning("%s", error)
            self._unsupported_requests.add(key)
            if isinstance(request, m.StartPrint):
                self._listener.on_refusal(request.print_id, str(error), True)
        except (DriverError, FarmError) as error:
            self._log.warning("%s", error)
        finally:
            self._pending_requests.discard(key)

    async def _upload_file(self, print_id: str, gcode: Path) -> None:
        """Send the G-code of a print to an agent on another host. Raises DriverError."""
        offset, has_more = 0, True
        try:
            with gcode.open("rb") as file:
                while has_more:
                    chunk = await asyncio.to_thread(file.read, _CHUNK_BYTES)
                    request = m.Upload(id=0, print_id=print_id, offset=offset, data=base64.b64encode(chunk))
                    reply = await self._client.request(request)
                    if reply.error:
                        raise AgentError(reply.error)
                    offset, has_more = offset + len(chunk), bool(chunk)
        except OSError as error:
            raise AgentError(f"{gcode}: cannot be read ({error})") from error

    async def read_lines(self) -> list[m.WireLine]:
        """Read the last lines that the agent and its board exchanged, with times on the farm's clock.

        Raises
        ------
        AgentError
            If the agent cannot be reached.
        AgentTooOld
            If the agent is too old to record lines.
        """
        reply = await self._client.request(m.ListLines(id=0))
        return to_farm_lines(reply.lines, self._clock_offset_s)

    async def replace_agent(self) -> None:
        """Replace an idle agent with one of this version.

        Raises
        ------
        AgentError
            If the agent is printing, or cannot be reached.
        """
        reply = await self._client.request(m.Shutdown(id=0))
        if reply.error:
            raise AgentError(f"{self._name}: {reply.error}")

    async def shut_down(self) -> None:
        """End the agent without starting another, and switch a simulated printer off."""
        self._is_stopping = True
        await self._end_agent()

    async def _end_agent(self) -> None:
        process, pid = self._process, find_agent_pid(self._folder)
        has_answered = await self._request_end()
        try:
            async with asyncio.timeout(_END_TIMEOUT_S):
                while self._is_agent_alive(process, pid):
                    if not has_answered and self._client.is_connected:  # the agent has only just started
                        has_answered = await self._request_end()
                    await asyncio.sleep(0.05)
        except TimeoutError:
            self._log.warning("its agent does not end")
        if emulator_is_running(self._folder / _EMULATOR_FOLDER):
            try:
                await asyncio.to_thread(control, self._folder / _EMULATOR_FOLDER, Command.POWER_OFF)
            except DriverError as error:
                self._log.warning("%s", error)

    async def _request_end(self) -> bool:
        """Ask the agent to end; return whether it has answered."""
        try:
            reply = await self._client.request(m.Shutdown(id=0, now=True))
        except DriverError as error:
            self._log.info("%s", error)
            return False
        if reply.error:
            self._log.warning("%s", reply.error)
        return True

    def _is_agent_alive(self, process: subprocess.Popen[bytes] | None, pid: int | None = None) -> bool:
        """Return whether an agent is running on this host, even if it has only just been started.

        Parameters
        ----------
        process
            The agent, if the daemon started it as a child process.
        pid
            The agent's process id, if known; an agent with another id is then ignored.
        """
        if process is not None and process.poll() is None:
            return True
        return is_alive(self._folder) and pid in (None, find_agent_pid(self._folder))

    async def close(self) -> None:
        self._is_stopping = True
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._client.close()

    def _spawn_task(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
