"""Outgoing lines of a link, commands and a program: numbered, encoded ahead, and stored for resending. Pure.

A line's number is final once the line is sent. Lines that are only encoded ahead get new numbers when an M105
is inserted in front of them.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable

from drivers.errors import UnreadableFile
from drivers.firmware import Firmware
from drivers.gcode import add_frame, add_frames, remove_frame

HISTORY_LINES = 32
LINE_TIMEOUT_S = 50.0  # timeout of a line
POLL_TIMEOUT_S = 150.0  # timeout of an M105, which waits behind up to 8 moves
MAX_MOVE_MM = 460.0  # longest straight move over the largest bed
MAX_ARC_MM = 1450.0  # longest arc
QUEUED_LINES = 32  # number of lines after a slow move whose answers it may delay: the board holds 16 + 8
_BLOCK_LINES = 256

_MOVES = (b"G0 ", b"G1 ", b"G2 ", b"G3 ")
_ARCS = (b"G2 ", b"G3 ")
_FEEDRATE = re.compile(rb"F(\d+\.?\d*)")
_match_head_move = re.compile(rb".*[XYZ]").match  # matches a move of more than the feeder

Source = Callable[[int, int], list[bytes]]
"""Function that returns lines `start` to `stop` of a program. Raises UnreadableFile."""


class Outbox:
    """Numbered lines: sent up to the cursor, unsent after it.

    Attributes
    ----------
    source_error
        Error that ended the stream: the program could not be read.
    """

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        # frames[i] is line number base + i. Lines up to the cursor were sent; the rest is encoded ahead.
        self._frames: list[bytes] = []
        self._base = 1
        self._cursor = -1
        self._highest_sent = -1  # the highest number that was sent before the cursor moved back
        self._timeouts_s: dict[int, float] = {}  # timeouts of slow lines, by number
        self._feedrate_mm_min = math.inf  # feedrate after the last encoded line
        self._slowest_move_s = 0.0  # duration of the slowest move among the last `QUEUED_LINES`
        self._slow_line_end = -1  # number of the last line that `_slowest_move_s` delays
        self._polls: set[int] = set()  # numbers of the M105 lines
        self._slow_path_end = 0  # lines up to this number need the slow path: slow moves, M105, resent lines
        self._queue: deque[bytes] = deque()
        self._source: Source | None = None
        self.source_error: UnreadableFile | None = None
        self._source_next = self._source_stop = 0  # next line of the program to encode
        self._source_number = 1  # line number of the first streamed line
        self._source_start = 0  # index of that line in the program

    def begin(self) -> None:
        """Restart the line count: M110 is sent as N0, so the next line is N1."""
        self._base, self._cursor, self._highest_sent, self._frames = 0, -1, -1, []
        self._queue.appendleft(b"M110")

    # --- state ---

    @property
    def number(self) -> int:
        """Number of the last sent line; negative before the first."""
        return self._base + self._cursor

    @property
    def highest_number(self) -> int:
        """Highest number that was sent."""
        return max(self._highest_sent, self.number)

    @property
    def is_next_unsent(self) -> bool:
        """True if the next line was never sent, so another line may be inserted before it."""
        return self.number >= self._highest_sent

    @property
    def is_move(self) -> bool:
        """True if the last sent line is a move, which is acknowledged as soon as it is accepted."""
        return self._frames[self._cursor].partition(b" ")[2].startswith(_MOVES)

    @property
    def has_unsent(self) -> bool:
        """True if there are unsent lines."""
        return self._cursor + 1 < len(self._frames) or bool(self._queue) or self.is_streaming

    @property
    def is_streaming(self) -> bool:
        """True if lines of a program are still to be encoded."""
        return self._source is not None and self._source_next < self._source_stop

    @property
    def is_poll(self) -> bool:
        """True if the last sent line is an M105."""
        return self.number in self._polls

    @property
    def timeout_s(self) -> float:
        """Timeout of the last sent line, in seconds."""
        return max(POLL_TIMEOUT_S if self.is_poll else LINE_TIMEOUT_S, self._timeouts_s.get(self.number, 0.0))

    def holds(self, number: int) -> bool:
        """Return True if line `number` is recent enough to be resent."""
        return number >= self._base and self.number - number < HISTORY_LINES

    def count_streamed_lines(self, awaits_ok: bool) -> int:
        """Count the acknowledged lines of the program; `awaits_ok` excludes the last sent line."""
        number = self.number
        number -= awaits_ok and not self.is_poll  # an M105 is not part of the program
        line = self._source_start + number - self._source_number + 1
        return min(max(line, self._source_start), self._source_stop)

    # --- queueing ---

    def queue(self, commands: tuple[bytes, ...]) -> None:
        """Append commands to the queue."""
        self._queue.extend(commands)

    def stream(self, source: Source, start: int, stop: int) -> None:
        """Stream lines `start` to `stop` of a program after the queued commands."""
        self._source, self._source_start, self._source_next, self._source_stop = source, start, start, stop
        self._source_number = self._base + len(self._frames) + len(self._queue)
        self.source_error = None

    def drop_unsent(self) -> None:
        """Drop all unsent lines."""
        sent_count = self._cursor + 1
        self._highest_sent = self.number
        line = self._source_start + self._base + sent_count - self._source_number
        self._source_stop = min(max(line, self._source_start), self._source_stop)
        self._source = None
        self._queue.clear()
        del self._frames[sent_count:]
        self._timeouts_s = {n: s for n, s in self._timeouts_s.items() if n < self._base + sent_count}
        feedrates = (_FEEDRATE.search(line) for line in reversed(self._frames))
        if (feedrate := next(filter(None, feedrates), None)) is not None:
            self._feedrate_mm_min = float(feedrate[1]) or self._feedrate_mm_min

    def insert_poll(self) -> None:
        """Insert an M105 before the lines encoded ahead, which get new numbers."""
        sent_count = self._cursor + 1
        number = self._base + sent_count
        encoded_lines = self._frames[sent_count:]
        del self._frames[sent_count:]
        self._frames.append(add_frame(number, self._firmware.report_query))
        self._polls = {n for n in self._polls if n >= self._base}
        self._polls = {n + (n >= number) for n in self._polls} | {number}
        self._timeouts_s = {n + (n >= number): s for n, s in self._timeouts_s.items()}
        if self._source_number + self._source_stop - self._source_start > number:
            self._source_number += 1  # the rest of the program follows
        self._frames += add_frames(number + 1, map(remove_frame, encoded_lines))
        self._slow_path_end = max(self._slow_path_end + 1, self._base + sent_count)

    # --- sending ---

    def take_encoded_line(self) -> bytes | None:
        """Return the next line if it is ordinary and already encoded; if this is None, call `take_next`."""
        number = self._cursor + 1
        if number < len(self._frames) and self._base + self._cursor > self._slow_path_end:
            self._cursor = number
            return self._frames[number]
        return None

    def take_next(self) -> bytes | None:
        """Return the next line; None if there is none."""
        if self._cursor + 1 >= len(self._frames):
            self._encode_ahead()
        if self._cursor + 1 >= len(self._frames):
            return None
        self._cursor += 1
        return self._frames[self._cursor]

    def rewind_to(self, number: int) -> bytes:
        """Move the cursor back to line `number`, and return that line."""
        self._highest_sent = self.highest_number
        self._slow_path_end = max(self._slow_path_end, self._highest_sent)
        self._cursor = number - self._base
        return self._frames[self._cursor]

    def _encode_ahead(self) -> None:
        """Encode a block of lines; called once all encoded lines are sent."""
        excess = len(self._frames) - HISTORY_LINES
        if excess > 0:
            del self._frames[:excess]
            self._base += excess
            self._cursor -= excess
            self._timeouts_s = {n: s for n, s in self._timeouts_s.items() if n >= self._base}
        first = self._base + len(self._frames)
        commands: list[bytes] = []
        if self._queue:
            commands = [*self._queue]
            self._queue.clear()
        elif self._source is not None:
            stop = min(self._source_next + _BLOCK_LINES, self._source_stop)
            try:
                commands = self._source(self._source_next, stop)
            except UnreadableFile as error:  # no line may be skipped
                self._source, self.source_error = None, error
            self._source_next = stop
        self._frames += add_frames(first, commands)
        for number, command in enumerate(commands, first):
            if command.startswith(_MOVES):
                self._note_slow_move(number, command)
            elif (timeout_s := self._firmware.wait_timeouts_s.get(command.split(b" ", 1)[0])) is not None:
                self._timeouts_s[number] = timeout_s
                self._slow_path_end = number
            if number <= self._slow_line_end:
                self._timeouts_s[number] = max(self._slowest_move_s, self._timeouts_s.get(number, 0.0))

    def _note_slow_move(self, number: int, move: bytes) -> None:
        """Note a move that may take longer than `LINE_TIMEOUT_S`, assuming the longest possible move."""
        if b"F" in move and (match := _FEEDRATE.search(move)) is not None and float(match[1]) > 0.0:
            self._feedrate_mm_min = float(match[1])
        if move.startswith(_ARCS):
            duration_s = 60.0 * MAX_ARC_MM / self._feedrate_mm_min
        elif self._feedrate_mm_min * LINE_TIMEOUT_S >= 60.0 * MAX_MOVE_MM or not _match_head_move(move):
            return
        else:
            duration_s = 60.0 * MAX_MOVE_MM / self._feedrate_mm_min
        if duration_s > LINE_TIMEOUT_S:
            self._slowest_move_s = max(
                duration_s, self._slowest_move_s if number <= self._slow_line_end else 0.0
            )
            self._slow_line_end = number + QUEUED_LINES
