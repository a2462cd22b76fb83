"""What every script of a session is made of: reset, commands, heat, heaters shown off. Pure.

A script is a generator; what it yields is what it waits for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import Fault
from drivers.gcode.program import Heat, HeaterName
from drivers.link.link import Link, Report, Up
from drivers.link.link import Phase as LinkPhase
from drivers.safety.heater_watch import Watch

ABORT_S = 180.0
OFF_S = 120.0  # longer than the watch waits for a heater to fall
OFF_WITHOUT_MAINS_S = 60.0  # from the request to cut the mains: no reset helps then
OFF_LEAST_S = 10.0  # for a heater to fall after a reset, whatever was asked before
RESET_S = 30.0  # for a port that went away to come back
UP_S = 30.0  # the link itself asks before
TRIES = 3
BED_BAND_C = 0.5
NOZZLE_BAND_C, NOZZLE_HOLD_S = 2.0, 3.0  # as M109: residence near the target
HEAT_LIMIT_S = {HeaterName.NOZZLE: 900.0, HeaterName.BED: 2400.0}
DEAF_S = 180.0  # without a report while heating; behind a slow move, and sent again, one may take this long
HOT_ENOUGH_C = 175.0  # the firmware refuses to extrude below 170
HEAT_DEAD_MAN_S = 1200.0  # nothing feeds it in a G28 or behind slow moves
PRINT_DEAD_MAN_S = 600.0  # moves feed it, but not an M400 behind 17 slow ones
PAUSE_DEAD_MAN_S = 120.0  # fed every few seconds
FEED_S = 300.0  # while heating: M105 does not feed the dead-man, a command does

_AS_NEW = (
    b"M104 S0", b"M140 S0", b"M401", b"M107", b"G90", b"M82", b"M220 S100", b"M221 S100",
)  # fmt: skip
_SETS = {HeaterName.NOZZLE: b"M104 S%g", HeaterName.BED: b"M140 S%g"}


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
        Since the last heating command a report has shown both targets 0, and each heater was seen to cool or
        to be cold.
    wants_reset
        Asks the caller to reset the port; the caller takes it back when that is done.
    resets
        The board starts anew when the port is reset. One that does not is told what a new one would be, and
        where it does not listen nobody can stop it: it is used only while somebody is there.
    wants_power_off
        Asks the caller to cut the printer's mains, if it can: heaters could not be shown off. It stays, so
        that one session asks once.
    """

    def __init__(self, link: Link, pace: Pace, now_s: float) -> None:
        self.link = link
        self.report: Report | None = None
        self.heaters_off = False
        self.wants_reset = False
        self.wants_power_off = False
        self.resets = True
        self._pace = pace
        self._now_s = now_s
        self._asked_s = math.inf  # when `wants_power_off` was set
        self._watch = Watch(2 * pace.floor_s)
        self._up: Up | None = None
        self._dead_man_s = 0.0
        self._fed_s = now_s  # when the dead-man was fed
        self._off_s: float | None = None  # when both targets were first seen 0 by the last `_shown_off`
        self._deaf_s = max(DEAF_S, 5 * pace.floor_s)

    def _connect(self) -> Script:
        """Reset the board and wait until it answers: told to be cold, lines counted from 1.

        A board that started again has no dead-man. One that nothing resets keeps the one it has, whoever
        armed it, until its heaters are shown off.
        """
        for _ in range(TRIES):
            self._up = None
            self.wants_reset = True
            self.link.poll_every_s = self._pace.heating_s
            if not (yield self._until(lambda: not self.wants_reset, RESET_S)):
                raise Ended(Fault.PORT_LOST, "the port is not there")
            heard = self._until(lambda: self._up is not None or self.link.phase is LinkPhase.DEAD, UP_S)
            yield heard
            if self._up is not None and not (self._up.restarted or self.resets):
                yield from self._commands(*_AS_NEW)
            elif self._up is None or not self._up.restarted:
                continue
            else:
                self._dead_man_s = 0.0
            return
        raise Ended(Fault.NO_ANSWER, "the board did not start again when its port was opened")

    def _ask_power_off(self) -> None:
        if not self.wants_power_off:
            self.wants_power_off, self._asked_s = True, self._now_s

    def _until(self, met: Callable[[], bool], limit_s: float) -> Wait:
        return Wait(met, self._now_s + max(limit_s, 2 * self._pace.floor_s))

    def _commands(self, *commands: bytes, limit_s: float = ABORT_S) -> Generator[Wait, bool, bool]:
        """Send commands and wait until the last of them was carried out."""
        self.link.send(self._now_s, *commands)
        self._fed_s = self._now_s
        return (yield self._until(lambda: self.link.drained, limit_s))

    def _dead_man(self, seconds: float) -> Script:
        """Arm the firmware's own end of all heat where no command comes for so long; 0 is off."""
        self._dead_man_s = max(seconds, 10 * self._pace.floor_s) if seconds else 0.0
        yield from self._commands(b"M85 S%d" % self._dead_man_s)

    def _heat(self, heat: Heat) -> Script:
        """What M109 and M190 do, in steps that can be left at any time; the watch sees what is broken."""
        yield from self._commands(_SETS[heat.heater] % heat.target_c)
        if heat.target_c == 0:
            return
        self.link.poll_every_s = self._pace.heating_s
        limit_s = self._now_s + HEAT_LIMIT_S[heat.heater]
        held_s = math.inf
        while True:
            seen = self.report
            self.link.poll_soon(self._now_s + self._pace.heating_s)
            heard = yield Wait(lambda seen=seen: self.report is not seen, self._now_s + self._deaf_s)  # type: ignore[misc]
            if not heard:
                what = f"the board answers, but tells no temperature of the {heat.heater}"
                raise Ended(Fault.NO_ANSWER, what)
            now_c = self._watch.now_c(heat.heater)
            away_c = heat.target_c - now_c
            if heat.heater is HeaterName.BED and away_c <= BED_BAND_C:
                return
            if heat.heater is HeaterName.NOZZLE and abs(away_c) <= NOZZLE_BAND_C:
                held_s = min(held_s, self._now_s)
                if self._now_s - held_s >= NOZZLE_HOLD_S:
                    return
                continue
            held_s = math.inf
            if self._now_s > limit_s:
                late = f"the {heat.heater} got to {now_c:g} of {heat.target_c:g} C in the time it has"
                raise Ended(Fault.HEATER_TIMEOUT, late)
            if self._now_s - self._fed_s > FEED_S:
                yield from self._dead_man(self._dead_man_s)

    def _shown_off(self) -> Generator[Wait, bool, bool]:
        """Ask until a report shows both targets 0 and what is warm was seen to cool."""
        limit = self._until(lambda: False, OFF_S).deadline_s
        self._off_s = None
        self._watch.again()
        self.link.poll_every_s = self._pace.heating_s
        self.link.poll(self._now_s)
        least_s = self._until(lambda: False, OFF_LEAST_S).deadline_s
        while self._now_s < limit:
            limit = min(limit, max(least_s, self._asked_s + OFF_WITHOUT_MAINS_S))
            seen = self.report
            yield Wait(lambda seen=seen: self.report is not seen, limit)  # type: ignore[misc]
            if self.report is None or self.report is seen or not self.report.off:
                continue
            if self._off_s is None:
                self._off_s = self._now_s
            if self._watch.cools:
                self.heaters_off = True
                return True
        return False
