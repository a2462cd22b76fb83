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
from drivers.firmware import Firmware

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

is_everyday = _EVERYDAY.match
"""Whether a line is a move of nearly every kind, in the one form: nothing can be wrong with it."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command as it is sent, and as it is read.

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


def read(line: bytes, number: int, firmware: Firmware) -> Command | None:
    """Read a line without its comment; None where a print does not need it.

    Parameters
    ----------
    line
        Stripped of blanks around it, and not empty.
    number
        Of the line in its file, for the message.
    firmware
        Of the printer.

    Raises
    ------
    BadGcode
        The firmware would take it for something else, or it must not be sent.
    """
    code = _CODE.match(line)
    name = code[1] + code[2] if code is not None else b""
    if name in _NEEDLESS:
        return None
    if len(line) > firmware.command_bytes:
        raise too_long(line, number, firmware.command_bytes)
    if not (line.isascii() and line.decode("ascii").isprintable()):
        raise BadGcode(f"line {number}: not plain text: is this a G-code file?")
    for letter in b":N*":
        if letter in line:
            raise BadGcode(
                f"line {number}: the printer misreads a {chr(letter)!r}: take it out of {shown(line)}"
            )
    if code is None:
        raise BadGcode(f"line {number}: no command that the printer knows: {shown(line)}")
    if (why := firmware.forbidden.get(name)) is not None:
        raise BadGcode(f"line {number}: {name.decode()} {why}: take it out")
    tail = line[code.end() :]
    pairs = _WORD.findall(tail)
    words = {letter: value(digits, number) if digits else None for letter, digits in pairs}
    if _WORD.sub(b"", tail).strip() or len(words) < len(pairs) or words.keys() & {b"G", b"M"}:
        raise BadGcode(f"line {number}: cannot be read: {shown(line)}; write it like G1 F1500 X1.5 E2")
    if name in _MOVES and None in words.values():
        raise BadGcode(f"line {number}: a letter without a number in {shown(line)}")
    text = b" ".join((name, *(letter + digits for letter, digits in pairs)))
    if len(text) > firmware.command_bytes:
        raise too_long(text, number, firmware.command_bytes)
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


def too_long(line: bytes, number: int, most: int) -> BadGcode:
    """The refusal of a line that does not fit."""
    return BadGcode(f"line {number}: {len(line)} characters, and the printer takes {most}: shorten it")


def shown(text: bytes) -> str:
    """The beginning of a line, for a message."""
    return repr(text[:40].decode("ascii", "replace"))
