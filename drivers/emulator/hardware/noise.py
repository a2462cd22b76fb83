"""Noise of a bad cable, and the errors that an 8-bit checksum misses."""

from __future__ import annotations

import math
import random

from drivers.emulator.faults import Faults

_MAX_LINES = 64


class Noise:
    """Noise on the wire between host and board.

    Attributes
    ----------
    damaged_byte_count
        Number of bytes flipped, lost or doubled, in both directions.
    altered_line_count
        Number of checksum collisions: lines that the firmware accepted although their words were changed.
    """

    def __init__(self, faults: Faults, rng: random.Random) -> None:
        self.damaged_byte_count = 0
        self.altered_line_count = 0
        self._rng = rng
        self._probabilities = faults.noise, faults.lost, faults.doubled
        self._damage_probability = sum(self._probabilities)
        # Logarithm of the probability that a byte is not damaged.
        self._log_intact = (
            math.log1p(-self._damage_probability) if 0.0 < self._damage_probability < 1.0 else -math.inf
        )
        self._gap_bytes = self._draw_gap()  # bytes until the next damaged one
        self._sent_lines: dict[bytes, bytes] = {}  # the last lines as sent, by number
        self._incomplete_line = b""

    def _draw_gap(self) -> int:
        return int(math.log(1.0 - self._rng.random()) / self._log_intact)

    def carry(self, data: bytes) -> bytes:
        """Return the bytes as the other end receives them."""
        if len(data) <= self._gap_bytes:
            self._gap_bytes -= len(data)
            return data
        received_bytes = bytearray()
        start = 0
        while start + self._gap_bytes < len(data):
            received_bytes += data[start : start + self._gap_bytes]
            start += self._gap_bytes
            received_bytes += self._damage_byte(data[start])
            start += 1
            self._gap_bytes = self._draw_gap()
        received_bytes += data[start:]
        self._gap_bytes -= len(data) - start
        return bytes(received_bytes)

    def carry_to_board(self, data: bytes) -> bytes:
        """Return bytes from the host as the board receives them."""
        *lines, self._incomplete_line = (self._incomplete_line + data).split(b"\n")
        for line in lines:
            self._sent_lines[line[1:].partition(b" ")[0]] = line.partition(b"*")[0]
        while len(self._sent_lines) > _MAX_LINES:
            del self._sent_lines[next(iter(self._sent_lines))]
        return self.carry(data)

    def check_accepted_line(self, number: int, line: bytes) -> None:
        """Compare an accepted line with the line sent under this number, ignoring white space.

        Two doubled spaces do not change the checksum, and the firmware skips them.
        """
        sent_line = self._sent_lines.get(b"%d" % number)
        if sent_line is None and self._incomplete_line.startswith(b"N%d " % number):
            sent_line = self._incomplete_line.partition(b"*")[0]
        if sent_line is not None and sent_line.split() != line.partition(b"*")[0].split():
            self.altered_line_count += 1

    def forget_lines(self) -> None:
        """Forget the sent lines: the board was reset and counts from 0."""
        self._sent_lines.clear()
        self._incomplete_line = b""

    def _damage_byte(self, byte: int) -> bytes:
        self.damaged_byte_count += 1
        flip_probability, loss_probability, _ = self._probabilities
        sample = self._rng.random() * self._damage_probability
        if sample < flip_probability:
            return bytes((byte ^ 1 << self._rng.randrange(8),))
        return b"" if sample < flip_probability + loss_probability else bytes((byte, byte))
