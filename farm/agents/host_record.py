"""Record of a host with printers: the state of its connection, and the last state that it sent."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from drivers.host import AgentPhase, HostState, Update, UpdatePhase

LOSS_DELAY_S = 10.0
"""Wall seconds without a connection after which a host counts as lost and its loss is reported."""
FIRST_LOSS_DELAY_S = 45.0
"""The same for the first connection. It takes longer: many hosts are connected at the same time over ssh."""


class HostChange(StrEnum):
    """Change of the connection to a host that is reported to people."""

    LOST = "lost"
    RECONNECTED = "back"


@dataclass(slots=True)
class HostRecord:
    """State of a host and of its connection. Times are on the farm's clock.

    Attributes
    ----------
    host
        Name of the host, as ssh knows it.
    printers
        Names of its printers.
    disconnected_s
        Time at which the connection was lost; None while connected.
    connected_s
        Time at which the connection was made; None while disconnected.
    reason
        Reason why the last connection, or attempt to connect, failed.
    state
        Last state that the host sent; None before the first.
    is_loss_reported
        True if the loss of the host has been reported.
    is_update_unconfirmed
        True if an update was requested, and no state from the host has confirmed it yet.
    """

    host: str
    printers: tuple[str, ...]
    disconnected_s: float | None
    connected_s: float | None = None
    reason: str = "it has not answered yet"
    state: HostState | None = None
    is_loss_reported: bool = False
    is_update_unconfirmed: bool = False

    def on_state(self, now_s: float, state: HostState) -> None:
        """Store a state that the host has sent."""
        if state.update.phase not in (UpdatePhase.OUTDATED, UpdatePhase.FAILED):
            self.is_update_unconfirmed = False
        self.state = state
        if self.is_update_unconfirmed:  # the host sent this state before it received the request
            self.on_update_begun()
        if self.connected_s is None:
            self.connected_s, self.disconnected_s = now_s, None

    def on_lost(self, now_s: float, reason: str) -> None:
        """Record that the connection broke, or that an attempt to connect failed."""
        self.reason, self.is_update_unconfirmed = reason, False
        if self.disconnected_s is None:
            self.connected_s, self.disconnected_s = None, now_s

    def shift_times(self, step_s: float) -> None:
        """Shift the times of the connection by a step of the farm's clock."""
        if self.connected_s is not None:
            self.connected_s += step_s
        if self.disconnected_s is not None:
            self.disconnected_s += step_s

    @property
    def update(self) -> Update | None:
        """State of the update of the host's agents; None if the host is not connected."""
        return None if self.state is None or self.disconnected_s is not None else self.state.update

    def on_update_begun(self) -> None:
        """Record that the host's agents are being updated, before the host's next state confirms it."""
        self.is_update_unconfirmed = True
        if self.state is not None:
            self.state = self.state.model_copy(update={"update": Update(phase=UpdatePhase.RUNNING)})

    def describe_wait(self) -> str | None:
        """Return a description of what the host is waiting for; None if it is not waiting."""
        if self.disconnected_s is not None or self.state is None:
            return f"a connection: {self.reason}"
        waiting_agents = [agent for agent in self.state.agents if agent.phase is AgentPhase.WAITING]
        if waiting_agents:
            names = " ".join(agent.printer for agent in waiting_agents)
            reason = waiting_agents[0].reason
            return f"agents that have to start again: {names}{f' ({reason})' if reason else ''}"
        return self.state.update.reason

    def find_change(self, now_s: float, time_scale: float) -> HostChange | None:
        """Return the change that must be reported now; None if there is none.

        Parameters
        ----------
        now_s
            Time on the farm's clock.
        time_scale
            Seconds of the farm's clock per wall second.
        """
        limit_s = time_scale * (FIRST_LOSS_DELAY_S if self.state is None else LOSS_DELAY_S)
        is_lost = self.disconnected_s is not None and now_s - self.disconnected_s >= limit_s
        if is_lost and not self.is_loss_reported:
            return HostChange.LOST
        return HostChange.RECONNECTED if self.is_loss_reported and self.disconnected_s is None else None
