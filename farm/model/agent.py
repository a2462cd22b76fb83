"""Reports of agents on their printers: telemetry, which is never stored in the books."""

from __future__ import annotations

from enum import StrEnum

from drivers.messages import PrinterReadings, PrintReadings
from farm.model.entity import Entity
from farm.model.print import PrintState
from farm.model.printer import FilamentState


class Link(StrEnum):
    """State of the connection to a board."""

    STARTING = "starting"  # its agent has not reported yet
    ABSENT = "absent"
    CONNECTING = "connecting"
    READY = "ready"
    BUSY = "busy"
    FAULT = "fault"


class AgentPrint(PrintReadings, Entity):
    """State of an agent's open print, as the agent reports it."""

    print_id: str
    state: PrintState
    fault: str | None
    reason: str | None
    progress_s: float
    print_time_s: float
    extruded: bool
    started_s: float | None
    ended_s: float | None
    starved_s: float = 0.0  # time that a simulated printer waited for the host
    layers: int = 0
    pause_ends_s: float | None = None  # time at which its agent ends the print unless it is resumed
    ends_by_s: float | None = None  # time at which its agent ends the print if it is still running
    sha256: str | None = None  # hash of its G-code file


class AgentSnapshot(PrinterReadings, Entity):
    """Last report of an agent."""

    printer: str
    link: Link
    agent_pid: int | None = None
    reason: str | None = None
    nozzle_c: float | None = None
    bed_c: float | None = None
    nozzle_target_c: float | None = None
    bed_target_c: float | None = None
    filament: FilamentState = FilamentState.UNKNOWN
    bed_clear: bool | None = None  # reported by emulators only
    alarm: str | None = None  # a heater that cannot be switched off: immediate action needed
    bed_unknown_reason: str | None = None  # reason why bed and filament are unknown, until the bed is cleared
    host_lost: bool = False  # no connection to its host: the state of the printer is unknown
    outdated: bool = False  # its agent has an older version and gets no more prints
    reset_verified: bool = True  # a reset stops its board; otherwise it prints only while attended
    acknowledged_cancel: str | None = None  # id of a print whose cancel request its agent has received
    print: AgentPrint | None = None

    def find_print(self, print_id: str) -> AgentPrint | None:
        """Return the report on a print; None if the agent reports another print, or none."""
        return self.print if self.print is not None and self.print.print_id == print_id else None
