"""Errors of the printer drivers, with a common base."""

from __future__ import annotations

from enum import StrEnum


class DriverError(Exception):
    """Error of a driver; the message says what happened, where, and what to do."""


class PortError(DriverError):
    """A port cannot be opened, is in use, or was disconnected."""


class IdleNotConfirmed(PortError):
    """A port may be opened only after a person has confirmed that its printer is idle."""


class AgentError(DriverError):
    """An agent refused a request, or cannot be reached."""


class AgentTooOld(AgentError):
    """An agent of an older version does not know this request; nothing was sent."""


class TooLate(AgentError):
    """A request to start a print arrived after the latest time at which it may start."""


class JournalError(AgentError):
    """An agent's journal cannot be written."""


class MessageError(DriverError):
    """A message on an agent's socket cannot be read."""


class BadGcode(DriverError):
    """A G-code file must not be printed; the message names the line."""


class UnreadableFile(DriverError):
    """The agent's copy of a print's file can no longer be read."""


class Fault(StrEnum):
    """Reason for which a print failed, named as in the database."""

    STOPPED = "stopped"  # the firmware called Stop(): heaters are off; it answers but does not move
    MAXTEMP = "maxtemp"  # a sensor reads too hot, or is defective
    MINTEMP = "mintemp"  # a sensor reads too cold, or is defective
    KILL = "kill"  # the firmware called kill(), for example because its dead-man timer expired
    REBOOT = "reboot"  # the board restarted during a print
    ENDSTOP = "endstop"  # an endstop was not reached, or stayed pressed
    COLD_EXTRUSION = "cold_extrusion"  # the firmware refused to extrude
    NO_ANSWER = "no_answer"  # the board is silent
    NOISY_LINE = "noisy_line"  # too many lines or their answers were lost
    HEATER_TIMEOUT = "heater_timeout"  # a heater does not reach its target
    THERMAL_RUNAWAY = "thermal_runaway"  # a heater fell below its target
    HEATER_STUCK_ON = "heater_stuck_on"  # a heater exceeds its target, or does not cool when off
    PAUSE_TIMEOUT = "pause_timeout"  # no person resumed the print in time
    HOURS_ENDED = "hours_ended"  # the print was allowed only in attended hours
    TARGET_CHANGED = "target_changed"  # a person or the firmware set a temperature
    WRONG_PRINTER = "wrong_printer"  # not the expected printer
    BAD_FILE = "bad_file"  # not the expected file, or unfit for this printer
    PORT_LOST = "port_lost"  # the cable was unplugged, or the printer switched off
    AGENT_DIED = "agent_died"  # the agent's process ended during the print
    ESTOP = "estop"  # a person stopped the printer by `farm estop`
