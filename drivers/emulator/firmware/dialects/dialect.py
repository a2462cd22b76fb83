"""Differences between emulated firmwares. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.emulator.firmware.commands import Commands
from drivers.emulator.firmware.machine import Machine
from drivers.emulator.firmware.planner import Limits
from drivers.emulator.firmware.wording import FaultMessages
from drivers.printers import Profile


@dataclass(frozen=True, slots=True)
class Dialect:
    """Behaviour of one firmware: receiver, main loop, commands and messages.

    Attributes
    ----------
    commands, fault_messages
        See `Commands` and `FaultMessages`.
    urgent_commands
        Commands, by M number, that are executed as soon as they are read without a line number.
    format_banner
        Function that makes the text after ``start`` from the printer, its limits and
        `Faults.home_offset_hundredths_mm`.
    late_banner
        Text sent a few seconds after the banner.
    format_report
        Function that makes the answer to M105, which begins with its ok.
    buffer_lines
        Number of lines read ahead, including the one being executed.
    line_ends
        Characters that end a line.
    comment_spans_lines
        True if the line after a comment is dropped too.
    checksum_needs_number
        True if a line with a checksum and no line number is refused.
    reads_while_busy
        True if lines are read, and may be refused, while a command is executed.
    acknowledges_read_moves
        True if a move is acknowledged when it is read, not after execution.
    advanced_ok
        True if an ok can contain the line number and the free space of both buffers.
    busy_message
        Message sent every `Machine.keep_alive_interval_s` while a command is executed; empty if none is.
    find_inactivity_start_s
        Function that returns the time from which M85 counts.
    halts
        True if a fault calls kill(), which halts the board until a reset. Otherwise moves are refused, and
        the watchdog resets a killed board.
    """

    commands: Commands
    fault_messages: FaultMessages
    urgent_commands: Mapping[int, Callable[[Machine, float], None]]
    format_banner: Callable[[Profile, Limits, int], bytes]
    late_banner: bytes
    format_report: Callable[[Machine, float], bytes]
    buffer_lines: int
    line_ends: bytes
    comment_spans_lines: bool
    checksum_needs_number: bool
    reads_while_busy: bool
    acknowledges_read_moves: bool
    advanced_ok: bool
    busy_message: bytes
    find_inactivity_start_s: Callable[[Machine], float]
    halts: bool
