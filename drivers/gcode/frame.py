"""Numbered lines with a checksum, as they go over the wire. Pure."""

from __future__ import annotations


def checksum(line: bytes) -> int:
    """XOR of all bytes (at most 128 of them), by folding one long number onto itself."""
    n = int.from_bytes(line, "little")
    n ^= n >> 512
    n ^= n >> 256
    n ^= n >> 128
    n ^= n >> 64
    n ^= n >> 32
    n ^= n >> 16
    return (n ^ n >> 8) & 0xFF


def frame(number: int, command: bytes) -> bytes:
    """One numbered and checksummed line with its newline."""
    line = b"N%d %b" % (number, command)
    return b"%b*%d\n" % (line, checksum(line))
