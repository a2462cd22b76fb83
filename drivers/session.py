"""One print on one board, without I/O: from the reset before it to heaters shown off.

A `Session` is told what the link heard (`advance`), and says in turn what it needs: bytes go through its
`link`, and `wants_reset` asks the caller to reset the port. The steps are written one after the other in a
generator; what it yields is what it waits for. Whatever happens, the last thing it does is to have heaters
shown off:

- by command, where the firmware listens (the safe sequence of um2-serial section 5);
- by a reset, where it does not, after which M105 must report both targets 0.

The file's own M190 and M109 are never sent: the firmware hears nothing while it carries them out. They
become M140 and M104, and M105 up to the target, so that a cancel is heard within one report.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator

from drivers.errors import Fault
from drivers.filament import Point, place, retracted_mm
from drivers.gcode import Heat, HeaterName, Program
from drivers.marlin import Event, Events, Link, Report, Said, Trouble, Up
from drivers.marlin import Phase as LinkPhase
from drivers.messages import Filament, PrintPhase
from drivers.profiles import Profile
from drivers.steps import TRIES, Ended, Pace, Script, Steps, Wait

__all__ = ["PARKED_MM", "Pace", "Session"]

PARKED_MM = 20.0  # how far back the end code and the printer's own menu leave the filament
PARKED_SLACK_MM = 0.25
HOT_ENOUGH_C = 175.0  # the firmware refuses to extrude below 170
BED_BAND_C = 0.5
NOZZLE_BAND_C, NOZZLE_HOLD_S = 2.0, 3.0  # as M109: residence near the target
STALL_C = 1.0  # a heater that comes no nearer than this in STALL_S is broken
STALL_S = {HeaterName.NOZZLE: 60.0, HeaterName.BED: 150.0}
HEAT_LIMIT_S = {HeaterName.NOZZLE: 900.0, HeaterName.BED: 2400.0}
DEAD_MAN_S = 1200.0
FEED_S = 300.0  # M105 does not feed the dead-man, a command does
DEAF_S = 180.0  # without a report while heating; behind a slow move, and sent again, one may take this long
STOP_S = 30.0  # M401 waits for the move under way
_BARRIERS = (b"M400",) * 3  # the ok of a garbled last line may be believed; that of three is not

_RESET_AFTER = frozenset(
    (
        Fault.STOPPED, Fault.MAXTEMP, Fault.MINTEMP, Fault.KILL, Fault.REBOOT, Fault.ENDSTOP,
        Fault.NO_ANSWER, Fault.NOISY_LINE, Fault.PORT_LOST, Fault.AGENT_DIED,
    )
)  # fmt: skip
_SETS = {HeaterName.NOZZLE: b"M104 S%g", HeaterName.BED: b"M140 S%g"}


class Session(Steps):
    """One print, or the recovery of one that an agent left behind.

    Parameters
    ----------
    link
        The conversation with the board; the caller moves its bytes and calls its `tick`.
    program
        What to print; None only resets the board and shows its heaters off (`fail` says why).
    profile
        The printer that the board must be.
    filament
        Where the filament is at the start; `filament` is kept up to date.
    pace
        See `Pace`.
    now_s
        The farm's clock.
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
        self.fault: Fault | None = None
        self.reason: str | None = None
        self.extruded = False
        self.started_s = now_s
        self.ended_s: float | None = None
        self._place: Point | None = None  # by the last M114
        self._strange = 0  # reports in a row with targets that nobody here set
        self._deaf_s = max(DEAF_S, 5 * pace.floor_s)
        self._dead_man_s = max(DEAD_MAN_S, 10 * pace.floor_s)
        self._carried_out = 0  # lines of the file up to the last heating line that was carried out here
        self._streamed: int | None = None  # once the stream is over
        self._script = self._run()
        self._wait = next(self._script)

    # --- what the caller does ---

    @property
    def streamed(self) -> int:
        """Lines of the file that the printer has acknowledged."""
        if self._streamed is not None:
            return self._streamed
        return max(self._carried_out, self.link.streamed) if self.program is not None else 0

    @property
    def ended(self) -> bool:
        return self.phase.ended

    @property
    def deadline_s(self) -> float:
        """When `advance` wants to be called without events."""
        return math.inf if self.ended else self._wait.deadline_s

    def advance(self, events: Events, now_s: float) -> None:
        """Take what the link heard, and go as far as that allows."""
        self._now_s = now_s
        ended: Ended | None = None
        for event in events:
            ended = ended or self._notice(event)
        if ended is not None:
            self._leave(ended)
        while not self.ended:
            if self._wait.until():
                self._resume(lambda: self._script.send(True))
            elif now_s >= self._wait.deadline_s:
                self._resume(lambda: self._script.send(False))
            else:
                return

    def cancel(self, reason: str, now_s: float) -> None:
        """End the print safely; nothing where it is ending already."""
        self._now_s = now_s
        if self.phase is not PrintPhase.ENDING and not self.ended:
            self._leave(Ended(None, reason))
            self.advance((), now_s)

    def fail(self, fault: Fault, reason: str, now_s: float) -> None:
        """The caller has seen something that ends the print (the port went)."""
        self._now_s = now_s
        if not self.ended:
            self._leave(Ended(fault, reason))
            self.advance((), now_s)

    # --- what was heard ---

    def _notice(self, event: Event) -> Ended | None:
        if isinstance(event, Report):
            self.report = event
            return self._watch_targets(event)
        if isinstance(event, Up):
            self._up = event
        elif isinstance(event, Said):
            self._place = place(event.text) or self._place
        elif isinstance(event, Trouble) and not (
            self.link.only_ask and self.link.phase is not LinkPhase.DEAD
        ):
            return Ended(event.fault, event.text)
        return None

    def _watch_targets(self, report: Report) -> Ended | None:
        """Tinker firmware and people at the knob change targets behind a host's back."""
        program = self.program
        if program is None or self.phase not in (PrintPhase.HEATING, PrintPhase.PRINTING):
            return None
        done = max(self._carried_out, self.link.streamed)
        nozzle_c = program.target_c(HeaterName.NOZZLE, done) or 0.0
        bed_c = program.target_c(HeaterName.BED, done) or 0.0
        same = abs(report.nozzle_target_c - nozzle_c) <= 1 and abs(report.bed_target_c - bed_c) <= 1
        self._strange = 0 if same else self._strange + 1
        if self._strange < 3:  # one may be garbled
            return None
        found = f"nozzle {report.nozzle_target_c:g} and bed {report.bed_target_c:g} C"
        return Ended(Fault.TARGET_CHANGED, f"somebody set {found}, not {nozzle_c:g} and {bed_c:g}")

    # --- the script ---

    def _resume(self, step: Callable[[], Wait]) -> None:
        try:
            self._wait = step()
        except StopIteration:
            self.ended_s = self._now_s
            self.wants_reset = False
            self.link.poll_every_s = self._pace.idle_s
            self.link.poll(self._now_s)

    def _leave(self, ended: Ended) -> None:
        self._resume(lambda: self._script.throw(ended))

    def _run(self) -> Script:
        outcome = PrintPhase.DONE
        try:
            yield from self._print()
        except Ended as ended:
            self.fault, self.reason = ended.fault, ended.reason
            outcome = PrintPhase.CANCELLED if ended.fault is None else PrintPhase.FAILED
            self.phase = PrintPhase.ENDING
            yield from self._make_safe()
        self.phase = outcome

    def _print(self) -> Script:
        program = self.program
        if program is None:
            raise Ended(Fault.AGENT_DIED, "the agent's process ended in the middle of the print")
        yield from self._connect()
        self._check_printer()
        self.phase = PrintPhase.HEATING
        self.heaters_off = False
        yield from self._commands(b"M85 S%d" % self._dead_man_s)
        stops: dict[int, Heat | None] = {program.extrudes: None, program.count: None}
        stops |= {heat.line: heat for heat in program.heats if heat.waits}
        at = 0
        for stop in sorted(stops):
            yield from self._stream(program, at, stop)
            at = stop
            heat = stops[stop]
            if heat is not None:
                self._carried_out = at = stop + 1
                yield from self._heat(heat)
                hot = heat.heater is HeaterName.NOZZLE and heat.target_c >= HOT_ENOUGH_C
                if hot and self.filament is Filament.PARKED:
                    yield from self._unpark()
            elif stop == program.extrudes < program.count:
                self.extruded = True
                self.phase = PrintPhase.PRINTING
        self.phase = PrintPhase.ENDING
        self._streamed = program.count
        yield from self._commands(b"M104 S0", b"M140 S0", b"M107", *_BARRIERS, limit_s=math.inf)
        if (
            self.filament is Filament.AT_NOZZLE
        ):  # as far back as the file's end code left it: it cools already
            yield from self._park(retracted_mm(program, program.count), hot=False)
        yield from self._commands(b"M85 S0")
        if not (yield from self._shown_off()):
            raise Ended(Fault.NO_ANSWER, "heaters were not shown off at the end of the print")

    def _check_printer(self) -> None:
        banner = self._up.banner if self._up is not None else b""
        version = next((line for line in banner.split(b"\n") if b"Vers:" in line), None)
        if version is None:
            return  # lost on the way; a noisy line is the link's matter
        if version.rstrip().endswith(b"ex") != (self.profile.banner_suffix == "ex"):
            said = version.decode("ascii", "replace")
            raise Ended(Fault.WRONG_PRINTER, f"not the board of an {self.profile.title}: {said!r}")

    def _stream(self, program: Program, start: int, stop: int) -> Script:
        if start < stop:
            self.link.poll_every_s = self._pace.printing_s
            self.link.stream(self._now_s, program.lines, start, stop)
            yield Wait(lambda: self.link.drained)

    def _heat(self, heat: Heat) -> Script:
        """What M109 and M190 do, in steps that can be left at any time."""
        yield from self._commands(_SETS[heat.heater] % heat.target_c)
        if heat.target_c == 0:
            return
        self.link.poll_every_s = self._pace.heating_s
        limit_s = self._now_s + HEAT_LIMIT_S[heat.heater]
        nearest_c, nearer_s, held_s = math.inf, self._now_s, math.inf
        while True:
            seen = self.report
            self.link.poll_soon(self._now_s + self._pace.heating_s)
            heard = yield Wait(lambda seen=seen: self.report is not seen, self._now_s + self._deaf_s)  # type: ignore[misc]
            report = self.report
            if not heard or report is None:
                raise Ended(
                    Fault.NO_ANSWER, f"the board answers, but tells no temperature of the {heat.heater}"
                )
            now_c = report.nozzle_c if heat.heater is HeaterName.NOZZLE else report.bed_c
            away_c = heat.target_c - now_c
            if heat.heater is HeaterName.BED and away_c <= BED_BAND_C:
                return
            if heat.heater is HeaterName.NOZZLE and abs(away_c) <= NOZZLE_BAND_C:
                held_s = min(held_s, self._now_s)
                if self._now_s - held_s >= NOZZLE_HOLD_S:
                    return
                continue
            held_s = math.inf
            if abs(away_c) < nearest_c - STALL_C:
                nearest_c, nearer_s = abs(away_c), self._now_s
            stalled = self._now_s - nearer_s > max(STALL_S[heat.heater], 2 * self._pace.floor_s)
            if stalled or self._now_s > limit_s:
                reached = f"{now_c:g} of {heat.target_c:g} C"
                raise Ended(Fault.HEATER_TIMEOUT, f"the {heat.heater} got to {reached} and no further")
            if self._now_s - self._fed_s > FEED_S:
                yield from self._commands(b"M85 S%d" % self._dead_man_s)

    def _unpark(self) -> Script:
        self.filament = Filament.UNKNOWN
        yield from self._commands(b"M82", b"G92 E0", b"G1 F300 E%g" % PARKED_MM, b"G92 E0", b"M400")
        self.filament = Filament.AT_NOZZLE

    def _park(self, back_mm: float, hot: bool) -> Script:
        """Draw the filament, which is so far back already, to where a print ends with it."""
        if abs(PARKED_MM - back_mm) <= PARKED_SLACK_MM:
            self.filament = Filament.PARKED
        elif hot:
            self.filament = Filament.UNKNOWN
            if (
                yield from self._commands(b"G91", b"G1 F1500 E%.3f" % (back_mm - PARKED_MM), b"G90", b"M400")
            ):
                self.filament = Filament.PARKED
        elif back_mm > PARKED_SLACK_MM:
            self.filament = Filament.UNKNOWN

    # --- ways out ---

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
        """The safe sequence of um2-serial section 5, with the filament parked. False where it got stuck."""
        self.link.halt()
        if not (yield from self._commands(b"M401", b"M104 S0", b"M140 S0", b"M107", limit_s=STOP_S)):
            return False
        if homed:  # else nobody knows how far the bed may go
            if self.filament is Filament.AT_NOZZLE and self.program is not None:
                self._place = None
                yield from self._commands(b"M114")
                done = max(self._carried_out, self.link.streamed)
                hot = self.report is not None and self.report.nozzle_c >= HOT_ENOUGH_C
                yield from self._park(retracted_mm(self.program, done, self._place), hot)
            away = (b"G91", b"G1 F1200 Z10", b"G90", b"G28 X0 Y0", b"M84", *_BARRIERS)
            if not (yield from self._commands(*away)):
                return False
        yield from self._commands(b"M85 S0")
        return (yield from self._shown_off())

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
                    if (yield from self._shown_off()):
                        if homed and self.fault is None:
                            yield from self._commands(b"G28 X0 Y0", b"M84", b"M400")
                        return
                except Ended as ended:
                    if ended.fault is Fault.PORT_LOST:
                        break
            self.reason = f"{self.reason}; heaters were not shown off: switch the printer off"
        finally:
            self.link.only_ask = False
