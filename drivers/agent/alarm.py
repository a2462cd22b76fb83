"""A heater that cannot be switched off: what was found of it, and the mains that are cut for it, once."""

from __future__ import annotations

import logging
import math

from drivers.clock import wall_s
from drivers.records import Alarm, Suspicion
from drivers.safety import NO_COMMAND, POLL_S, PowerOff
from drivers.session import Session

log = logging.getLogger(__name__)

_NOT_OFF = "heaters were not shown off"


class Alarms:
    """Keeps the alarm of one printer, and runs its `power_off_cmd` once for each.

    The order is `take`, then the journal, then `act`: nothing is run that is not written down, unless the
    disk takes nothing.

    Parameters
    ----------
    printer
        Its name in the fleet.
    command
        Its `power_off_cmd`, if it has one.
    alarm
        What the journal has.

    Attributes
    ----------
    alarm
        The last finding, until a person has seen to the printer.
    """

    def __init__(self, printer: str, command: str | None, alarm: Alarm | None) -> None:
        self._printer, self._command = printer, command
        self.alarm = alarm
        self._run: PowerOff | None = None
        self._answered: Session | None = None  # it has asked

    @property
    def pending(self) -> bool:
        """See `Alarm.pending`."""
        return self.alarm is not None and self.alarm.pending

    @property
    def message(self) -> str | None:
        """For people."""
        return None if self.alarm is None else self.alarm.message

    @property
    def suspicion(self) -> Suspicion | None:
        """The suspicion that the session after a dead agent's has to know."""
        return None if self.alarm is None else self.alarm.suspicion

    def printer_back(self) -> None:
        """The printer was seen cold, or came back: what is found from now on is another finding."""
        if self.alarm is not None and self.alarm.outcome is not None:
            self.alarm = self.alarm.model_copy(update={"over": True})

    def clear(self) -> None:
        """Whatever was the matter is over."""
        self.alarm = None

    def of_session(self, session: Session, now_s: float) -> None:
        """Take what a session found; its reason says it too."""
        found, alarm = session.context.suspicion, self.alarm
        if session.context.wants_power_off:
            if session is not self._answered:
                self._answered = session
                self._ask(found.text if found is not None else _NOT_OFF, now_s)
                assert self.alarm is not None
                session.add_reason(self.alarm.text)
        elif found is not None:
            if alarm is None or not alarm.suspected:
                self.alarm = Alarm(text=found.text, at_s=found.since_s)
        elif alarm is not None and alarm.suspected:
            self.alarm = None  # it was seen to cool

    def of_idle(self, found: str | None, now_s: float) -> str | None:
        """Take what was found without a session; what of it is news."""
        if found is None and self.alarm is not None and self.alarm.suspected:
            found = self.alarm.text  # nobody is left to see it cool
        return found if found is not None and self._ask(found, now_s) else None

    def _ask(self, text: str, now_s: float) -> bool:
        alarm = self.alarm
        if alarm is not None and alarm.power_off_requested and not alarm.over:
            return False
        if alarm is None or not alarm.suspected:
            alarm = Alarm(text=text, at_s=now_s)
        log.error("%s: %s: its mains have to be cut", self._printer, alarm.text)
        self.alarm = alarm.model_copy(update={"power_off_requested": True})
        return True

    def outcome(self) -> str | None:
        """Take the outcome of the command, once; None where nothing is new."""
        said = None if self._run is None else self._run.outcome()
        if said is not None:
            self._run = None
        elif self._command is None and self.pending:
            said = NO_COMMAND
        if said is not None and self.alarm is not None:
            self.alarm = self.alarm.model_copy(update={"outcome": said})
        return said

    def act(self) -> None:
        """Run the command where that is asked for; it is written down."""
        if self._run is None and self._command is not None and self.pending:
            self._run = PowerOff(self._command, self._printer)

    def wake_wall_s(self) -> float:
        """Wall time at which `outcome` wants to be called."""
        return math.inf if self._run is None else wall_s() + POLL_S
