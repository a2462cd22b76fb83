"""What every script of a session is made of: reset, commands, heaters shown off. Pure.

A script is a generator; what it yields is what it waits for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import Fault
from drivers.marlin import Link, Report, Up
from drivers.marlin import Phase as LinkPhase

ABORT_S = 180.0
OFF_S = 30.0
RESET_S = 30.0  # for a port that went away to come back
UP_S = 30.0  # the link itself asks before
TRIES = 3


@dataclass(frozen=True, slots=True)
class Pace:
    """How often to ask, and the least patience; in seconds of the farm's clock.

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


class Steps:
    """The steps, on one link.

    Attributes
    ----------
    link
        The conversation with the board.
    report
        The last temperatures.
    heaters_off
        A report has shown both targets 0 since the last heating command.
    wants_reset
        Asks the caller to reset the port; the caller takes it back when that is done.
    """

    def __init__(self, link: Link, pace: Pace, now_s: float) -> None:
        self.link = link
        self.report: Report | None = None
        self.heaters_off = False
        self.wants_reset = False
        self._pace = pace
        self._now_s = now_s
        self._up: Up | None = None
        self._fed_s = now_s  # when the dead-man was fed

    def _connect(self) -> Script:
        """Reset the board and wait until it answers; a new board has heaters off and counts lines from 1."""
        for _ in range(TRIES):
            self._up = None
            self.wants_reset = True
            self.link.poll_every_s = self._pace.heating_s
            if not (yield self._until(lambda: not self.wants_reset, RESET_S)):
                raise Ended(Fault.PORT_LOST, "the port is not there")
            heard = self._until(lambda: self._up is not None or self.link.phase is LinkPhase.DEAD, UP_S)
            yield heard
            if self._up is not None and self._up.restarted:
                return
        raise Ended(Fault.NO_ANSWER, "the board did not start again when its port was opened")

    def _until(self, met: Callable[[], bool], limit_s: float) -> Wait:
        return Wait(met, self._now_s + max(limit_s, 2 * self._pace.floor_s))

    def _commands(self, *commands: bytes, limit_s: float = ABORT_S) -> Generator[Wait, bool, bool]:
        """Send commands and wait until the last of them was carried out."""
        self.link.send(self._now_s, *commands)
        self._fed_s = self._now_s
        return (yield self._until(lambda: self.link.drained, limit_s))

    def _shown_off(self) -> Generator[Wait, bool, bool]:
        """Ask until a report shows both targets 0."""
        limit = self._until(lambda: False, OFF_S).deadline_s
        self.link.poll_every_s = self._pace.heating_s
        self.link.poll(self._now_s)
        while self._now_s < limit:
            seen = self.report
            yield Wait(lambda seen=seen: self.report is not seen, limit)  # type: ignore[misc]
            report = self.report
            if report is None or report is seen:
                continue
            if report.nozzle_target_c == 0 and report.bed_target_c == 0:
                self.heaters_off = True
                return True
        return False
