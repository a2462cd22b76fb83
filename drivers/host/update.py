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
from drivers.host.agent_watch import AgentWatch
from drivers.host.messages import Update, UpdatePhase
from drivers.remote import Installation

log = logging.getLogger(__name__)

_READY_TIMEOUT_S = 90.0  # wall seconds for a new agent to be ready; its board takes about 10 to connect
_POLL_INTERVAL_S = 0.2


@dataclass(frozen=True, slots=True)
class Trial:
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


def judge_trial(trial: Trial) -> str | bool:
    """Judge a new agent: return True if it works, False if that is still unknown, else the fault as text.

    A new agent that cannot reach its printer works if the old agent could not reach it either.
    """
    snapshot = trial.snapshot
    if snapshot is not None and snapshot.link in (m.LinkState.READY, m.LinkState.BUSY, trial.old_link):
        return True
    if snapshot is not None and snapshot.link in (m.LinkState.FAULT, m.LinkState.ABSENT):
        return f"its new agent reports: {snapshot.reason or snapshot.link}"
    if trial.has_ended:
        return "its new agent has ended"
    return trial.waited_s > _READY_TIMEOUT_S and f"its new agent was not ready in {_READY_TIMEOUT_S:g} s"


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

    def step(self, watches: Sequence[AgentWatch], spawn: Callable[[Coroutine[Any, Any, None]], None]) -> None:
        """Replace the next idle agent, unless one is being replaced; end the update if none is outdated."""
        if not self._is_running or self._printer_in_replacement is not None:
            return
        outdated_watches = self._list_outdated_watches(watches)
        if not outdated_watches:
            self._is_running = False
            self._on_change()
            return
        idle_watches = [w for w in outdated_watches if w.snapshot is not None and w.snapshot.print is None]
        if idle_watches:
            self._printer_in_replacement = idle_watches[0].printer
            spawn(self._replace_agent(idle_watches[0]))

    def describe(self, watches: Sequence[AgentWatch]) -> Update:
        """Describe the update for the daemon."""
        if self._reason is not None:
            return Update(phase=UpdatePhase.FAILED, reason=self._reason)
        outdated_printers = [watch.printer for watch in self._list_outdated_watches(watches)]
        if not outdated_printers:
            return Update()
        if self._is_running:
            return Update(
                phase=UpdatePhase.RUNNING, reason=f"to be replaced when idle: {' '.join(outdated_printers)}"
            )
        return Update(
            phase=UpdatePhase.OUTDATED, reason=f"agents with another version: {' '.join(outdated_printers)}"
        )

    def _list_outdated_watches(self, watches: Sequence[AgentWatch]) -> list[AgentWatch]:
        return [w for w in watches if w.is_wanted and w.find_installation() not in (None, self._installation)]

    async def _replace_agent(self, watch: AgentWatch) -> None:
        """Replace an agent; after a fault, start its old version again and end the update."""
        try:
            old_snapshot, start_count = watch.snapshot, watch.start_count
            old_installation = watch.find_installation()
            kept_installation, watch.kept_installation = watch.kept_installation, None
            try:
                await watch.end()
            except DriverError as error:  # the agent has begun to print, or is ending
                watch.kept_installation = kept_installation
                log.info("%s: not replaced: %s", watch.printer, error)
                return
            watch.snapshot = None
            old_link = None if old_snapshot is None else old_snapshot.link
            fault = await self._await_trial(watch, old_link, start_count)
            if fault is not None:
                await self._restore_old_version(watch, old_installation, fault)
        finally:
            self._printer_in_replacement = None
            self._on_change()

    async def _await_trial(
        self, watch: AgentWatch, old_link: m.LinkState | None, start_count: int
    ) -> str | None:
        """Wait for the first agent after start number `start_count`; return its fault; None if it works."""
        started_s = time.monotonic()
        while True:
            installation = watch.find_installation()
            snapshot = watch.snapshot if installation == self._installation else None
            waited_s = time.monotonic() - started_s
            has_ended = watch.last_ended_start > start_count
            result = judge_trial(Trial(old_link, snapshot, has_ended, waited_s))
            if result is True:
                log.info("%s: its agent now has this version", watch.printer)
                return None
            if result:
                return str(result)
            await asyncio.sleep(_POLL_INTERVAL_S)

    async def _restore_old_version(
        self, watch: AgentWatch, old_installation: Installation | None, fault: str
    ) -> None:
        """Start the old version again, and end the update."""
        self._is_running = False
        is_restorable = old_installation is not None and old_installation.exists
        watch.kept_installation = old_installation if is_restorable else None
        result = "its old version is started again" if is_restorable else "its old version is gone"
        self._reason = f"{watch.printer}: {fault}; {result}; the update of this host has ended"
        log.error("%s", self._reason)
        if is_restorable and watch.is_running:
            try:
                await watch.end()
            except DriverError as error:
                log.error("%s: the new agent is killed: %s", watch.printer, error)
                watch.kill()
        watch.snapshot = None
        watch.reset_backoff()
