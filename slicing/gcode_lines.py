"""Lexer of G-code lines: code, words and comment, or a refusal with the line's number.

The lexer does not know the meaning of commands. It has two users: `own_gcode` splits every line;
`checks.toolpath` reads plain moves by columns, and only the few other lines one by one.
"""

from __future__ import annotations

import re

from slicing.errors import GcodeRefused

MAX_LINE_BYTES = 1 << 16
"""Maximum length of a line; the longest lines of slicers are comments that contain a whole script."""
MAX_COORDINATE_MM = 1e4
"""Maximum coordinate on any printer."""
MAX_E_MM = 1e8
"""Maximum E; a file may never reset E."""
MAX_OTHER_VALUE = 1e6

_CODE = re.compile(r"([GMT])0*(\d{1,5}(?:\.\d+)?)(?![\d.])")
_NUMBERED_LINE = re.compile(rb"\s*[Nn](\d+)\s*(.*)\Z", re.DOTALL)
_TEXT_COMMAND = re.compile(rb"\s*[Mm](11[78])\s")
"""Commands whose text, for a display or a host, may be in any language."""
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_PARENTHESES = re.compile(r"\([^()]*\)")
_WORD = re.compile(r"\s*([A-Z])\s?([-+]?(?:\d+\.?\d*|\.\d+))")
_AMBIGUOUS_E = re.compile(r"[\d.]E")

PLAIN_MOVE = rb"G[01](?: [FXYZE]-?\d+(?:\.\d*|))+\r?"
"""A straight move in the form that slicers nearly always write. An empty branch is faster than ``?``."""
_PLAIN_MOVE = re.compile(rb"G[01](?: [FXYZE]-?\d{1,4}(?:\.\d{1,9})?)+\r?\n?\Z")

Words = dict[str, float]
Line = tuple[str, str, bytes]
"""Code like ``G1`` (empty if there is none), the rest of the command, and the comment."""


def split_line(raw_line: bytes, number: int) -> Line:
    """Split a line into code, words and comment. Line numbers and checksums are checked and removed.

    Parameters
    ----------
    raw_line
        The line as it is in the file.
    number
        Its number in the file, for messages.

    Raises
    ------
    GcodeRefused
        If the line is not G-code, or is damaged.
    """
    if len(raw_line) >= MAX_LINE_BYTES:
        raise GcodeRefused(
            f"line {number} is longer than {MAX_LINE_BYTES} characters: is this a G-code file?"
        )
    command, _, comment = raw_line.removeprefix(_BYTE_ORDER_MARK).partition(b";")
    if b"\0" in raw_line:
        raise GcodeRefused(f"line {number}: not plain text: is this a G-code file?")
    if not command or command.isspace():
        return "", "", comment.strip()
    if command.lstrip()[:1] in (b"N", b"n"):
        command = _strip_number(command, number)
    if (text_command := _TEXT_COMMAND.match(command)) is not None:
        return f"M{text_command[1].decode()}", "", comment.strip()
    try:
        text = command.decode("ascii").strip().replace("\t", " ").upper()
    except UnicodeDecodeError:
        text = ""
    if not text.isprintable() or not (text or command.isspace()):
        raise GcodeRefused(f"line {number}: not plain text: is this a G-code file?")
    if "(" in text:
        text = _PARENTHESES.sub(" ", text).strip()
    if not text:
        return "", "", comment.strip()
    code = _CODE.match(text)
    if code is None:
        raise GcodeRefused(
            f"line {number}: {quote_text(text)} is not a command that this printer knows: remove it"
        )
    return code[1] + code[2], text[code.end() :], comment.strip()


def parse_plain_move(raw_line: bytes) -> Words | None:
    """Read a straight move in the form that slicers nearly always write; None for any other line."""
    if _PLAIN_MOVE.match(raw_line) is None:
        return None
    parts = raw_line.decode("ascii").split()
    words: Words = {part[0]: float(part[1:]) for part in parts[1:]}
    return words if len(words) == len(parts) - 1 else None


def parse_words(rest: str, number: int) -> Words:
    """Parse the words after a code into a dictionary of numbers by letter.

    Parameters
    ----------
    rest
        The line without its code and comment, in upper case.
    number
        Its number in the file, for messages.

    Raises
    ------
    GcodeRefused
        If the firmware would read the line differently, or a number is out of any printer's range.
    """
    words: Words = {}
    offset = 0
    if _AMBIGUOUS_E.search(rest):  # the firmware reads X1E5 as a power of ten
        raise GcodeRefused(f"line {number}: write a space before each E: {quote_text(rest)} is not clear")
    while offset < len(rest) and (word := _WORD.match(rest, offset)) is not None:
        letter, digits = word.groups()
        if letter in words:
            raise GcodeRefused(f"line {number}: {letter} appears twice in {quote_text(rest)}: remove one")
        value = float(digits)
        if abs(value) > _find_max_value(letter):
            raise GcodeRefused(
                f"line {number}: {letter}{digits} is out of any printer's range: is the file damaged?"
            )
        words[letter] = value
        offset = word.end()
    if rest[offset:].strip():
        raise GcodeRefused(f"line {number}: {quote_text(rest[offset:])} cannot be read: is the file damaged?")
    return words


def quote_text(text: str) -> str:
    """Quote a line's text for a message, 40 characters at most."""
    text = text.strip()
    return repr(text if len(text) <= 40 else text[:39] + "…")


def _find_max_value(letter: str) -> float:
    """Find the maximum value of a word with this letter."""
    if letter in "XYZIJ":
        return MAX_COORDINATE_MM
    return MAX_E_MM if letter == "E" else MAX_OTHER_VALUE


def _strip_number(command: bytes, number: int) -> bytes:
    """Check and remove the line number and the checksum of a command that was written for a serial port."""
    body, separator, checksum = command.partition(b"*")
    match = _NUMBERED_LINE.match(body)
    if separator:
        xor = 0
        for byte in body:
            xor ^= byte
        if match is None or checksum.strip() != b"%d" % xor:
            raise GcodeRefused(f"line {number}: its checksum is wrong: the file is damaged")
    return match[2] if match is not None else body
