"""Errors of the printer drivers, one root for the package."""

from __future__ import annotations

from enum import StrEnum


class DriverError(Exception):
    """Anything that a driver reports; the message says what, where, and what to do."""


class PortError(DriverError):
    """A port cannot be opened, is taken, or went away."""


class PortNotIdle(PortError):
    """A port that nobody has said may be opened."""


class AgentError(DriverError):
    """An agent refused a request or cannot be reached."""


class AgentTooOld(AgentError):
    """An agent of an older version does not know this request, and was not asked."""


class TooLate(AgentError):
    """A print was told to begin after the moment until which it might."""


class JournalError(AgentError):
    """The disk does not take what an agent must remember."""


class MessageError(DriverError):
    """A message on an agent's socket that is not one of ours."""


class BadGcode(DriverError):
    """A G-code file that must not go to a printer; the message names its line."""


class Unreadable(DriverError):
    """A print's own copy of its file is not to be had any more."""


class Fault(StrEnum):
    """Reason for which a print failed, by the name that a daemon keeps in its books."""

    STOPPED = "stopped"  # the firmware's Stop(): heaters off, it answers and moves nothing
    MAXTEMP = "maxtemp"  # a sensor reads too hot, or is broken
    MINTEMP = "mintemp"  # a sensor reads too cold, or is short
    KILL = "kill"  # the firmware's kill(): its dead-man ran out
    REBOOT = "reboot"  # the board started again in the middle of a print
    ENDSTOP = "endstop"  # a switch was not found, or did not let go
    COLD_EXTRUSION = "cold_extrusion"  # the firmware refused to extrude
    NO_ANSWER = "no_answer"  # the board is silent
    NOISY_LINE = "noisy_line"  # too many lines had to be sent again
    HEATER_TIMEOUT = "heater_timeout"  # does not get warm
    THERMAL_RUNAWAY = "thermal_runaway"  # was warm, and fell away from its target
    HEATER_STUCK_ON = "heater_stuck_on"  # gets hotter than it was set, or does not cool when off
    PAUSE_TIMEOUT = "pause_timeout"  # nobody resumed it in time
    HOURS_ENDED = "hours_ended"  # it prints only while somebody is there, and nobody was to be any more
    TARGET_CHANGED = "target_changed"  # somebody or something else set a temperature
    WRONG_PRINTER = "wrong_printer"  # not the model that was asked for
    BAD_FILE = "bad_file"  # not the file that was meant, or not fit for this printer
    PORT_LOST = "port_lost"  # unplugged, or its power is off
    AGENT_DIED = "agent_died"  # the agent's process ended in the middle of the print
    ESTOP = "estop"  # a person stopped it by `farm estop`
