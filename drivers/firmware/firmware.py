"""The record that describes one firmware. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.errors import Fault


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of a printer, read from its banner.

    Attributes
    ----------
    suffix
        Suffix of the firmware's version: "ex" on an Ultimaker 2 Extended.
    offset
        Home offset (M206), which levelling sets with a precision of 0.01 mm: it differs from printer to
        printer.
    """

    suffix: str
    offset: str


@dataclass(frozen=True, slots=True)
class Firmware:
    """Properties of a firmware on which link, session, emergency stop and G-code check depend.

    Commands have no line number and no newline.

    Attributes
    ----------
    title
        Name in messages.
    baud_rate
        Baud rate of the printer's serial port.
    max_command_bytes
        Length of the longest command that the firmware accepts between ``N1234567 `` and ``*255``.
    version_pattern
        Pattern of the banner with the group `suffix`; None if the banner does not name the model.
    home_offset_pattern
        Pattern of the offset in the settings; group 1 is the offset. A banner with a version contains the
        settings.
    banner_end
        Text in the banner's last line; None if only silence marks the end of the banner.
    identity_query, identity_text
        A query, and a text that its answer must contain besides `Profile.machine_text`.
    settings_query, position_query, report_query
        Queries for the settings with the home offset, for the position of the head, and for temperatures.
    idle_queries
        Queries that reveal what people do at an idle printer: the position of the head, and the SD card.
    last_line_query, last_line_answer
        A line without effect, which the firmware answers with the number of the last accepted line; the
        beginning of that answer.
    last_line_query_causes_resend
        True if a ``Resend`` and possibly an ok follow the answer; lines sent after the query are lost then.
    acknowledges_read_moves
        True if moves are acknowledged when they are read, not after execution as all other commands are.
    ok_details
        Pattern of the text that may follow an ``ok``; group 1 is the line number. None if nothing follows.
    busy_prefix
        Beginning of the line that is sent once a second during a long command; None if there is none.
    fault_texts
        Texts that mark a line as a fault; the first match counts.
    stop_command
        Command that empties the queue of moves and thus stops the head.
    halt_command
        Command that switches everything off until the board is reset; None if there is no such command.
    reports_executed_steps
        True if the answer to `position_query` counts executed steps, not planned ones.
    wait_command, motors_off_command, heaters_off_commands, fan_off_command
        Commands that wait for the end of all moves, and that switch motors, heaters and fan off.
    dead_man_command
        Command that arms the dead-man timer: heaters go off after ``%d`` seconds without a command; 0 disarms
        it.
    is_dead_man_observed
        True if the timer was observed on a real printer. Otherwise a real printer prints only while attended.
    setup_commands
        Commands sent before a print to a board that has restarted.
    reset_commands
        Commands that restore the defaults of a board that was not reset.
    wait_timeouts_s
        Commands that wait for all earlier moves, with their timeouts in seconds.
    forbidden_commands
        Commands that no file may contain, with the reason.
    """

    title: str
    baud_rate: int
    max_command_bytes: int
    version_pattern: re.Pattern[bytes] | None
    home_offset_pattern: re.Pattern[bytes]
    banner_end: bytes | None
    identity_query: bytes
    identity_text: bytes
    settings_query: bytes
    position_query: bytes
    report_query: bytes
    idle_queries: tuple[bytes, ...]
    last_line_query: bytes
    last_line_answer: bytes
    last_line_query_causes_resend: bool
    acknowledges_read_moves: bool
    ok_details: re.Pattern[bytes] | None
    busy_prefix: bytes | None
    fault_texts: tuple[tuple[bytes, Fault], ...]
    stop_command: bytes
    halt_command: bytes | None
    reports_executed_steps: bool
    wait_command: bytes
    motors_off_command: bytes
    heaters_off_commands: tuple[bytes, ...]
    fan_off_command: bytes
    dead_man_command: bytes
    is_dead_man_observed: bool
    setup_commands: tuple[bytes, ...]
    reset_commands: tuple[bytes, ...]
    wait_timeouts_s: Mapping[bytes, float]
    forbidden_commands: Mapping[bytes, str]

    @property
    def abort_commands(self) -> tuple[bytes, ...]:
        """Commands that stop motion, heaters and fan."""
        return (self.stop_command, *self.heaters_off_commands, self.fan_off_command)

    @property
    def unnumbered_abort(self) -> bytes:
        """Bytes that abort a print in any state of the board; the newline ends a line that was cut off."""
        return b"\n" + b"".join(command + b"\n" for command in self.abort_commands)

    def read_identity(self, banner: bytes) -> Identity | None:
        """Parse the identity in a banner; None if it is garbled, or not this firmware's banner."""
        suffix, offset = self.read_suffix(banner), self.read_offset(banner)
        return None if suffix is None or offset is None else Identity(suffix, offset)

    def read_suffix(self, banner: bytes) -> str | None:
        """Parse the suffix of the version in a banner; None if there is none."""
        match = None if self.version_pattern is None else self.version_pattern.search(banner)
        return None if match is None else (match["suffix"] or b"").decode()

    def read_offset(self, settings: bytes) -> str | None:
        """Parse the home offset in the settings; None if there is none."""
        match = self.home_offset_pattern.search(settings)
        return None if match is None else match[1].decode()
