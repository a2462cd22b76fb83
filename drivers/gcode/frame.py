"""Numbered lines with a checksum, as sent over the wire. Pure.

A flipped bit changes the checksum of the text before the ``*``, unless it creates another ``*``: a ``.`` is
one bit away from it, and the firmware uses the first ``*`` and the digits after it. ``Y112.30`` becomes Y112
with the checksum 30, which the firmware executes if the checksum matches. `add_frame` avoids such lines.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

MAX_FRAME_BYTES = 94
"""Maximum length of a line, without its newline (docs/explanation/ultimaker2-serial.md, section 1.5)."""
_MAX_BYTES_BEFORE_CHECKSUM = MAX_FRAME_BYTES - len(b"255")

_CHECKSUMS = {b"%0*d" % (width, total): total for total in range(128) for width in range(7)} | {b"": 0}
"""Checksum that the firmware would read from each string of up to 6 decimals."""

_SMALL_DECIMALS = re.compile(rb"\.(0*(?:1[01]\d|12[0-7]|\d\d?)|)(?=[ *])")
"""Decimals that may equal a checksum, which is below 128."""


def compute_checksum(line: bytes) -> int:
    """Compute the XOR of at most 128 bytes, by folding one long number onto itself."""
    n = int.from_bytes(line, "little")
    n ^= n >> 512
    n ^= n >> 256
    n ^= n >> 128
    n ^= n >> 64
    n ^= n >> 32
    n ^= n >> 16
    return (n ^ n >> 8) & 0xFF


def compute_running_checksums(text: bytes) -> bytes:
    """Compute the checksum up to and including each byte, by folding one long number onto itself."""
    n = int.from_bytes(text, "big")
    bits = 8
    while bits < 8 * len(text):
        n ^= n >> bits
        bits *= 2
    return n.to_bytes(len(text), "big")


def add_frame(number: int, command: bytes) -> bytes:
    """Add line number, checksum and newline to a command, so that the firmware detects any flipped bit.

    If the decimals (at most 6) after a ``.`` equal the checksum of the text before it, an extra blank makes
    them differ, provided that it fits.
    """
    line = b"N%d %b*" % (number, command)
    checksums = compute_running_checksums(line)
    dot = line.find(b".")
    while dot >= 0:
        end = line.find(b" ", dot)  # -1 in the last word, which the star ends
        if (
            _CHECKSUMS.get(line[dot + 1 : end]) == checksums[dot - 1]
            and len(line) < _MAX_BYTES_BEFORE_CHECKSUM
        ):
            word = line.rindex(b" ", 0, dot)
            line = line[:word] + b" " + line[word:]
            checksums = compute_running_checksums(line)
            dot += 1
        dot = line.find(b".", dot + 1)
    return b"%b%d\n" % (line, checksums[-2])


def add_frames(number: int, commands: Iterable[bytes]) -> list[bytes]:
    """Apply `add_frame` to many commands at once; the first gets line number `number`.

    This is faster than one call per command: the checksums of all prefixes are computed together, and few
    lines have decimals that must be checked.
    """
    lines = [b"N%d %b*" % pair for pair in enumerate(commands, number)]
    text = b"".join(lines)
    checksums = compute_running_checksums(text)
    candidates = _SMALL_DECIMALS.finditer(text)
    decimals = next(candidates, None)
    frames: list[bytes] = []
    end = start_checksum = 0  # end of the line, and checksum of all lines before it
    for line in lines:
        end += len(line)
        collides = False
        while decimals is not None and (dot := decimals.start()) < end:
            collides |= checksums[dot - 1] ^ start_checksum == _CHECKSUMS.get(decimals[1])
            decimals = next(candidates, None)
        if collides:
            line_number = number + len(frames)
            frames.append(add_frame(line_number, line[:-1].partition(b" ")[2]))
        else:
            frames.append(b"%b%d\n" % (line, checksums[end - 2] ^ start_checksum))
        start_checksum = checksums[end - 1]
    return frames


def remove_frame(line: bytes) -> bytes:
    """Return the command in a line that `add_frame` made."""
    return line.partition(b"*")[0].partition(b" ")[2].replace(b"  ", b" ")
