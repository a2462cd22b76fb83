"""Alarms about heaters that cannot be switched off. Each alarm cuts the mains once."""

from __future__ import annotations

import logging
import math

from drivers.clock import read_wall_s
from drivers.records import Alarm, Suspicion
from drivers.safety import NO_COMMAND_OUTCOME, POLL_INTERVAL_S, PowerOffRun
from drivers.session import Session

log = logging.getLogger(__name__)

_UNCONFIRMED_TEXT = "heaters were not confirmed off"


class Alarms:
    """Alarms of one printer. Each alarm runs the printer's `power_off_cmd` once.

    The caller records the finding, writes the journal, and then calls `run_command`. Unless the disk fails,
    no command is run before its request is in the journal.

    Parameters
    ----------
    printer
        The printer's name in the fleet.
    command
        The printer's `power_off_cmd`; None if it has none.
    alarm
        The alarm in the journal.

    Attributes
    ----------
    alarm
        The last finding, until a person has checked the printer.
    """

    def __init__(self, printer: str, command: str | None, alarm: Alarm | None) -> None:
        self._printer, self._command = printer, command
        self.alarm = alarm
        self._power_off_run: PowerOffRun | None = None
        self._requesting_session: Session | None = None  # the session that asked for the mains to be cut

    @property
    def is_pending(self) -> bool:
        """True while the mains are to be cut; see `Alarm.is_pending`."""
        return self.alarm is not None and self.alarm.is_pending

    @property
    def message(self) -> str | None:
        """User-facing sentence; None without an alarm."""
        return None if self.alarm is None else self.alarm.message

    @property
    def suspicion(self) -> Suspicion | None:
        """Suspicion to be handed to the first session after an agent died."""
        return None if self.alarm is None else self.alarm.suspicion

    def mark_over(self) -> None:
        """Mark the alarm as over, because the printer was cold or reconnected: later findings are new."""
        if self.alarm is not None and self.alarm.outcome is not None:
            self.alarm = self.alarm.model_copy(update={"is_over": True})

    def clear(self) -> None:
        """Remove the alarm, as a person has checked the printer."""
        self.alarm = None

    def take_session_finding(self, session: Session, now_s: float) -> None:
        """Take over the finding of a session, and add it to the reason of its print."""
        suspicion, alarm = session.context.suspicion, self.alarm
        if session.context.wants_power_off:
            if session is not self._requesting_session:
                self._requesting_session = session
                self._request_power_off(suspicion.text if suspicion is not None else _UNCONFIRMED_TEXT, now_s)
                assert self.alarm is not None
                session.add_reason(self.alarm.text)
        elif suspicion is not None:
            if alarm is None or not alarm.is_suspicion:
                self.alarm = Alarm(text=suspicion.text, at_s=suspicion.found_s)
        elif alarm is not None and alarm.is_suspicion:
            self.alarm = None  # the heater has cooled down

    def take_idle_finding(self, finding: str | None, now_s: float) -> str | None:
        """Take over a finding of the idle board; return it if it is new."""
        if finding is None and self.alarm is not None and self.alarm.is_suspicion:
            finding = self.alarm.text  # the session that watched it has ended
        return finding if finding is not None and self._request_power_off(finding, now_s) else None

    def _request_power_off(self, text: str, now_s: float) -> bool:
        """Request that the mains are cut; return False if that was requested already."""
        alarm = self.alarm
        if alarm is not None and alarm.power_off_requested and not alarm.is_over:
            return False
        if alarm is None or not alarm.is_suspicion:
            alarm = Alarm(text=text, at_s=now_s)
        log.error("%s: %s: its mains have to be cut", self._printer, alarm.text)
        self.alarm = alarm.model_copy(update={"power_off_requested": True})
        return True

    def poll_outcome(self) -> str | None:
        """Return the outcome of the command once; None if there is no new one."""
        outcome = None if self._power_off_run is None else self._power_off_run.poll_outcome()
        if outcome is not None:
            self._power_off_run = None
        elif self._command is None and self.is_pending:
            outcome = NO_COMMAND_OUTCOME
        if outcome is not None and self.alarm is not None:
            self.alarm = self.alarm.model_copy(update={"outcome": outcome})
        return outcome

    def run_command(self) -> None:
        """Run the command if it was requested; the request must be in the journal already."""
        if self._power_off_run is None and self._command is not None and self.is_pending:
            self._power_off_run = PowerOffRun(self._command, self._printer)

    def compute_wake_wall_s(self) -> float:
        """Compute the wall time of the next call of `poll_outcome`."""
        return math.inf if self._power_off_run is None else read_wall_s() + POLL_INTERVAL_S
