"""State of one session, shared by its scripts, and the types of a script. Pure.

A script is a generator function of a `SessionContext`; each value that it yields is a condition to wait for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, field

from drivers.clock import Clock
from drivers.errors import Fault
from drivers.firmware import Firmware
from drivers.gcode import Point, Program
from drivers.link import BoardConnected, Link, Report
from drivers.messages import Filament, PrintPhase
from drivers.printers import Profile
from drivers.records import Suspicion
from drivers.safety import HeaterWatch

# Maximum time between two reports while heating: a query may wait behind a slow move and be resent.
REPORT_TIMEOUT_S = 180.0
# Maximum time without a report while printing: longer than any command may take.
NO_REPORT_TIMEOUT_S = 700.0


@dataclass(frozen=True, slots=True)
class Pace:
    """Intervals between M105 queries, and the shortest timeout, in seconds of the farm's clock.

    With an accelerated clock, M105 must not flood the link, and the host's scheduling must not look like a
    silent board. So each value has a lower bound in wall time.
    """

    min_timeout_s: float = 2.0
    heating_interval_s: float = 1.0
    printing_interval_s: float = 3.0
    idle_interval_s: float = 5.0

    @classmethod
    def from_clock(cls, clock: Clock) -> Pace:
        """Compute the pace: timeouts of at least 2 wall seconds, and at most 10 reports per wall second."""
        scale = clock.scale
        return cls(
            min_timeout_s=2.0 * scale,
            heating_interval_s=max(1.0, 0.1 * scale),
            printing_interval_s=max(3.0, 0.5 * scale),
            idle_interval_s=max(5.0, 1.0 * scale),
        )


class PrintEnded(Exception):
    """Exception that ends a print early, because of a fault; because of a cancellation if `fault` is None."""

    def __init__(self, fault: Fault | None, reason: str) -> None:
        super().__init__(reason)
        self.fault = fault
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Wait:
    """Condition of a script and its deadline; the script receives True if the condition was met."""

    condition: Callable[[], bool]
    deadline_s: float = math.inf


Script = Generator[Wait, bool, None]
TimedScript = Generator[Wait, bool, bool]
"""A script that returns True if it finished in time."""


@dataclass(slots=True, eq=False)
class SessionContext:
    """State of one session. Only the session and its scripts write it.

    Attributes
    ----------
    link
        The link to the board.
    program
        The program to print; None to only reset the board and confirm its heaters off.
    profile
        Model of the printer to which the board must belong.
    filament
        Position of the filament's tip.
    pace
        See `Pace`.
    now_s
        The farm's clock at the last `Session.advance`.
    identity
        Identity of this printer in its banner; None until a session has read it.
    previous_fault
        Without a program: the fault that ended the last agent's print.
    can_reset_board
        True if a reset of the port restarts the board. Otherwise commands restore the board's defaults, and
        the board cannot be stopped once it ignores commands, so it prints only while somebody is present.
    suspicion
        Heater that may be stuck on: it was found in this session or the previous one, and has not been seen
        to cool since.
    has_extruded
        True if material of this print may be on the bed.
    ends_by_s
        Time at which the print is ended safely if it has not ended by then.
    phase
        Phase of the print.
    fault, reason
        Fault that ended the print early, if any, and the reason; a cancellation has no fault.
    started_s, ended_s
        Start and end of the session.
    wants_reset
        True if the caller has to reset the port; `Session.on_port_reset` clears it.
    wants_power_off, power_off_requested_s
        True if the caller has to cut the printer's mains, if possible, because heaters were not confirmed
        off; the time of the request. Never cleared, so that each session requests it once.
    heaters_off, targets_off_s
        True if, since the last heating command, a report has shown both targets 0 and each heater was seen
        cooling or cold; the time at which both targets were first reported 0.
    connection
        The board's banner, or first answer, since the last reset.
    report, report_s
        The last temperatures, and the time of that report.
    heater_watch, unexpected_report_count
        The heater watch; number of consecutive reports with targets that the session did not set.
    position_mm
        Position in the last answer to M114.
    answer
        Output of the board since the last query.
    dead_man_timeout_s, last_command_at_s
        Time without a command after which the firmware's dead-man timer switches heaters off; time of the
        last command.
    executed_line_count
        Number of lines up to the last heating line that the session executed itself.
    final_line_count
        Number of lines that the printer has acknowledged, once the stream is over.
    is_pause_requested, pause_ends_s, is_nozzle_paused
        True if a person has requested a pause; the time at which the pause times out; True if the pause
        switched the nozzle off, whatever target the file has set.
    """

    link: Link
    program: Program | None
    profile: Profile
    filament: Filament
    pace: Pace
    now_s: float
    identity: str | None = None
    previous_fault: Fault = Fault.AGENT_DIED
    suspicion: Suspicion | None = None
    has_extruded: bool = False
    can_reset_board: bool = True
    ends_by_s: float | None = None
    phase: PrintPhase = field(default=PrintPhase.CONNECTING, init=False)
    fault: Fault | None = field(default=None, init=False)
    reason: str | None = field(default=None, init=False)
    started_s: float = field(init=False)
    ended_s: float | None = field(default=None, init=False)
    wants_reset: bool = field(default=False, init=False)
    wants_power_off: bool = field(default=False, init=False)
    power_off_requested_s: float = field(default=math.inf, init=False)
    heaters_off: bool = field(default=False, init=False)
    targets_off_s: float | None = field(default=None, init=False)
    connection: BoardConnected | None = field(default=None, init=False)
    report: Report | None = field(default=None, init=False)
    report_s: float = field(init=False)
    heater_watch: HeaterWatch = field(init=False)
    unexpected_report_count: int = field(default=0, init=False)
    position_mm: Point | None = field(default=None, init=False)
    answer: bytes = field(default=b"", init=False)
    dead_man_timeout_s: float = field(default=0.0, init=False)
    last_command_at_s: float = field(init=False)
    executed_line_count: int = field(default=0, init=False)
    final_line_count: int | None = field(default=None, init=False)
    is_pause_requested: bool = field(default=False, init=False)
    pause_ends_s: float | None = field(default=None, init=False)
    is_nozzle_paused: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self.started_s = self.report_s = self.last_command_at_s = self.now_s
        self.heater_watch = HeaterWatch(2 * self.pace.min_timeout_s)

    @property
    def firmware(self) -> Firmware:
        """The firmware of the printer's model."""
        return self.profile.firmware

    @property
    def has_ended(self) -> bool:
        """True if the print has ended."""
        return self.phase.ended

    @property
    def acknowledged_line_count(self) -> int:
        """Number of lines of the file that the printer has acknowledged."""
        if self.final_line_count is not None:
            return self.final_line_count
        if self.program is None or self.connection is None:
            return 0  # the link counts the lines of the last print until the board has restarted
        return self.done_line_count

    @property
    def done_line_count(self) -> int:
        """Number of lines of the file that were acknowledged or executed by the session."""
        return max(self.executed_line_count, self.link.streamed_line_count)

    @property
    def report_deadline_s(self) -> float:
        """Time by which a report that is requested now has to arrive."""
        return self.now_s + max(REPORT_TIMEOUT_S, 5 * self.pace.min_timeout_s)

    @property
    def no_report_deadline_s(self) -> float:
        """Time at which a print without a report is ended."""
        return self.report_s + max(NO_REPORT_TIMEOUT_S, 5 * self.pace.min_timeout_s)

    def wait(self, condition: Callable[[], bool], limit_s: float) -> Wait:
        """Return a wait for a condition, with the deadline of `compute_deadline_s`."""
        return Wait(condition, self.compute_deadline_s(limit_s))

    def compute_deadline_s(self, limit_s: float) -> float:
        """Compute the time `limit_s` from now, or the end of the shortest timeout if that is later."""
        return self.now_s + max(limit_s, 2 * self.pace.min_timeout_s)

    def request_power_off(self) -> None:
        """Request, once, that the caller cuts the mains."""
        if not self.wants_power_off:
            self.wants_power_off, self.power_off_requested_s = True, self.now_s
