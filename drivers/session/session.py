"""One print on one board, without I/O: from the initial reset until the heaters are confirmed off.

A `Session` receives the events of its link (`advance`), sends through that link, and sets
`SessionContext.wants_reset` to have the caller reset the port. Its steps are the scripts of this package.
Whatever happens, a session ends by confirming that the heaters are off:

- by command, if the firmware responds (the safe sequence of
  docs/explanation/ultimaker2-serial.md, section 5);
- otherwise by a reset: then M105 must report both targets 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.errors import Fault, UnreadableFile
from drivers.gcode import read_position
from drivers.link import BoardConnected, Event, Events, LinkFault, Report, UnknownLine
from drivers.link import Phase as LinkPhase
from drivers.messages import PrintPhase
from drivers.session.context import PrintEnded, Script, SessionContext, Wait
from drivers.session.heat import compute_power_off_due_s, note_suspicion, watch_heaters
from drivers.session.identification import identify_printer
from drivers.session.print_abort import abort_print
from drivers.session.stream import print_program

UNATTENDED_REASON = "it prints only while somebody is present, and the attended hours have ended"
_PREVIOUS_FAULT_REASONS = {
    Fault.AGENT_DIED: "the agent's process ended in the middle of the print",
    Fault.ESTOP: "a person stopped it by `farm estop`",
}


class Session:
    """One print, or the shutdown of a print that a dead agent left open.

    Parameters
    ----------
    context
        The session's initial state. The caller passes bytes between the port and the link of this context,
        and calls `Link.tick`.
    """

    def __init__(self, context: SessionContext) -> None:
        self.context = context
        self._script = _run(context)
        self._wait = next(self._script)

    @property
    def deadline_s(self) -> float:
        """Time of the next call of `advance` without events."""
        if self.context.has_ended:
            return math.inf
        return min(
            self._wait.deadline_s, self._find_print_deadline_s(), compute_power_off_due_s(self.context)
        )

    def advance(self, events: Events, now_s: float) -> None:
        """Process the events of the link, and run the script as far as possible."""
        context = self.context
        context.now_s = now_s
        print_end: PrintEnded | None = None
        for event in events:
            print_end = print_end or _process_event(context, event)
        if now_s >= self._find_print_deadline_s():
            print_end = print_end or PrintEnded(Fault.HOURS_ENDED, UNATTENDED_REASON)
        if print_end is not None:
            self._end_print(print_end)
        if now_s >= compute_power_off_due_s(context):
            context.request_power_off()
        while not context.has_ended:
            if self._wait.condition():
                self._run_step(lambda: self._script.send(True))
            elif now_s >= self._wait.deadline_s:
                self._run_step(lambda: self._script.send(False))
            else:
                return

    def on_port_reset(self) -> None:
        """Clear `wants_reset`, as the caller has reset the port."""
        self.context.wants_reset = False

    def pause(self, now_s: float) -> None:
        """Request a pause at the next position to which the head can return; no effect unless printing."""
        self.context.is_pause_requested = self.context.phase in (PrintPhase.PRINTING, PrintPhase.PAUSED)
        self.advance((), now_s)

    def resume(self, now_s: float) -> None:
        """Continue after a `pause`."""
        self.context.is_pause_requested = False
        self.advance((), now_s)

    def set_ends_by(self, at_s: float | None, now_s: float) -> None:
        """Set the time at which the print is ended safely; None for no limit."""
        self.context.ends_by_s = at_s
        self.advance((), now_s)

    def cancel(self, reason: str, now_s: float) -> None:
        """End the print safely; no effect if it is ending already."""
        self.context.now_s = now_s
        if self.context.phase is not PrintPhase.ENDING and not self.context.has_ended:
            self._end_print(PrintEnded(None, reason))
            self.advance((), now_s)

    def fail(self, fault: Fault, reason: str, now_s: float) -> None:
        """End the print because of a fault that the caller found, such as a lost port."""
        self.context.now_s = now_s
        if not self.context.has_ended:
            self._end_print(PrintEnded(fault, reason))
            self.advance((), now_s)

    def add_reason(self, text: str) -> None:
        """Append a clause to the reason, unless the reason contains it already."""
        reason = self.context.reason
        if text not in (reason or ""):
            self.context.reason = text if reason is None else f"{reason}; {text}"

    def _find_print_deadline_s(self) -> float:
        """Return the time at which an open print is ended safely; infinite without a limit."""
        context = self.context
        is_printing = context.phase is not PrintPhase.ENDING and not context.has_ended
        return context.ends_by_s if is_printing and context.ends_by_s is not None else math.inf

    def _run_step(self, step: Callable[[], Wait]) -> None:
        context = self.context
        try:
            self._wait = step()
        except StopIteration:
            context.ended_s = context.now_s if context.targets_off_s is None else context.targets_off_s
            context.wants_reset = False
            context.link.poll_interval_s = context.pace.idle_interval_s
            context.link.poll(context.now_s)

    def _end_print(self, print_end: PrintEnded) -> None:
        self._run_step(lambda: self._script.throw(print_end))


def _run(context: SessionContext) -> Script:
    """Run the whole session."""
    outcome = PrintPhase.DONE
    try:
        if context.program is None:
            raise PrintEnded(context.previous_fault, _PREVIOUS_FAULT_REASONS[context.previous_fault])
        yield from identify_printer(context)
        yield from print_program(context, context.program)
    except (PrintEnded, UnreadableFile) as error:
        print_end = error if isinstance(error, PrintEnded) else PrintEnded(Fault.BAD_FILE, str(error))
        context.fault, context.reason = print_end.fault, print_end.reason
        outcome = PrintPhase.CANCELLED if print_end.fault is None else PrintPhase.FAILED
        context.phase = PrintPhase.ENDING
        yield from abort_print(context)
    context.phase = outcome


def _process_event(context: SessionContext, event: Event) -> PrintEnded | None:
    """Process an event of the link; return the end of the print that it causes, or None."""
    if isinstance(event, Report):
        context.report, context.report_s = event, context.now_s
        return watch_heaters(context, event)
    if isinstance(event, BoardConnected):
        context.connection = event
    elif isinstance(event, UnknownLine):
        context.answer += event.text + b"\n"
        context.position_mm = read_position(event.text) or context.position_mm
    elif isinstance(event, LinkFault):
        if event.fault is Fault.MAXTEMP:
            note_suspicion(context, event.text)
        if not context.link.ignore_faults or context.link.phase is LinkPhase.DEAD:
            return PrintEnded(event.fault, event.text)
    return None
