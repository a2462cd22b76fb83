"""Record of a host with printers: its connection and last state, in memory only."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from drivers.host import AgentPhase, HostState, Update, UpdatePhase

LOSS_DELAY_S = 10.0
"""Wall seconds without a connection after which a host is lost; shorter interruptions are not reported."""
FIRST_LOSS_DELAY_S = 45.0
"""Like `LOSS_DELAY_S`, for the first connection: the services of many hosts start at once, over ssh."""


class HostChange(StrEnum):
    """Change of a connection that is reported to people."""

    LOST = "lost"
    RECONNECTED = "back"


@dataclass(slots=True)
class HostRecord:
    """State of a host and of its connection. Times are on the farm's clock.

    Attributes
    ----------
    host
        Its name for ssh.
    printers
        Its printers.
    disconnected_s
        Time at which the connection was lost; None while connected.
    connected_s
        Time at which the connection was made; None while disconnected.
    reason
        Reason for the loss of the connection.
    state
        Its last state; None before the first.
    is_loss_reported
        True if its loss has been reported.
    is_update_unconfirmed
        True if its update was requested, and no state has confirmed it yet.
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
        """State of the update of its agents; None if it is not connected."""
        return None if self.state is None or self.disconnected_s is not None else self.state.update

    def on_update_begun(self) -> None:
        """Record that the update of its agents has begun, before its next state confirms that."""
        self.is_update_unconfirmed = True
        if self.state is not None:
            self.state = self.state.model_copy(update={"update": Update(phase=UpdatePhase.RUNNING)})

    def describe_wait(self) -> str | None:
        """Describe what the host waits for; None if it does not wait."""
        if self.disconnected_s is not None or self.state is None:
            return f"a connection: {self.reason}"
        waiting_agents = [agent for agent in self.state.agents if agent.phase is AgentPhase.WAITING]
        if waiting_agents:
            names = " ".join(agent.printer for agent in waiting_agents)
            return f"agents that have to start again: {names} ({waiting_agents[0].reason or 'soon'})"
        return self.state.update.reason

    def find_change(self, now_s: float, time_scale: float) -> HostChange | None:
        """Return the change that has not been reported; None if there is none.

        Parameters
        ----------
        now_s
            Time on the farm's clock.
        time_scale
            Seconds of the farm's clock in a wall second, in which the delays are given.
        """
        limit_s = time_scale * (FIRST_LOSS_DELAY_S if self.state is None else LOSS_DELAY_S)
        is_lost = self.disconnected_s is not None and now_s - self.disconnected_s >= limit_s
        if is_lost and not self.is_loss_reported:
            return HostChange.LOST
        return HostChange.RECONNECTED if self.is_loss_reported and self.disconnected_s is None else None
