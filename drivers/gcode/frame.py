"""Numbered lines with a checksum, as sent over the wire. Pure.

A flipped bit changes the checksum of the text before the ``*``, unless it creates another ``*``: a ``.`` is
one bit away from it, and the firmware uses the first ``*`` and the digits after it. ``Y112.30`` becomes Y112
with the checksum 30, which is executed if that matches. `add_frame` never produces such a line.
"""

from __future__ import annotations

LINE_BYTES = 94
"""The longest line, without its newline (docs/explanation/ultimaker2-serial.md, section 1.5)."""
_MOST = LINE_BYTES - len(b"255")

_CHECKSUMS = {b"%0*d" % (width, total): total for total in range(128) for width in range(7)} | {b"": 0}
"""Maps up to 6 decimals, in ASCII, to the checksum that the firmware would read."""


def checksum(line: bytes) -> int:
    """Compute the XOR of at most 128 bytes, by folding one long number onto itself."""
    n = int.from_bytes(line, "little")
    n ^= n >> 512
    n ^= n >> 256
    n ^= n >> 128
    n ^= n >> 64
    n ^= n >> 32
    n ^= n >> 16
    return (n ^ n >> 8) & 0xFF


def running_checksums(line: bytes) -> bytes:
    """Compute the checksum up to and including each byte of a line of at most 128 bytes."""
    n = int.from_bytes(line, "big")
    n ^= n >> 8
    n ^= n >> 16
    n ^= n >> 32
    n ^= n >> 64
    n ^= n >> 128
    n ^= n >> 256
    n ^= n >> 512
    return n.to_bytes(len(line), "big")


def add_frame(number: int, command: bytes) -> bytes:
    """Add line number, checksum and newline to a command, such that no flipped bit is accepted.

    If the decimals (at most 6) after a ``.`` equal the checksum of the text before it, an extra blank makes
    them differ, if there is room for it.
    """
    line = b"N%d %b*" % (number, command)
    totals = running_checksums(line)
    dot = line.find(b".")
    while dot >= 0:
        end = line.find(b" ", dot)  # of the last word -1, at the star
        if _CHECKSUMS.get(line[dot + 1 : end]) == totals[dot - 1] and len(line) < _MOST:
            word = line.rindex(b" ", 0, dot)
            line = line[:word] + b" " + line[word:]
            totals = running_checksums(line)
            dot += 1
        dot = line.find(b".", dot + 1)
    return b"%b%d\n" % (line, totals[-2])


def remove_frame(line: bytes) -> bytes:
    """Return the command in a line that `add_frame` made."""
    return line.partition(b"*")[0].partition(b" ")[2].replace(b"  ", b" ")
