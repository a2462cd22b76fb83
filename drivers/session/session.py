"""One print on one board, without I/O: from the reset before it to heaters shown off.

A `Session` is told what the link heard (`advance`), and says in turn what it needs: bytes go through its
`link`, and `wants_reset` asks the caller to reset the port. The steps are written one after the other in a
generator; what it yields is what it waits for. Whatever happens, the last thing it does is to have heaters
shown off:

- by command, where the firmware listens (the safe sequence of
  docs/explanation/ultimaker2-serial.md, section 5);
- by a reset, where it does not, after which M105 must report both targets 0.

The file's own M190 and M109 are never sent: the firmware hears nothing while it carries them out. They
become M140 and M104, and M105 up to the target, so that a cancel is heard within one report.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import Fault, Unreadable
from drivers.gcode.filament_position import place
from drivers.gcode.program import Heat, HeaterName, Program
from drivers.link.link import Event, Events, Link, Report, Said, Trouble, Up
from drivers.link.link import Phase as LinkPhase
from drivers.messages import Filament, PrintPhase
from drivers.printers.profiles import Profile
from drivers.session.leave import BARRIERS, Leaving
from drivers.session.park import PARKED_MM
from drivers.session.steps import HEAT_DEAD_MAN_S, HOT_ENOUGH_C, PRINT_DEAD_MAN_S, Ended, Pace, Script, Wait

__all__ = ["PARKED_MM", "Pace", "Session", "Suspicion"]

SUSPECT_S = 25.0  # for a heater that was found stuck on to be seen to cool
LEFT_S = 15.0  # for a board to start again and tell how hot it is, where the agent died after the finding
BLIND_S = 700.0  # printing without a report: longer than any command may take
_OFF = {HeaterName.NOZZLE: 0.0, HeaterName.BED: 0.0}

NOBODY_THERE = "it prints only while somebody is there, and nobody was to be there any more"
_LEFT = {
    Fault.AGENT_DIED: "the agent's process ended in the middle of the print",
    Fault.ESTOP: "a person stopped it by `farm estop`",
}


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A heater that may be stuck on, and since when, in seconds of the farm's clock."""

    text: str
    since_s: float


class Session(Leaving):
    """One print, or the recovery of one that an agent left behind.

    Parameters
    ----------
    link
        The conversation with the board; the caller moves its bytes and calls its `tick`.
    program
        What to print; None only resets the board and shows its heaters off (`left` says why).
    profile
        The printer that the board must be.
    filament
        Where the filament is at the start; `filament` is kept up to date.
    pace
        See `Pace`.
    now_s
        The farm's clock.
    identity
        What this printer's banner said of it before (`identity` of an earlier session); None: not known yet.
    left
        Without a program: what ended the last agent's print.
    suspicion
        Of the session before, where that did not come to its end.

    Attributes
    ----------
    suspicion
        A heater that may be stuck on: found in this session, and not seen to cool since. Where it is not
        within `SUSPECT_S`, the mains are asked for (`wants_power_off`).
    """

    def __init__(
        self,
        link: Link,
        program: Program | None,
        profile: Profile,
        filament: Filament,
        pace: Pace,
        now_s: float,
        identity: str | None = None,
        left: Fault = Fault.AGENT_DIED,
        suspicion: Suspicion | None = None,
    ) -> None:
        super().__init__(link, program, profile, filament, pace, now_s, identity)
        self._left = left
        self.suspicion = suspicion
        self.extruded = False
        self.started_s = now_s
        self.ended_s: float | None = None
        self.ends_by_s: float | None = None  # it is ended safely where it has not ended by then
        self._heard_s = now_s  # when it reported temperatures
        self._blind_s = max(BLIND_S, 5 * pace.floor_s)
        self._strange = 0  # reports in a row with targets that nobody here set
        self._unreadable: Unreadable | None = None
        self._script = self._run()
        self._wait = next(self._script)

    # --- what the caller does ---

    @property
    def ended(self) -> bool:
        return self.phase.ended

    @property
    def deadline_s(self) -> float:
        """When `advance` wants to be called without events."""
        if self.ended:
            return math.inf
        return min(self._wait.deadline_s, self._last_moment_s(), self._ask_by_s())

    def advance(self, events: Events, now_s: float) -> None:
        """Take what the link heard, and go as far as that allows."""
        self._now_s = now_s
        ended: Ended | None = None
        for event in events:
            ended = ended or self._notice(event)
        if now_s >= self._last_moment_s():
            ended = ended or Ended(Fault.HOURS_ENDED, NOBODY_THERE)
        if ended is not None:
            self._leave(ended)
        if now_s >= self._ask_by_s():
            self._ask_power_off()
        while not self.ended:
            if self._wait.until():
                self._resume(lambda: self._script.send(True))
            elif now_s >= self._wait.deadline_s:
                self._resume(lambda: self._script.send(False))
            else:
                return

    def pause(self, now_s: float) -> None:
        """Park where the head can come back to, and wait for `resume`; nothing where it does not print."""
        self._pause_wanted = self.phase in (PrintPhase.PRINTING, PrintPhase.PAUSED)
        self.advance((), now_s)

    def resume(self, now_s: float) -> None:
        """Go on after a `pause`."""
        self._pause_wanted = False
        self.advance((), now_s)

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

    def _last_moment_s(self) -> float:
        """When a print that still goes on is ended."""
        going_on = self.phase is not PrintPhase.ENDING and not self.ended
        return self.ends_by_s if going_on and self.ends_by_s is not None else math.inf

    def _ask_by_s(self) -> float:
        """When the mains are asked for, unless the suspected heater was seen to cool before."""
        if self.suspicion is None or self.wants_power_off or self.ended:
            return math.inf
        patience_s = 2 * self._pace.floor_s
        found_s, begun_s = self.suspicion.since_s, self.started_s  # it may be of the session before
        return max(found_s + max(SUSPECT_S, patience_s), begun_s + max(LEFT_S, patience_s))

    # --- what was heard ---

    def _notice(self, event: Event) -> Ended | None:
        if isinstance(event, Report):
            self.report = event
            self._heard_s = self._now_s
            return self._watch_heaters(event)
        if isinstance(event, Up):
            self._up = event
        elif isinstance(event, Said):
            self._said += event.text + b"\n"
            self._place = place(event.text) or self._place
        elif isinstance(event, Trouble):
            if event.fault is Fault.MAXTEMP:
                self._suspect(event.text)
            if not self.link.only_ask or self.link.phase is LinkPhase.DEAD:
                return Ended(event.fault, event.text)
        return None

    def _suspect(self, text: str) -> None:
        if self.suspicion is None:
            self.suspicion = Suspicion(text.lstrip(" :"), self._now_s)

    def _set_c(self) -> dict[HeaterName, float]:
        """What the heaters were told."""
        program = self.program
        if program is None or self.phase not in _HEATED:
            return _OFF
        done = max(self._carried_out, self.link.streamed)
        nozzle_c = 0.0 if self._nozzle_off else program.target_c(HeaterName.NOZZLE, done) or 0.0
        return {
            HeaterName.NOZZLE: nozzle_c,
            HeaterName.BED: program.target_c(HeaterName.BED, done) or 0.0,
        }

    def _watch_heaters(self, report: Report) -> Ended | None:
        set_c = self._set_c()
        finding = self._watch.look(report, set_c, self._now_s)
        if self.phase not in _HEATED and self.phase is not _ENDING:
            return None
        if finding is not None and (finding.fault is Fault.HEATER_STUCK_ON or self.phase is _ENDING):
            self._suspect(finding.text)
            if finding.off or self.phase is _ENDING:
                self._ask_power_off()
        elif self._watch.cools and not self.wants_power_off:
            self.suspicion = None
        if self.phase is _ENDING:
            if finding is None or self.reason is not None:  # it is left already
                return None
            return Ended(finding.fault, finding.text)
        return self._watch_targets(report, set_c) or (
            None if finding is None else Ended(finding.fault, finding.text)
        )

    def _watch_targets(self, report: Report, set_c: dict[HeaterName, float]) -> Ended | None:
        """Tinker firmware and people at the knob change targets behind a host's back."""
        nozzle_c, bed_c = set_c[HeaterName.NOZZLE], set_c[HeaterName.BED]
        same = abs(report.nozzle_target_c - nozzle_c) <= 1 and abs(report.bed_target_c - bed_c) <= 1
        self._strange = 0 if same else self._strange + 1
        if self._strange < 3:  # one may be garbled
            if not same:  # soon, but not before what is on its way to set it
                self.link.poll_soon(self._now_s + self._pace.heating_s)
            return None
        found = f"nozzle {report.nozzle_target_c:g} and bed {report.bed_target_c:g} C"
        return Ended(Fault.TARGET_CHANGED, f"somebody set {found}, not {nozzle_c:g} and {bed_c:g}")

    # --- the script ---

    def _resume(self, step: Callable[[], Wait]) -> None:
        try:
            self._wait = step()
        except StopIteration:
            self.ended_s = self._now_s if self._off_s is None else self._off_s
            self.wants_reset = False
            self.link.poll_every_s = self._pace.idle_s
            self.link.poll(self._now_s)

    def _leave(self, ended: Ended) -> None:
        self._resume(lambda: self._script.throw(ended))

    def _run(self) -> Script:
        outcome = PrintPhase.DONE
        try:
            yield from self._print()
        except (Ended, Unreadable) as why:
            ended = why if isinstance(why, Ended) else Ended(Fault.BAD_FILE, str(why))
            self.fault, self.reason = ended.fault, ended.reason
            outcome = PrintPhase.CANCELLED if ended.fault is None else PrintPhase.FAILED
            self.phase = PrintPhase.ENDING
            yield from self._make_safe()
        self.phase = outcome

    def _print(self) -> Script:
        program = self.program
        if program is None:
            raise Ended(self._left, _LEFT[self._left])
        yield from self._identify()
        self.phase = PrintPhase.HEATING
        self.heaters_off = False
        yield from self._dead_man(HEAT_DEAD_MAN_S)
        stops: dict[int, Heat | None] = {program.homes + 1: None, program.extrudes: None, program.count: None}
        stops |= {heat.line: heat for heat in program.heats if heat.waits}
        cools = next((heat.line for heat in program.heats if _cools(heat, program.extrudes)), program.count)
        stops.setdefault(cools, None)
        at = 0
        for stop in sorted(stop for stop in stops if stop <= program.count):
            yield from self._stream(program, at, stop)
            at = stop
            if stop == program.homes + 1:
                yield from self._check_height(program.lines(program.homes, stop)[0])
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
                yield from self._dead_man(PRINT_DEAD_MAN_S)
            if stop == cools and self.phase is PrintPhase.PRINTING:
                yield from self._seen_hot()
        yield from self._finish(program)

    def _seen_hot(self) -> Script:
        """A last look before the file itself cools down: a board that stopped answers all moves at once."""
        while True:
            seen = self.report
            self.link.poll(self._now_s)
            yield Wait(lambda seen=seen: self.report is not seen, self._now_s + self._deaf_s)  # type: ignore[misc]
            if self.report is seen:
                raise Ended(Fault.NO_ANSWER, "the board tells no temperatures at the end of the print")
            if not self._strange:  # else it is asked again, until it is strange enough
                return

    def _finish(self, program: Program) -> Script:
        self.phase = PrintPhase.ENDING
        self._streamed = program.count
        yield from self._commands(b"M104 S0", b"M140 S0", b"M107", *BARRIERS, limit_s=math.inf)
        if self.filament is Filament.AT_NOZZLE:
            # as far back as the file's end code left it: it cools already
            yield from self._park(self._back_mm(program, program.count), hot=False)
        if not (yield from self._shown_off()):
            if self.report is not None and self.report.off:
                raise Ended(Fault.HEATER_STUCK_ON, "a heater was not seen to cool at the end of the print")
            raise Ended(Fault.NO_ANSWER, "heaters were not shown off at the end of the print")
        yield from self._dead_man(0.0)

    def _stream(self, program: Program, start: int, stop: int) -> Script:
        while start < stop:
            self.link.poll_every_s = self._pace.printing_s
            self.link.stream(self._now_s, self._lines, start, stop)
            self._heard_s = self._now_s
            while not (yield Wait(self._sent_or_paused, self._heard_s + self._blind_s)):
                if self._now_s - self._heard_s >= self._blind_s:
                    raise Ended(Fault.NO_ANSWER, "the board prints, but tells no temperatures")
            if self._unreadable is not None:
                raise self._unreadable
            if self.link.drained:
                return
            self.link.halt()
            yield Wait(lambda: self.link.drained)
            start = self.link.streamed
            if self._pausable():  # the line that was under way may have ended the heat
                yield from self._pause(program, start)

    def _lines(self, start: int, stop: int) -> list[bytes]:
        """Lines for the link. Once some cannot be had there are no more: none must be left out."""
        assert self.program is not None
        if self._unreadable is None:
            try:
                return self.program.lines(start, stop)
            except Unreadable as error:
                self._unreadable = error
        return []

    def _sent_or_paused(self) -> bool:
        return self.link.drained or self._unreadable is not None or (self._pause_wanted and self._pausable())


def _cools(heat: Heat, after: int) -> bool:
    return heat.heater is HeaterName.NOZZLE and heat.target_c == 0 and heat.line > after


_ENDING = PrintPhase.ENDING
_HEATED = (PrintPhase.HEATING, PrintPhase.PRINTING, PrintPhase.PAUSED)
