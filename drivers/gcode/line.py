"""Parser of G-code lines: it reads them as the firmware does, and rewrites them in canonical form. Pure.

The firmware finds a letter anywhere in a line, uses the first of two equal letters, and reads a letter
without a number as 0. It ends a line at ``:``, reads any ``N`` as a line number and any ``*`` as a checksum,
and cuts lines after 94 characters (docs/explanation/ultimaker2-serial.md, section 1.5). So every line is sent
in canonical form, such as ``G1 F1500 X1 E2``: each letter once, and plain decimal numbers. A line without
such a form is refused, and the message names its number.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from drivers.errors import BadGcode
from drivers.firmware import Firmware

MAX_NUMBER = 1e6
"""Upper bound of lengths, speeds and temperatures: commands computed from them must fit into a line."""

# Nearly every line of a file is matched, and an empty branch is faster than "?". Possessive quantifiers are
# not used, as they match wrongly before Python 3.11.5.
_NUMBER = rb"-?\d{1,6}(?:\.\d*|)"
_PLAIN_MOVE = re.compile(rb"G[01](?: F%b|)(?: X%b|)(?: Y%b|)(?: E%b|)\Z" % ((_NUMBER,) * 4))
_CODE = re.compile(rb"([GMT]) *0*(\d{1,6})(?!\d)")
_WORD = re.compile(rb" *([A-Z])(?: *(-?(?:\d+(?:\.\d*)?|\.\d+)))?")
_MOVE_CODES = frozenset((b"G0", b"G1", b"G2", b"G3", b"G92"))
_OMITTED_CODES = frozenset(
    (b"M105", b"M117", b"M118")
)  # the link polls at its own intervals; the firmware may read display texts as commands

match_plain_move = _PLAIN_MOVE.match
"""Match a move that is in canonical form already and needs no further check."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command of a file.

    Attributes
    ----------
    text
        The command in canonical form, without a newline.
    name
        Code such as ``G1``, without leading zeros.
    words
        The number after each letter; None if there is none.
    """

    text: bytes
    name: bytes
    words: dict[bytes, float | None]


def read_command(line: bytes, number: int, firmware: Firmware) -> Command | None:
    """Parse a line whose comment was removed.

    Parameters
    ----------
    line
        Not empty, without surrounding blanks.
    number
        Line number in the file, for the message.
    firmware
        The printer's firmware.

    Returns
    -------
    Command or None
        None if a print does not need the command.

    Raises
    ------
    BadGcode
        The firmware would misread the line, or the command is forbidden.
    """
    code = _CODE.match(line)
    name = code[1] + code[2] if code is not None else b""
    if name in _OMITTED_CODES:
        return None
    if len(line) > firmware.max_command_bytes:
        raise make_length_error(line, number, firmware.max_command_bytes)
    if not (line.isascii() and line.decode("ascii").isprintable()):
        raise BadGcode(f"line {number}: not plain text: is this a G-code file?")
    for letter in b":N*":
        if letter in line:
            raise BadGcode(
                f"line {number}: the printer misreads a {chr(letter)!r}: remove it from {quote(line)}"
            )
    if code is None:
        raise BadGcode(f"line {number}: not a command of the printer: {quote(line)}")
    if (reason := firmware.forbidden_commands.get(name)) is not None:
        raise BadGcode(f"line {number}: {name.decode()} {reason}: remove it")
    tail = line[code.end() :]
    pairs = _WORD.findall(tail)
    words = {letter: read_number(digits, number) if digits else None for letter, digits in pairs}
    if _WORD.sub(b"", tail).strip() or len(words) < len(pairs) or words.keys() & {b"G", b"M"}:
        raise BadGcode(f"line {number}: cannot be read: {quote(line)}; write it like G1 F1500 X1.5 E2")
    if name in _MOVE_CODES and None in words.values():
        raise BadGcode(f"line {number}: a letter without a number in {quote(line)}")
    text = b" ".join((name, *(letter + digits for letter, digits in pairs)))
    if len(text) > firmware.max_command_bytes:
        raise make_length_error(text, number, firmware.max_command_bytes)
    return Command(text, name, words)


def read_number(text: bytes, line_number: int, limit: float = MAX_NUMBER) -> float:
    """Parse a number in a line.

    Parameters
    ----------
    text
        The digits, with sign and decimal point if there are any.
    line_number
        Line number in the file, for the message.
    limit
        Upper bound of the absolute value, excluded.

    Raises
    ------
    BadGcode
        It is not a number, or its absolute value reaches `limit`.
    """
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) < limit:
        raise BadGcode(f"line {line_number}: {quote(text)} is not a number, or too large")
    return number


def make_length_error(line: bytes, number: int, limit_bytes: int) -> BadGcode:
    """Make the error for a line that the firmware would cut."""
    return BadGcode(f"line {number}: {len(line)} characters, and the printer takes {limit_bytes}: shorten it")


def quote(text: bytes) -> str:
    """Quote the beginning of a line for a message."""
    return repr(text[:40].decode("ascii", "replace"))
