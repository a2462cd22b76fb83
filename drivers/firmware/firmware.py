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
    version, home_offset
        Patterns of the banner; `version` has the group `suffix`, `home_offset` the whole offset as group 1.
    banner_end
        Stands in the banner's last line.
    identity_query, identity_word
        A question, and what must be in the answer.
    settings_query, position_query, report_query
        Questions for settings with the home offset, for the place of the head, and for temperatures.
    last_line_query
        A line that is answered with the number of the last one accepted, and does nothing.
    troubles
        What stands in a line that tells of a fault; the first that is found counts.
    stop_moves
        Empties the queue of moves: the head stands.
    wait_moves, motors_off, heaters_off, fan_off
        Commands.
    dead_man
        Arms the end of all heat where no command comes for ``%d`` seconds; 0 is off.
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
    version: re.Pattern[bytes]
    home_offset: re.Pattern[bytes]
    banner_end: bytes
    identity_query: bytes
    identity_word: bytes
    settings_query: bytes
    position_query: bytes
    report_query: bytes
    last_line_query: bytes
    troubles: tuple[tuple[bytes, Fault], ...]
    stop_moves: bytes
    wait_moves: bytes
    motors_off: bytes
    heaters_off: tuple[bytes, ...]
    fan_off: bytes
    dead_man: bytes
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
        version, offset = self.version.search(banner), self.read_offset(banner)
        if version is None or offset is None:
            return None
        return Identity((version["suffix"] or b"").decode(), offset)

    def read_offset(self, settings: bytes) -> str | None:
        """Read the home offset out of settings; None where there is none to read."""
        found = self.home_offset.search(settings)
        return None if found is None else found[1].decode()
