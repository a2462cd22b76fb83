"""Update of a host's agents to the version of its service: one agent after another, each when it is idle."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass
from typing import Any

from drivers import messages as m
from drivers.errors import DriverError
from drivers.host.agent_supervisor import AgentSupervisor
from drivers.host.messages import Update, UpdatePhase
from drivers.remote import Installation

log = logging.getLogger(__name__)

_READY_TIMEOUT_S = 90.0  # wall seconds for a new agent to be ready; its board takes about 10 to connect
_POLL_INTERVAL_S = 0.2


@dataclass(frozen=True, slots=True)
class HealthObservation:
    """Observations of a new agent since it replaced the old one.

    Attributes
    ----------
    old_link
        State of the old agent's link; None if it is unknown.
    snapshot
        Latest report of the new agent; None before the first.
    has_ended
        True if the new agent has ended, or could not be started.
    waited_s
        Wall seconds since the replacement.
    """

    old_link: m.LinkState | None
    snapshot: m.Snapshot | None
    has_ended: bool
    waited_s: float


def check_health(observation: HealthObservation) -> str | bool:
    """Check a new agent: return True if it works, False if that is still unknown, else the fault as text.

    A new agent that cannot reach its printer works if the old agent could not reach it either.
    """
    snapshot = observation.snapshot
    if snapshot is not None and snapshot.link in (m.LinkState.READY, m.LinkState.BUSY, observation.old_link):
        return True
    if snapshot is not None and snapshot.link in (m.LinkState.FAULT, m.LinkState.ABSENT):
        return f"its new agent reports: {snapshot.reason or snapshot.link}"
    if observation.has_ended:
        return "its new agent has ended"
    return (
        observation.waited_s > _READY_TIMEOUT_S
        and f"its new agent was not ready within {_READY_TIMEOUT_S:g} s"
    )


class AgentsUpdate:
    """Update of the agents of one host.

    Parameters
    ----------
    installation
        Version to which the agents are updated.
    on_change
        Function that is called when the state of the update has changed.
    """

    def __init__(self, installation: Installation, on_change: Callable[[], None]) -> None:
        self._installation, self._on_change = installation, on_change
        self._is_running = False
        self._reason: str | None = None
        self._printer_in_replacement: str | None = None

    def begin(self) -> None:
        """Begin the update, or begin it again after a fault."""
        self._is_running, self._reason = True, None

    def stop(self) -> None:
        """Stop the update, as an agent on another host had a fault."""
        self._is_running = False

    def step(
        self, supervisors: Sequence[AgentSupervisor], spawn: Callable[[Coroutine[Any, Any, None]], None]
    ) -> None:
        """Replace the next idle agent, unless one is being replaced; end the update if none is outdated."""
        if not self._is_running or self._printer_in_replacement is not None:
            return
        outdated_supervisors = self._list_outdated_supervisors(supervisors)
        if not outdated_supervisors:
            self._is_running = False
            self._on_change()
            return
        idle_supervisors = [
            s for s in outdated_supervisors if s.snapshot is not None and s.snapshot.print is None
        ]
        if idle_supervisors:
            self._printer_in_replacement = idle_supervisors[0].printer
            spawn(self._replace_agent(idle_supervisors[0]))

    def describe(self, supervisors: Sequence[AgentSupervisor]) -> Update:
        """Describe the update for the daemon."""
        if self._reason is not None:
            return Update(phase=UpdatePhase.FAILED, reason=self._reason)
        outdated_printers = [
            supervisor.printer for supervisor in self._list_outdated_supervisors(supervisors)
        ]
        if not outdated_printers:
            return Update()
        if self._is_running:
            return Update(
                phase=UpdatePhase.RUNNING, reason=f"to be replaced when idle: {' '.join(outdated_printers)}"
            )
        return Update(
            phase=UpdatePhase.OUTDATED, reason=f"agents with another version: {' '.join(outdated_printers)}"
        )

    def _list_outdated_supervisors(self, supervisors: Sequence[AgentSupervisor]) -> list[AgentSupervisor]:
        return [
            s for s in supervisors if s.is_wanted and s.find_installation() not in (None, self._installation)
        ]

    async def _replace_agent(self, supervisor: AgentSupervisor) -> None:
        """Replace an agent; after a fault, start its old version again and end the update."""
        try:
            old_snapshot, start_count = supervisor.snapshot, supervisor.start_count
            old_installation = supervisor.find_installation()
            kept_installation, supervisor.kept_installation = supervisor.kept_installation, None
            try:
                await supervisor.end()
            except DriverError as error:  # the agent has begun to print, or is ending
                supervisor.kept_installation = kept_installation
                log.info("%s: not replaced: %s", supervisor.printer, error)
                return
            supervisor.snapshot = None
            old_link = None if old_snapshot is None else old_snapshot.link
            fault = await self._wait_until_healthy(supervisor, old_link, start_count)
            if fault is not None:
                await self._restore_old_version(supervisor, old_installation, fault)
        finally:
            self._printer_in_replacement = None
            self._on_change()

    async def _wait_until_healthy(
        self, supervisor: AgentSupervisor, old_link: m.LinkState | None, start_count: int
    ) -> str | None:
        """Wait until the agent started after `start_count` works; return None, or its fault as text."""
        started_s = time.monotonic()
        while True:
            installation = supervisor.find_installation()
            snapshot = supervisor.snapshot if installation == self._installation else None
            waited_s = time.monotonic() - started_s
            has_ended = supervisor.last_ended_start > start_count
            result = check_health(HealthObservation(old_link, snapshot, has_ended, waited_s))
            if result is True:
                log.info("%s: its agent now has this version", supervisor.printer)
                return None
            if result:
                return str(result)
            await asyncio.sleep(_POLL_INTERVAL_S)

    async def _restore_old_version(
        self, supervisor: AgentSupervisor, old_installation: Installation | None, fault: str
    ) -> None:
        """Start the old version again, and end the update."""
        self._is_running = False
        is_restorable = old_installation is not None and old_installation.exists
        supervisor.kept_installation = old_installation if is_restorable else None
        result = "its old version is started again" if is_restorable else "its old version is gone"
        self._reason = f"{supervisor.printer}: {fault}; {result}; the update of this host has ended"
        log.error("%s", self._reason)
        if is_restorable and supervisor.is_running:
            try:
                await supervisor.end()
            except DriverError as error:
                log.error("%s: the new agent is killed: %s", supervisor.printer, error)
                supervisor.kill()
        supervisor.snapshot = None
        supervisor.reset_backoff()
