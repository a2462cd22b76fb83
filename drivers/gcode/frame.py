"""Numbered lines with a checksum, as they go over the wire. Pure.

One flipped bit changes the checksum of what stands before the ``*``, unless it makes another ``*``: a ``.``
is one bit away from it, and the firmware takes the first ``*`` and the digits behind it. ``Y112.30`` becomes
a Y112 with the checksum 30, which is carried out where that fits. `add_frame` makes no such line.
"""

from __future__ import annotations

LINE_BYTES = 94
"""The longest line, without its newline (docs/explanation/ultimaker2-serial.md, section 1.5)."""
_MOST = LINE_BYTES - len(b"255")

_CHECKSUMS = {b"%0*d" % (width, total): total for total in range(128) for width in range(7)} | {b"": 0}
"""Decimals, at most 6, and the checksum of ASCII as which the firmware reads them."""


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
    """Compute the checksum up to each byte, itself included, of a line of at most 128 bytes."""
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

    Where the decimals (at most 6) behind a ``.`` are the checksum of what stands before it, another blank
    makes them differ, if there is room for it.
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
