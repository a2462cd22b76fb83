"""The state of one session, which all of its scripts share, and what a script is made of. Pure.

A script is a generator function of a `SessionContext`; each value that it yields is what it waits for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, field

from drivers.clock import Clock
from drivers.errors import Fault, Unreadable
from drivers.firmware import Firmware
from drivers.gcode import Point, Program
from drivers.link import Link, Report, Up
from drivers.messages import Filament, PrintPhase
from drivers.printers import Profile
from drivers.records import Suspicion
from drivers.safety import HeaterWatch

REPORT_S = 180.0  # without a report while heating; behind a slow move, and sent again, one may take this long
BLIND_S = 700.0  # printing without a report: longer than any command may take


@dataclass(frozen=True, slots=True)
class Pace:
    """Intervals of questions, and the least patience; in seconds of the farm's clock.

    An accelerated clock must neither flood the link with M105 nor take the host's scheduling for a silent
    board, so each of them has a bound in wall time.
    """

    floor_s: float = 2.0
    heating_s: float = 1.0
    printing_s: float = 3.0
    idle_s: float = 5.0

    @classmethod
    def of(cls, clock: Clock) -> Pace:
        """2 wall seconds of patience; at most 10 reports a wall second when heating, 2 in a print, 1 idle."""
        scale = clock.scale
        return cls(
            floor_s=2.0 * scale,
            heating_s=max(1.0, 0.1 * scale),
            printing_s=max(3.0, 0.5 * scale),
            idle_s=max(5.0, 1.0 * scale),
        )


class Ended(Exception):
    """Leaves the normal way of a print: a fault, or a cancel where `fault` is None."""

    def __init__(self, fault: Fault | None, reason: str) -> None:
        super().__init__(reason)
        self.fault = fault
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Wait:
    """Until this is met, or the time has come; the script is told which (True where it is met)."""

    until: Callable[[], bool]
    deadline_s: float = math.inf


Script = Generator[Wait, bool, None]
Answer = Generator[Wait, bool, bool]
"""A script that tells whether it came to its end in time."""


@dataclass(slots=True, eq=False)
class SessionContext:
    """All that one session knows. Its scripts and its `Session` write it; others read.

    Attributes
    ----------
    link
        The conversation with the board.
    program
        What is printed; None where the board is only reset and its heaters shown off.
    profile
        The printer that the board must be.
    filament
        Where it is.
    pace
        See `Pace`.
    now_s
        The farm's clock at the last `Session.advance`.
    identity
        What its banner says of this very printer; None where nobody has seen it yet.
    left_by
        Without a program: what ended the last agent's print.
    board_resets
        The board starts anew when the port is reset. One that does not is told what a new one would be, and
        where it does not listen nobody can stop it: it is used only while somebody is there.
    suspicion
        A heater that may be stuck on: found in this session, or handed on by the one before, and not seen to
        cool since.
    extruded
        Something of this print may lie on the bed.
    ends_by_s
        The print is ended safely where it has not ended by then.
    phase
        Of the print.
    fault, reason
        Why it was left; a cancel is no fault.
    started_s, ended_s
        Of the session.
    wants_reset
        Asks the caller to reset the port; `Session.port_was_reset` takes it back.
    wants_power_off, power_off_asked_s
        Asks the caller to cut the printer's mains, if it can: heaters could not be shown off. It stays, so
        that one session asks once.
    heaters_off, targets_off_s
        Since the last heating command a report has shown both targets 0, and each heater was seen to cool or
        to be cold; when the targets were first seen 0.
    greeting
        The board's banner, or first answer, since the last reset.
    report, report_s
        The last temperatures, and when they came.
    watch, odd_reports
        Judges the heaters; reports in a row with targets that nobody here set.
    position
        By the last answer to M114.
    answer
        What the board said since the last question.
    dead_man_s, fed_s
        The firmware's own end of all heat where no command comes for so long; when the last one was sent.
    heated_lines
        Lines of the file up to the last heating line that was carried out here.
    final_lines
        Lines that the printer has acknowledged, once the stream is over.
    pause_wanted, pause_ends_s, nozzle_paused
        A person's wish; when the pause has lasted too long; the nozzle is off, whatever the file has set.
    unreadable
        Why the file cannot be read any more.
    """

    link: Link
    program: Program | None
    profile: Profile
    filament: Filament
    pace: Pace
    now_s: float
    identity: str | None = None
    left_by: Fault = Fault.AGENT_DIED
    suspicion: Suspicion | None = None
    extruded: bool = False
    board_resets: bool = True
    ends_by_s: float | None = None
    phase: PrintPhase = field(default=PrintPhase.CONNECTING, init=False)
    fault: Fault | None = field(default=None, init=False)
    reason: str | None = field(default=None, init=False)
    started_s: float = field(init=False)
    ended_s: float | None = field(default=None, init=False)
    wants_reset: bool = field(default=False, init=False)
    wants_power_off: bool = field(default=False, init=False)
    power_off_asked_s: float = field(default=math.inf, init=False)
    heaters_off: bool = field(default=False, init=False)
    targets_off_s: float | None = field(default=None, init=False)
    greeting: Up | None = field(default=None, init=False)
    report: Report | None = field(default=None, init=False)
    report_s: float = field(init=False)
    watch: HeaterWatch = field(init=False)
    odd_reports: int = field(default=0, init=False)
    position: Point | None = field(default=None, init=False)
    answer: bytes = field(default=b"", init=False)
    dead_man_s: float = field(default=0.0, init=False)
    fed_s: float = field(init=False)
    heated_lines: int = field(default=0, init=False)
    final_lines: int | None = field(default=None, init=False)
    pause_wanted: bool = field(default=False, init=False)
    pause_ends_s: float | None = field(default=None, init=False)
    nozzle_paused: bool = field(default=False, init=False)
    unreadable: Unreadable | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.started_s = self.report_s = self.fed_s = self.now_s
        self.watch = HeaterWatch(2 * self.pace.floor_s)

    @property
    def firmware(self) -> Firmware:
        """The firmware of the printer's model."""
        return self.profile.firmware

    @property
    def ended(self) -> bool:
        return self.phase.ended

    @property
    def streamed(self) -> int:
        """Lines of the file that the printer has acknowledged."""
        if self.final_lines is not None:
            return self.final_lines
        if self.program is None or self.greeting is None:
            return 0  # until the board has started anew, the link counts what was printed before
        return self.done_lines

    @property
    def done_lines(self) -> int:
        """Lines of the file that were carried out here or acknowledged."""
        return max(self.heated_lines, self.link.streamed)

    @property
    def report_by_s(self) -> float:
        """Time by which a report that is asked for now has to be there."""
        return self.now_s + max(REPORT_S, 5 * self.pace.floor_s)

    @property
    def blind_by_s(self) -> float:
        """Time at which a print has been without a report for too long."""
        return self.report_s + max(BLIND_S, 5 * self.pace.floor_s)

    def wait(self, met: Callable[[], bool], limit_s: float) -> Wait:
        """Until this is met, for so long at most, or for what a busy host needs."""
        return Wait(met, self.by_s(limit_s))

    def by_s(self, limit_s: float) -> float:
        """Time at which so much is over, or what a busy host needs."""
        return self.now_s + max(limit_s, 2 * self.pace.floor_s)

    def ask_power_off(self) -> None:
        """Ask the caller, once, to cut the mains."""
        if not self.wants_power_off:
            self.wants_power_off, self.power_off_asked_s = True, self.now_s
