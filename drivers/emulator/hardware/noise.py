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
    damaged
        Number of bytes flipped, lost or doubled, in both directions.
    altered
        Number of lines that the firmware accepted although their words were changed: checksum collisions.
    """

    def __init__(self, faults: Faults, rng: random.Random) -> None:
        self.damaged = 0
        self.altered = 0
        self._rng = rng
        self._share = faults.noise, faults.lost, faults.doubled
        self._rate = sum(self._share)
        self._scale = math.log1p(-self._rate) if 0.0 < self._rate < 1.0 else -math.inf
        self._gap = self._draw_gap()  # bytes until the next damaged one
        self._sent: dict[bytes, bytes] = {}  # the last lines as sent, by number
        self._unfinished = b""

    def _draw_gap(self) -> int:
        return int(math.log(1.0 - self._rng.random()) / self._scale)

    def carry(self, data: bytes) -> bytes:
        """Return the bytes as received."""
        if len(data) <= self._gap:
            self._gap -= len(data)
            return data
        out = bytearray()
        at = 0
        while at + self._gap < len(data):
            out += data[at : at + self._gap]
            at += self._gap
            out += self._damage(data[at])
            at += 1
            self._gap = self._draw_gap()
        out += data[at:]
        self._gap -= len(data) - at
        return bytes(out)

    def carry_to_board(self, data: bytes) -> bytes:
        """Return bytes from the host as the board receives them."""
        *lines, self._unfinished = (self._unfinished + data).split(b"\n")
        for line in lines:
            self._sent[line[1:].partition(b" ")[0]] = line.partition(b"*")[0]
        while len(self._sent) > _MAX_LINES:
            del self._sent[next(iter(self._sent))]
        return self.carry(data)

    def check_accepted(self, number: int, line: bytes) -> None:
        """Compare an accepted line with the one that was sent under this number, white space aside.

        Two doubled spaces leave the checksum as it was, and the firmware skips them.
        """
        sent = self._sent.get(b"%d" % number)
        if sent is None and self._unfinished.startswith(b"N%d " % number):
            sent = self._unfinished.partition(b"*")[0]
        if sent is not None and sent.split() != line.partition(b"*")[0].split():
            self.altered += 1

    def forget(self) -> None:
        """Forget the sent lines: the board was reset and counts from 0."""
        self._sent.clear()
        self._unfinished = b""

    def _damage(self, byte: int) -> bytes:
        self.damaged += 1
        flipped, lost, _ = self._share
        roll = self._rng.random() * self._rate
        if roll < flipped:
            return bytes((byte ^ 1 << self._rng.randrange(8),))
        return b"" if roll < flipped + lost else bytes((byte, byte))
