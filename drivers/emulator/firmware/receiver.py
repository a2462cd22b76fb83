"""Receiver that splits bytes into lines as ``get_command`` does; its ring buffer drops excess bytes. Pure.

A line also ends after 95 characters. In the Ultimaker 2, a line also ends at a ``:``, and a ``;`` drops its
line and the next one (docs/explanation/ultimaker2-serial.md, section 1.5).
"""

from __future__ import annotations

import re

RING_BYTES = 127
MAX_LINE_BYTES = 95

# A complete numbered move as slicers write it; `add_frame` may have doubled a blank. Used by the fast path.
_MOVE = re.compile(
    rb"N(\d+) ?G[01](?:  ?F(\d+\.?\d*))?"
    + b"".join(rb"(?:  ?%b(-?(?:\d+\.?\d*|\.\d+)))?" % axis for axis in (b"X", b"Y", b"Z", b"E"))
    + rb"\*(\d+)\n"
)
_SPECIAL_CHARACTER_PATTERN = re.compile(rb"[\r:;]")


class Receiver:
    """Ring buffer and incomplete line; see `Dialect` for the parameters."""

    __slots__ = ("_comment_spans_lines", "_is_in_comment", "_line_ends", "_partial_line", "ring")

    def __init__(self, line_ends: bytes, comment_spans_lines: bool) -> None:
        self.ring = b""
        self._line_ends = line_ends
        self._comment_spans_lines = comment_spans_lines
        self._partial_line = b""
        self._is_in_comment = False

    def put(self, data: bytes) -> bytes:
        """Store the bytes that fit, and return the rest."""
        free_bytes = RING_BYTES - len(self.ring)
        self.ring += data[:free_bytes]
        return data[free_bytes:]

    def flush(self) -> None:
        """Empty the ring buffer, as the firmware does at each error."""
        self.ring = b""

    def match_move(self) -> re.Match[bytes] | None:
        """Match a well-formed numbered move at the front without removing it: N, F, X, Y, Z, E, checksum."""
        if self._partial_line or self._is_in_comment:
            return None
        match = _MOVE.match(self.ring)
        return match if match is not None and match.end() <= MAX_LINE_BYTES else None

    def take_line(self) -> bytes | None:
        """Remove the next line and return it without its line end; None if no line is complete."""
        while self.ring:
            if not self._partial_line and not self._is_in_comment:
                end = self.ring.find(b"\n")
                if 0 < end <= MAX_LINE_BYTES and not _SPECIAL_CHARACTER_PATTERN.search(self.ring, 0, end):
                    line, self.ring = self.ring[:end], self.ring[end + 1 :]
                    return line
            char, self.ring = self.ring[:1], self.ring[1:]
            is_line_end = char in b"\n\r" or (char in self._line_ends and not self._is_in_comment)
            if is_line_end or len(self._partial_line) >= MAX_LINE_BYTES:
                if not self._partial_line:
                    self._is_in_comment = False
                    continue
                line, self._partial_line = self._partial_line, b""
                if not self._is_in_comment:
                    return line
                if not self._comment_spans_lines:
                    self._is_in_comment = False
                    return line
            elif char == b";":
                self._is_in_comment = True
            elif not self._is_in_comment:
                self._partial_line += char
        return None
