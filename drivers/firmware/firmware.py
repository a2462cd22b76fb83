"""The record that describes one firmware. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.errors import Fault


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of a printer, as its banner tells it.

    Attributes
    ----------
    suffix
        Of the firmware's version: "ex" on an Ultimaker 2 Extended.
    offset
        The home offset (M206): somebody levelled this very bed to a hundredth of a millimetre.
    """

    suffix: str
    offset: str


@dataclass(frozen=True, slots=True)
class Firmware:
    """Facts of a firmware that a session, a link, an emergency stop and a check of G-code depend on.

    Commands have neither number nor newline.

    Attributes
    ----------
    title
        For people.
    baud_rate
        Of its serial port.
    command_bytes
        The longest command that it takes with ``N1234567 `` and ``*255`` around it.
    version
        Pattern of the banner with the group `suffix`; None where the banner does not tell the model.
    home_offset
        Pattern of the settings, which a banner with a version has, too; the whole offset is group 1.
    banner_end
        Stands in the banner's last line; None where the banner is over when nothing more is said.
    identity_query, identity_word
        A question, and what must be in the answer, beside `Profile.machine_word`.
    settings_query, position_query, report_query
        Questions for settings with the home offset, for the place of the head, and for temperatures.
    idle_queries
        Questions for what people do at an idle printer: the place of the head, and the SD card.
    last_line_query, last_line_answer
        A line that is answered with the number of the last one accepted, and does nothing; how the answer
        begins.
    last_line_resends
        The answer has a ``Resend`` and perhaps an ok behind it, and what was sent behind the question is
        lost.
    acknowledges_read_moves
        The ok of a move comes when it was read; else, as that of all commands, when it was carried out.
    ok_details
        Pattern of all that may follow an ``ok``, with the number of its line as group 1; None where nothing
        does.
    keep_alive
        Beginning of a line that is said once a second as long as a command is carried out; None where none
        is.
    troubles
        What stands in a line that tells of a fault; the first that is found counts.
    stop_moves
        Empties the queue of moves: the head stands.
    halt
        Switches everything off until the board is reset; None where there is no such command.
    tells_motion
        The answer to `position_query` counts steps that were made, not those that were planned.
    wait_moves, motors_off, heaters_off, fan_off
        Commands.
    dead_man
        Arms the end of all heat where no command comes for ``%d`` seconds; 0 is off.
    dead_man_observed
        Somebody has seen the firmware end it. Else a real printer prints only while somebody is there.
    set_up
        Commands to a board that has started, before a print.
    as_new
        What makes a board that was not reset as good as one that was.
    waiting_s
        Commands that wait for all moves before them, and the seconds after which they are given up.
    forbidden
        Commands that no file may have, and why.
    """

    title: str
    baud_rate: int
    command_bytes: int
    version: re.Pattern[bytes] | None
    home_offset: re.Pattern[bytes]
    banner_end: bytes | None
    identity_query: bytes
    identity_word: bytes
    settings_query: bytes
    position_query: bytes
    report_query: bytes
    idle_queries: tuple[bytes, ...]
    last_line_query: bytes
    last_line_answer: bytes
    last_line_resends: bool
    acknowledges_read_moves: bool
    ok_details: re.Pattern[bytes] | None
    keep_alive: bytes | None
    troubles: tuple[tuple[bytes, Fault], ...]
    stop_moves: bytes
    halt: bytes | None
    tells_motion: bool
    wait_moves: bytes
    motors_off: bytes
    heaters_off: tuple[bytes, ...]
    fan_off: bytes
    dead_man: bytes
    dead_man_observed: bool
    set_up: tuple[bytes, ...]
    as_new: tuple[bytes, ...]
    waiting_s: Mapping[bytes, float]
    forbidden: Mapping[bytes, str]

    @property
    def abort(self) -> tuple[bytes, ...]:
        """Commands that end motion, heat and fan."""
        return (self.stop_moves, *self.heaters_off, self.fan_off)

    @property
    def abort_unnumbered(self) -> bytes:
        """The same for a board of which nothing is known; the newline ends a line that was cut off."""
        return b"\n" + b"".join(command + b"\n" for command in self.abort)

    def read_identity(self, banner: bytes) -> Identity | None:
        """Read which printer says this; None where it is garbled, or not this firmware's banner."""
        suffix, offset = self.read_suffix(banner), self.read_offset(banner)
        return None if suffix is None or offset is None else Identity(suffix, offset)

    def read_suffix(self, banner: bytes) -> str | None:
        """Read how the version in a banner ends; None where there is none to read."""
        found = None if self.version is None else self.version.search(banner)
        return None if found is None else (found["suffix"] or b"").decode()

    def read_offset(self, settings: bytes) -> str | None:
        """Read the home offset out of settings; None where there is none to read."""
        found = self.home_offset.search(settings)
        return None if found is None else found[1].decode()
