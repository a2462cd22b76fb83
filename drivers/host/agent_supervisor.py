"""Supervisor of one agent of a host: its process, its reports, and its end."""

from __future__ import annotations

import asyncio
import logging
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drivers import messages as m
from drivers.errors import AgentError, DriverError
from drivers.host.messages import AgentPhase, AgentState
from drivers.host.supervision import Backoff
from drivers.records import StartFile
from drivers.remote import (
    AgentClient,
    Heartbeat,
    Installation,
    agents_are_units,
    find_agent_pid,
    is_alive,
    kill_agent,
    sample_process,
    start_agent,
)

log = logging.getLogger(__name__)

_RETRY_INTERVAL_S = 1.0  # wall seconds between two attempts to connect to the agent
_END_TIMEOUT_S = 30.0  # wall seconds for an idle agent to end


class AgentSupervisor:
    """Supervisor that starts an agent, listens to it, restarts it when it ends, and kills it if it hangs.

    Parameters
    ----------
    start
        The agent's start file.
    folder
        The agent's folder.
    kept_installation
        Installation that the agent keeps after a failed update; None for the installation of this process.
    on_change
        Function that is called when the agent's state has changed.

    Attributes
    ----------
    start_count
        Number of attempts to start an agent.
    last_ended_start
        Number of the last attempt whose agent has ended or could not be started; 0 if there is none.
    snapshot
        Latest report of the agent; None before the first, and while no agent is connected.
    is_wanted
        True while the printer is in the fleet.
    """

    def __init__(
        self,
        start: StartFile,
        folder: Path,
        kept_installation: Installation | None,
        on_change: Callable[[], None],
    ) -> None:
        self.start, self.kept_installation, self.is_wanted = start, kept_installation, True
        self.snapshot: m.Snapshot | None = None
        self._folder, self._on_change = folder, on_change
        self._heartbeat = Heartbeat()
        self._client = AgentClient(folder, on_message=self._heartbeat.reset)
        self._backoff = Backoff()
        self._process: subprocess.Popen[bytes] | None = None
        self.start_count = self.last_ended_start = 0
        self._reason: str | None = None
        self._listen_task: asyncio.Task[None] | None = None
        self._phase = AgentPhase.STARTING

    @property
    def printer(self) -> str:
        """Name of the agent's printer."""
        return self.start.printer

    @property
    def is_alive(self) -> bool:
        """True while an agent holds the lock of the folder."""
        return is_alive(self._folder)

    @property
    def is_running(self) -> bool:
        """True while an agent is running, even if it has just been started and has no lock yet."""
        return self.is_alive or (self._process is not None and self._process.poll() is None)

    def describe(self) -> AgentState:
        """Describe the agent for the daemon."""
        pid = find_agent_pid(self._folder)
        installation = None if pid is None else Installation.from_agent(pid)
        return AgentState(
            printer=self.printer,
            phase=self._find_phase(),
            pid=pid,
            restarts=max(0, self.start_count - 1),
            installation="" if installation is None else installation.folder,
            reason=self._reason,
        )

    def find_installation(self) -> Installation | None:
        """Return the installation that the agent runs; None if no agent is running."""
        pid = find_agent_pid(self._folder)
        return None if pid is None else Installation.from_agent(pid)

    def _find_phase(self) -> AgentPhase:
        if not self.is_wanted:
            return AgentPhase.ENDING
        if self.snapshot is None:
            return AgentPhase.STARTING if self.is_alive else AgentPhase.WAITING
        return AgentPhase.PRINTING if self.snapshot.print is not None else AgentPhase.IDLE

    def ensure_running(self) -> None:
        """Start the agent if none is running and the wait before its restart is over; kill one that hangs."""
        if self._listen_task is None:
            self._listen_task = asyncio.create_task(self._listen_to_agent())
        if self._process is not None and self._process.poll() is not None:
            # If systemctl ended with 0, it has started the agent's unit.
            if self._process.returncode or not agents_are_units():
                self.last_ended_start = self.start_count
                self._reason = f"its agent ended with exit code {self._process.returncode}"
                log.warning("%s: %s", self.printer, self._reason)
            self._process = None
        if self._process is not None or self.is_alive:
            self._kill_if_hung()
        elif self.is_wanted and self._backoff.may_start(time.monotonic()):
            self._start_agent()
        phase = self._find_phase()
        if phase is not self._phase:
            self._phase = phase
            self._on_change()

    def reset_backoff(self) -> None:
        """Let the next check start an ended agent without a delay."""
        self._backoff = Backoff()

    def _start_agent(self) -> None:
        self._backoff = self._backoff.record_start(time.monotonic())
        self._heartbeat.reset()
        self.start_count += 1
        try:
            installation = (
                self.kept_installation
                if self.kept_installation is not None and self.kept_installation.exists
                else None
            )
            self._process = start_agent(self.start, self._folder, installation)
            log.info("%s: agent started, pid %d", self.printer, self._process.pid)
        except DriverError as error:
            self.last_ended_start = self.start_count
            self._reason = str(error)
            log.error("%s", error)

    def _kill_if_hung(self) -> None:
        pid = find_agent_pid(self._folder)
        if pid is not None and self._heartbeat.is_hung(time.monotonic(), lambda: sample_process(pid)):
            log.error("%s: its agent (pid %d) hangs: replacing it", self.printer, pid)
            self._reason = "its agent stopped responding, and was replaced"
            self.kill()

    async def _listen_to_agent(self) -> None:
        while True:
            with suppress(DriverError):
                await self._client.connect()
                async for snapshot in self._client.receive_snapshots():
                    self.snapshot = snapshot
            self.snapshot = None
            await asyncio.sleep(_RETRY_INTERVAL_S)

    async def end(self) -> None:
        """End the agent if it is idle, and wait until it has ended.

        Raises
        ------
        AgentError
            The agent is printing, or cannot be reached.
        """
        pid = find_agent_pid(self._folder)
        reply = await self._client.request(m.Shutdown(id=0))
        if reply.error:
            raise AgentError(reply.error)
        try:
            async with asyncio.timeout(_END_TIMEOUT_S):
                # If the id has changed, the next agent is already running.
                while self.is_alive and find_agent_pid(self._folder) == pid:
                    await asyncio.sleep(0.05)
        except TimeoutError as error:
            raise AgentError(
                f"{self.printer}: its agent does not end; switch the printer off, and kill the process"
            ) from error

    def kill(self) -> None:
        """Kill an agent that does not end; the next one finds an open print, and resets the board."""
        if not kill_agent(self._folder):
            log.error("%s: its agent cannot be killed; switch the printer off", self.printer)
        elif self._process is not None and not agents_are_units():
            self._process.kill()  # it may not have taken its lock yet

    async def close(self) -> None:
        """Stop watching; the agent continues."""
        if self._listen_task is not None:
            self._listen_task.cancel()
            await asyncio.gather(self._listen_task, return_exceptions=True)
        await self._client.close()
