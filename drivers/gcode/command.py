"""One command of a G-code file, read as the firmware reads it, and written in one form. Pure.

The firmware searches a line for its letters wherever they stand, takes the first of two, and a letter without
a number for 0; it ends a line at ``:``, takes any ``N`` for a line number and any ``*`` for a checksum, and
cuts lines after 94 characters (docs/explanation/ultimaker2-serial.md, section 1.5). So what reaches it
has one form: ``G1 F1500 X1 E2``, each letter once, plain decimal numbers. What cannot be written so is
refused with the number of its line.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from drivers.errors import BadGcode

COMMAND_BYTES = 80
"""What is left of the firmware's 94 for a command once ``N1234567 `` and ``*255`` are around it."""
MOST = 1e6
"""No length, speed or temperature is so large; what is computed from it still fits a line."""

# Nearly every line of a file goes through it, and an empty branch is faster than "?". No possessive
# quantifier: before Python 3.11.5 they match wrongly.
_NUMBER = rb"-?\d{1,6}(?:\.\d*|)"
_EVERYDAY = re.compile(rb"G[01](?: F%b|)(?: X%b|)(?: Y%b|)(?: E%b|)\Z" % ((_NUMBER,) * 4))
_CODE = re.compile(rb"([GMT]) *0*(\d{1,6})(?!\d)")
_WORD = re.compile(rb" *([A-Z])(?: *(-?(?:\d+(?:\.\d*)?|\.\d+)))?")
_MOVES = frozenset((b"G0", b"G1", b"G2", b"G3", b"G92"))
_NEEDLESS = frozenset((b"M105", b"M117", b"M118"))  # the link asks; a text is read as commands
_CARD = "belongs to the SD card"
_NEVER = {
    b"M0": "waits for the knob for ever",
    b"M1": "waits for the knob for ever",
    b"M112": "does not exist in this firmware",
    b"M303": "heats as it likes",
    b"M600": "does not exist in this firmware",
    b"M999": "restarts a board that stopped for a reason",
    b"M85": "is the farm's dead-man",
    b"M110": "is the link's line number",
    b"G10": "retracts by the printer's own settings, not by the file's",
    b"G11": "retracts by the printer's own settings, not by the file's",
    **{b"M%d" % number: _CARD for number in (*range(20, 31), 32, 923, 928)},
}

is_everyday = _EVERYDAY.match
"""Whether a line is a move of nearly every kind, in the one form: nothing can be wrong with it."""


@dataclass(frozen=True, slots=True)
class Command:
    """What is sent, and what it says.

    Attributes
    ----------
    text
        In the one form, without a newline.
    name
        ``G1``, without leading zeros.
    words
        The letters behind it; None where no number follows.
    """

    text: bytes
    name: bytes
    words: dict[bytes, float | None]


def read(line: bytes, number: int) -> Command | None:
    """Read a line without its comment; None where a print does not need it.

    Parameters
    ----------
    line
        Stripped of blanks around it, and not empty.
    number
        Of the line in its file, for the message.

    Raises
    ------
    BadGcode
        The firmware would take it for something else, or it must not be sent.
    """
    code = _CODE.match(line)
    name = code[1] + code[2] if code is not None else b""
    if name in _NEEDLESS:
        return None
    if len(line) > COMMAND_BYTES:
        raise too_long(line, number)
    if not (line.isascii() and line.decode("ascii").isprintable()):
        raise BadGcode(f"line {number}: not plain text: is this a G-code file?")
    for letter in b":N*":
        if letter in line:
            raise BadGcode(
                f"line {number}: the printer misreads a {chr(letter)!r}: take it out of {shown(line)}"
            )
    if code is None:
        raise BadGcode(f"line {number}: no command that the printer knows: {shown(line)}")
    if (why := _NEVER.get(name)) is not None:
        raise BadGcode(f"line {number}: {name.decode()} {why}: take it out")
    tail = line[code.end() :]
    pairs = _WORD.findall(tail)
    words = {letter: value(digits, number) if digits else None for letter, digits in pairs}
    if _WORD.sub(b"", tail).strip() or len(words) < len(pairs) or words.keys() & {b"G", b"M"}:
        raise BadGcode(f"line {number}: cannot be read: {shown(line)}; write it like G1 F1500 X1.5 E2")
    if name in _MOVES and None in words.values():
        raise BadGcode(f"line {number}: a letter without a number in {shown(line)}")
    text = b" ".join((name, *(letter + digits for letter, digits in pairs)))
    if len(text) > COMMAND_BYTES:
        raise too_long(text, number)
    return Command(text, name, words)


def value(text: bytes, number: int, most: float = MOST) -> float:
    """A number of line `number`. Raises BadGcode where it is none, or no smaller than `most`."""
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not abs(found) < most:
        raise BadGcode(f"line {number}: {shown(text)} is no number that can be meant")
    return found


def too_long(line: bytes, number: int) -> BadGcode:
    """The refusal of a line that does not fit."""
    return BadGcode(
        f"line {number}: {len(line)} characters, and the printer takes {COMMAND_BYTES}: shorten it"
    )


def shown(text: bytes) -> str:
    """The beginning of a line, for a message."""
    return repr(text[:40].decode("ascii", "replace"))
