"""Messages that emulated firmwares share, and a record of those in which they differ."""

from __future__ import annotations

from dataclasses import dataclass

OK = b"ok\n"
START = b"start\n"
STOPPED_MESSAGE = (
    b"Printer stopped due to errors. Fix the error and use M999 to restart. "
    b"(Temperature is reset. Set it after restarting)\n"
)
KILLED_MESSAGE = b"Error:Printer halted. kill() called!\n"
COLD_EXTRUSION = b"echo: cold extrusion prevented\n"
LONG_EXTRUSION = b"echo: too long extrusion prevented\n"
WRONG_LINE_NUMBER = b"Line Number is not Last Line Number+1"
WRONG_CHECKSUM = b"checksum mismatch"
NO_CHECKSUM = b"No Checksum with line number"
NO_LINE_NUMBER = b"No Line Number with checksum"


@dataclass(frozen=True, slots=True)
class FaultMessages:
    """Messages of a firmware for faults."""

    nozzle_maxtemp: bytes
    nozzle_mintemp: bytes
    bed_maxtemp: bytes
    dead_heater: bytes
    no_endstop: bytes
    stuck_endstop: bytes


def format_line_error(problem: bytes, last_line: int) -> bytes:
    """Format the message about a refused line, with the number of the last accepted line."""
    return b"Error:%b, Last Line: %d\n" % (problem, last_line)


def format_unknown_command(line: bytes) -> bytes:
    """Format the message about a line without a known command."""
    return b'echo:Unknown command: "%b"\n' % line
