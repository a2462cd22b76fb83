"""How a print is left before its end: heaters off, by command or by a reset, and shown off. Pure."""

from __future__ import annotations

import math
from collections.abc import Generator

from drivers.errors import Fault
from drivers.gcode.program import Program
from drivers.link.link import Link
from drivers.link.link import Phase as LinkPhase
from drivers.messages import Filament
from drivers.printers.profiles import Profile
from drivers.session.identify import Identifying
from drivers.session.park import LIFT_MM
from drivers.session.steps import HOT_ENOUGH_C, TRIES, Ended, Pace, Script, Wait

STOP_S = 30.0  # M401 waits for the move under way
BARRIERS = (b"M400",) * 3  # the ok of a garbled last line may be believed; that of three is not

_RESET_AFTER = frozenset(
    (
        Fault.STOPPED, Fault.MAXTEMP, Fault.MINTEMP, Fault.KILL, Fault.REBOOT, Fault.ENDSTOP,
        Fault.NO_ANSWER, Fault.NOISY_LINE, Fault.PORT_LOST, Fault.AGENT_DIED, Fault.ESTOP,
    )
)  # fmt: skip


class Leaving(Identifying):
    """Steps out of a print, wherever it is.

    Attributes
    ----------
    fault, reason
        Why it is left; a cancel is no fault.
    """

    def __init__(
        self,
        link: Link,
        program: Program | None,
        profile: Profile,
        filament: Filament,
        pace: Pace,
        now_s: float,
        identity: str | None,
    ) -> None:
        super().__init__(link, program, profile, filament, pace, now_s, identity)
        self.fault: Fault | None = None
        self.reason: str | None = None
        self._carried_out = 0  # lines of the file up to the last heating line that was carried out here
        self._streamed: int | None = None  # once the stream is over

    @property
    def streamed(self) -> int:
        """Lines of the file that the printer has acknowledged."""
        if self._streamed is not None:
            return self._streamed
        if self.program is None or self._up is None:
            return 0  # until the board has started anew, the link counts what was printed before
        return max(self._carried_out, self.link.streamed)

    def _make_safe(self) -> Script:
        self._streamed = self.streamed
        homed = self.program is not None and self._streamed > self.program.homes
        listens = self._up is not None and self.link.phase is LinkPhase.LIVE
        if listens and self.fault not in _RESET_AFTER:
            try:
                if (yield from self._abort(homed)):
                    return
            except Ended:
                pass  # it stopped listening on the way
        yield from self._cut(homed)

    def _abort(self, homed: bool) -> Generator[Wait, bool, bool]:
        """Abort in the safe sequence, with the filament parked. False where it got stuck.

        Source: docs/explanation/ultimaker2-serial.md, section 5.
        """
        self.link.halt()
        if not (yield from self._commands(b"M401", b"M104 S0", b"M140 S0", b"M107", limit_s=STOP_S)):
            return False
        if homed:  # else nobody knows how far the bed may go
            done = max(self._carried_out, self.link.streamed)
            self._place = None
            yield from self._commands(b"M114")
            if self.filament is Filament.AT_NOZZLE and self.program is not None:
                hot = self.report is not None and self.report.nozzle_c >= HOT_ENOUGH_C
                yield from self._park(self._back_mm(self.program, done, self._place), hot)
            z_mm = math.nan if self._place is None else self._place[2]
            lift_mm = LIFT_MM if math.isnan(z_mm) else self._lift_mm(z_mm, done)
            away = (b"G91", b"G1 F1200 Z%.3f" % lift_mm, b"G90", b"G28 X0 Y0", b"M84", *BARRIERS)
            if not (yield from self._commands(*away)):
                return False
        if not (yield from self._shown_off()):
            return False
        yield from self._dead_man(0.0)
        return True

    def _cut(self, homed: bool) -> Script:
        """Heaters off by a reset: the only emergency stop that this firmware has."""
        if self.filament is Filament.AT_NOZZLE:
            self.filament = Filament.UNKNOWN
        self.link.only_ask = True
        try:
            for _ in range(TRIES):
                self.heaters_off = False
                try:
                    yield from self._connect()
                    if self._up is not None and not self._up.restarted:
                        yield from self._commands(b"M84")  # M401 has emptied the queue: it stands
                    if (yield from self._shown_off()):
                        if self._up is not None and not self._up.restarted:
                            yield from self._dead_man(0.0)
                        if homed and self.fault is None:
                            # The nozzle may stand in the part: the bed goes down to its switch first.
                            yield from self._commands(b"G28 Z0", b"G28 X0 Y0", b"M84", b"M400")
                        return
                except Ended as ended:
                    if ended.fault is Fault.PORT_LOST:
                        break
                if self.wants_power_off:
                    break
            self._ask_power_off()
            self.reason = f"{self.reason}; heaters were not shown off: switch the printer off"
        finally:
            self.link.only_ask = False
