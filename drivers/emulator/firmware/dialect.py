"""The record of what tells emulated firmwares apart. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drivers.emulator.firmware.commands import Commands
from drivers.emulator.firmware.machine import Machine
from drivers.emulator.firmware.planner import Limits
from drivers.emulator.firmware.wording import Words
from drivers.printers import Profile


@dataclass(frozen=True, slots=True)
class Dialect:
    """Rules of one firmware's receiver and main loop, its commands and its words.

    Attributes
    ----------
    commands, words
        See there.
    urgent
        Commands by their M number that are carried out as soon as they are read without a line number.
    banner
        What follows ``start`` at every boot, of a printer, its limits and `Faults.levelled`.
    late_banner
        What is said some seconds after it.
    report
        The answer to M105 at a time, with its ok in front.
    buffer_lines
        Lines that are read ahead, the one that is carried out included.
    line_ends
        Characters that end a line.
    comment_goes_on
        A comment swallows the next line, too.
    checksum_needs_number
        A line with a checksum and no line number is refused.
    reads_while_busy
        Lines are read, and may be refused, while a command is carried out.
    acknowledges_read_moves
        The ok of a move is said when it was read; else when it was carried out.
    advanced_ok
        An ok can name its line and the room in both buffers.
    keep_alive
        Said every `Machine.keep_alive_s` while a command is carried out; empty where nothing is.
    inactive_since_s
        Time from which M85 counts.
    halts
        What is broken ends in kill(), and that for good; else moves are refused, and the watchdog resets a
        board that was killed.
    """

    commands: Commands
    words: Words
    urgent: Mapping[int, Callable[[Machine, float], None]]
    banner: Callable[[Profile, Limits, int], bytes]
    late_banner: bytes
    report: Callable[[Machine, float], bytes]
    buffer_lines: int
    line_ends: bytes
    comment_goes_on: bool
    checksum_needs_number: bool
    reads_while_busy: bool
    acknowledges_read_moves: bool
    advanced_ok: bool
    keep_alive: bytes
    inactive_since_s: Callable[[Machine], float]
    halts: bool
