"""Record of the last bytes on a port, in both directions, in memory only."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

_MAX_CHUNKS = 400
_MAX_LINES = 400  # a reply with 400 lines of any content stays below the size limit of a message
_MAX_CHUNK_BYTES = 512
_MAX_LINE_LENGTH = 200


@dataclass(frozen=True, slots=True)
class RecordedLine:
    """Line on the wire: time, direction, and text with `\\x..` for unprintable bytes."""

    at_s: float
    sent: bool
    text: str


class WireRecord:
    """Record of the last reads and writes of a port, up to 200 KB.

    Parameters
    ----------
    now
        Function that returns the time on the farm's clock.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._chunks: deque[tuple[float, bool, bytes]] = deque(maxlen=_MAX_CHUNKS)

    def record(self, is_sent: bool, data: bytes) -> None:
        """Record bytes that were sent or received."""
        if data:
            now_s = self._now()
            for offset in range(0, len(data), _MAX_CHUNK_BYTES):
                self._chunks.append((now_s, is_sent, data[offset : offset + _MAX_CHUNK_BYTES]))

    def list_lines(self) -> list[RecordedLine]:
        """List the last 400 lines, oldest first; the beginning of the first may be missing.

        Only as many bytes as needed are read, as the agent's loop waits for the result.
        """
        chunks: deque[tuple[float, bool, bytes]] = deque()
        newline_count = 0
        for chunk in reversed(self._chunks):
            chunks.appendleft(chunk)
            newline_count += chunk[2].count(b"\n")
            if newline_count > _MAX_LINES:
                break
        return list(split_lines(chunks))[-_MAX_LINES:]


def split_lines(chunks: Iterable[tuple[float, bool, bytes]]) -> Iterator[RecordedLine]:
    """Split chunks into lines, each with the time of the chunk in which it begins."""
    for sent, group in groupby(chunks, key=lambda chunk: chunk[1]):
        began_s, partial = 0.0, b""
        for at_s, _, data in group:
            began_s = began_s if partial else at_s
            *complete_lines, partial = (partial[:_MAX_LINE_LENGTH] + data).split(b"\n")
            for line in complete_lines:
                yield _make_line(began_s, sent, line)
                began_s = at_s
        if partial:
            yield _make_line(began_s, sent, partial)


def _make_line(at_s: float, sent: bool, line: bytes) -> RecordedLine:
    text = line.rstrip(b"\r")[:_MAX_LINE_LENGTH].decode("ascii", "backslashreplace")
    printable = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text[:_MAX_LINE_LENGTH])
    return RecordedLine(at_s, sent, printable)
