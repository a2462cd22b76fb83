"""Agents' reports on their printers: telemetry, which is never stored in the database."""

from __future__ import annotations

from enum import StrEnum

from drivers.messages import PrinterReadings, PrintReadings
from farm.model.entity import Entity
from farm.model.print import PrintState
from farm.model.printer import FilamentState


class Link(StrEnum):
    """State of the link between an agent and the board of its printer."""

    STARTING = "starting"  # the agent has not reported yet
    ABSENT = "absent"  # the port is missing, or cannot be opened
    CONNECTING = "connecting"  # the port is open; the board has not answered yet
    READY = "ready"  # the board answers; no print is open
    BUSY = "busy"  # a print is open
    FAULT = "fault"  # a person has to check the printer; no print starts


class AgentPrint(PrintReadings, Entity):
    """State of the open or last ended print of an agent, as the agent reports it."""

    print_id: str
    state: PrintState
    fault: str | None
    reason: str | None
    progress_s: float  # elapsed part of `print_time_s`
    print_time_s: float  # print time of the whole file, as sliced
    extruded: bool  # True if material of this print may be on the bed
    started_s: float | None
    ended_s: float | None
    starved_s: float = 0.0  # time for which a simulated printer waited for its host computer
    layers: int = 0  # number of layers in the file
    pause_ends_s: float | None = None  # time at which the agent ends the print unless it is resumed
    ends_by_s: float | None = None  # time at which the agent ends the print if it is still running
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
    bed_unknown_reason: str | None = None  # reason why the states of bed and filament are unknown
    host_lost: bool = False  # True without a connection to its host: the printer's state is unknown
    outdated: bool = False  # True if the agent runs an older version, and therefore gets no more prints
    reset_verified: bool = True  # True if a reset is confirmed to stop its board; else attended prints only
    acknowledged_cancel: str | None = None  # id of the print whose cancel request the agent has received
    print: AgentPrint | None = None

    def find_print(self, print_id: str) -> AgentPrint | None:
        """Return the report on a print; None if the agent reports another print or no print."""
        return self.print if self.print is not None and self.print.print_id == print_id else None
