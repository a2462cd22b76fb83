"""What a session does with the filament and the head between two prints and in a pause. Pure.

The filament is either parked, drawn back by `PARKED_MM`, or at the nozzle, as far back as the file's own
retractions say; while it is on the way between them nobody knows where it is.
"""

from __future__ import annotations

import math

from drivers.errors import Fault, Unreadable
from drivers.gcode.filament_position import Point, Walk, retracted_mm
from drivers.gcode.program import Heat, HeaterName, Program
from drivers.link.link import Link
from drivers.messages import Filament, PrintPhase
from drivers.printers.profiles import Profile
from drivers.session.steps import HOT_ENOUGH_C, PAUSE_DEAD_MAN_S, PRINT_DEAD_MAN_S, Ended, Pace, Script, Steps

PARKED_MM = 20.0  # how far back the end code and the printer's own menu leave the filament
PARKED_SLACK_MM = 0.25
LIFT_MM = 10.0
ASIDE_MM = (10.0, 200.0)  # docs/explanation/ultimaker2-serial.md, section 5
LAST_PUSH_MM = 6.5  # pushed only when the head is back: a full nozzle oozes on the way
PAUSE_LIMIT_S = 7200.0
PAUSE_FEED_S = 4.0  # the display says "Printing with USB" for 5 s after a command: nobody starts an SD print


class Parking(Steps):
    """Steps that move filament, for one program on one printer.

    Attributes
    ----------
    filament
        Where it is.
    phase
        Of the print.
    pause_ends_s
        While it waits in a pause: when that has lasted too long.
    """

    def __init__(
        self,
        link: Link,
        program: Program | None,
        profile: Profile,
        filament: Filament,
        pace: Pace,
        now_s: float,
    ) -> None:
        super().__init__(link, pace, now_s)
        self.program = program
        self.profile = profile
        self.filament = filament
        self.phase = PrintPhase.CONNECTING
        self._place: Point | None = None  # by the last M114
        self._pause_wanted = False
        self.pause_ends_s: float | None = None
        self._nozzle_off = False  # in a pause, whatever the file has set

    def _unpark(self) -> Script:
        self.filament = Filament.UNKNOWN
        yield from self._commands(b"M82", b"G92 E0", b"G1 F300 E%g" % PARKED_MM, b"G92 E0", b"M400")
        self.filament = Filament.AT_NOZZLE

    def _park(self, back_mm: float, hot: bool) -> Script:
        """Draw the filament, so far back already (NaN: nobody knows), to where a print ends with it."""
        if math.isnan(back_mm):
            self.filament = Filament.UNKNOWN
        elif abs(PARKED_MM - back_mm) <= PARKED_SLACK_MM:
            self.filament = Filament.PARKED
        elif hot:
            self.filament = Filament.UNKNOWN
            if (
                yield from self._commands(b"G91", b"G1 F1500 E%.3f" % (back_mm - PARKED_MM), b"G90", b"M400")
            ):
                self.filament = Filament.PARKED
        elif back_mm > PARKED_SLACK_MM:
            self.filament = Filament.UNKNOWN

    def _back_mm(self, program: Program, done: int, stood: Point | None = None) -> float:
        """See `retracted_mm`; NaN where the file is not to be had any more."""
        try:
            return retracted_mm(program, done, stood)
        except Unreadable:
            return math.nan

    def _lift_mm(self, z_mm: float, done: int) -> float:
        """How far the bed goes down before the head leaves its part: others may be finished, and higher."""
        highest_mm = 0.0 if self.program is None else self.program.highest_mm(done)
        return max(0.0, min(max(z_mm, highest_mm) + LIFT_MM, self.profile.home_mm[2]) - z_mm)

    def _pausable(self) -> bool:
        """Whether the head may leave the part here and find back."""
        return (
            self.program is not None
            and self.phase is PrintPhase.PRINTING
            and self.filament is Filament.AT_NOZZLE
            and (self.program.target_c(HeaterName.NOZZLE, self.link.streamed) or 0.0) >= HOT_ENOUGH_C
        )

    def _pause(self, program: Program, done: int) -> Script:
        """Park, keep the bed warm, wait for a person, and go back.

        The filament is drawn back all the way, so that it is parked however the pause ends. Source:
        docs/explanation/ultimaker2-serial.md, section 5.
        """
        self.phase = PrintPhase.PAUSED
        self._place = None
        if not (yield from self._commands(b"M400", b"M114", limit_s=math.inf)) or self._place is None:
            raise Ended(Fault.NO_ANSWER, "the board does not tell where the head stands")
        walk = Walk(program, done)
        x, y, z, e = (
            told if math.isnan(exact) else exact for exact, told in zip(walk.at, self._place, strict=True)
        )
        yield from self._park(walk.back_mm, hot=True)
        over = b"G1 F1200 Z%.3f" % (z + self._lift_mm(z, done))
        yield from self._commands(b"G90", over, b"G1 F9000 X%g Y%g" % ASIDE_MM, b"M104 S0")
        self._nozzle_off = True
        yield from self._dead_man(PAUSE_DEAD_MAN_S)
        yield from self._rest()
        target_c = program.target_c(HeaterName.NOZZLE, done) or 0.0
        yield from self._dead_man(PRINT_DEAD_MAN_S)
        yield from self._commands(b"M104 S%g" % target_c)
        self._nozzle_off = False
        yield from self._heat(Heat(done, HeaterName.NOZZLE, target_c, waits=True))
        self.filament = Filament.UNKNOWN
        push_mm = PARKED_MM - walk.back_mm
        last_mm = min(LAST_PUSH_MM, push_mm)
        back: list[bytes] = [b"G91", b"G1 F300 E%.3f" % (push_mm - last_mm), b"G90"]
        back += [b"G1 F9000 X%.3f Y%.3f" % (x, y), b"G1 F1200 Z%.3f" % z]
        back += [b"G91", b"G1 F1500 E%.3f" % last_mm, b"G90", b"G92 E%.5f" % e]
        if not math.isnan(walk.feed_mm_min):
            back.append(b"G1 F%g" % walk.feed_mm_min)
        if walk.relative:
            back.append(b"G91")
        yield from self._commands(*back, b"M400")
        self.filament = Filament.AT_NOZZLE
        self.phase = PrintPhase.PRINTING

    def _rest(self) -> Script:
        """Until somebody resumes it."""
        self.pause_ends_s = self._now_s + PAUSE_LIMIT_S
        self.link.poll_every_s = self._pace.printing_s
        while self._pause_wanted:
            if self._now_s >= self.pause_ends_s:
                raise Ended(Fault.PAUSE_TIMEOUT, f"nobody resumed it in {PAUSE_LIMIT_S / 3600:g} h")
            yield self._until(lambda: not self._pause_wanted, PAUSE_FEED_S)
            if self._pause_wanted:
                yield from self._dead_man(self._dead_man_s)
        self.pause_ends_s = None
