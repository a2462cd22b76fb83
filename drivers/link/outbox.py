"""Lines of a link: commands and a program, numbered, encoded ahead, and kept to be sent again. Pure.

A number is given for good when its line is sent. What is only encoded ahead gets another one where an M105 is
put in front of it.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable

from drivers.firmware import Firmware
from drivers.gcode import add_frame, remove_frame

HISTORY_LINES = 32
LINE_S = 50.0  # a line is given up after so long,
POLL_S = 150.0  # an M105, which waits its turn behind up to 8 moves
REACH_MM = 460.0  # no straight move over the largest bed is longer,
ARC_REACH_MM = 1450.0  # and no arc
QUEUED_LINES = 32  # a slow move holds up the answers to so many lines behind it: 16 planned, 8 waiting
_BLOCK_LINES = 256

_MOVES = (b"G0 ", b"G1 ", b"G2 ", b"G3 ")
_ARCS = (b"G2 ", b"G3 ")
_FEEDRATE = re.compile(rb"F(\d+\.?\d*)")
_TRAVELS = re.compile(rb".*[XYZ]").match  # not the feeder alone

Source = Callable[[int, int], list[bytes]]
"""Lines `start` to `stop` of a program."""


class Outbox:
    """Numbered lines, those behind the cursor sent, those after it not yet."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        # frames[i] is line number base + i; up to the cursor they were sent, those after it are encoded
        # ahead.
        self._frames: list[bytes] = []
        self._base = 1
        self._cursor = -1
        self._top = -1  # the highest number that was sent before the cursor went back
        self._patience: dict[int, float] = {}  # of lines that may take long
        self._feedrate_mm_min = math.inf  # of the last line that was encoded
        self._slow_s = 0.0  # how long a move among the last `QUEUED_LINES` may take,
        self._slow_until = -1  # up to this line
        self._polls: set[int] = set()  # lines that are M105
        self._careful = 0  # up to this number lines may be special, or were sent before
        self._queue: deque[bytes] = deque()
        self._source: Source | None = None
        self._source_at = self._source_stop = 0  # next line of the program to encode
        self._source_number = 1  # the line number of the program's first line of this run,
        self._source_start = 0  # and its place there

    def begin(self) -> None:
        """The board counts from 0: an M110 goes out as N0, so that the next is 1."""
        self._base, self._cursor, self._top, self._frames = 0, -1, -1, []
        self._queue.appendleft(b"M110")

    # --- what there is ---

    @property
    def number(self) -> int:
        """Of the line that was sent last; negative before the first."""
        return self._base + self._cursor

    @property
    def top(self) -> int:
        """The highest number that was sent."""
        return max(self._top, self.number)

    @property
    def fresh(self) -> bool:
        """Whether the next line was never sent: another may be put before it."""
        return self.number >= self._top

    @property
    def moves(self) -> bool:
        """Whether the line that was sent last has its ok as soon as it is accepted."""
        return self._frames[self._cursor].partition(b" ")[2].startswith(_MOVES)

    @property
    def pending(self) -> bool:
        """Whether there is something that was not sent yet."""
        return self._cursor + 1 < len(self._frames) or bool(self._queue) or self.streaming

    @property
    def streaming(self) -> bool:
        """Whether lines of a program are still to be encoded."""
        return self._source is not None and self._source_at < self._source_stop

    @property
    def polls(self) -> bool:
        """Whether the line that was sent last is an M105."""
        return self.number in self._polls

    @property
    def patience_s(self) -> float:
        """Seconds after which the line that was sent last is given up."""
        return max(POLL_S if self.polls else LINE_S, self._patience.get(self.number, 0.0))

    def holds(self, number: int) -> bool:
        """Whether it is recent enough to be sent again."""
        return number >= self._base and self.number - number < HISTORY_LINES

    def streamed(self, waiting: bool) -> int:
        """Lines of the program that were acknowledged; `waiting`: the one that was sent last is not."""
        number = self.number
        number -= waiting and not self.polls  # an M105 is no line of a program
        done = self._source_start + number - self._source_number + 1
        return min(max(done, self._source_start), self._source_stop)

    # --- what is to come ---

    def queue(self, commands: tuple[bytes, ...]) -> None:
        """Behind those that wait."""
        self._queue.extend(commands)

    def stream(self, source: Source, start: int, stop: int) -> None:
        """Lines `start` to `stop` of a program, behind all that was queued."""
        self._source, self._source_start, self._source_at, self._source_stop = source, start, start, stop
        self._source_number = self._base + len(self._frames) + len(self._queue)

    def halt(self) -> None:
        """Forget what was not sent yet."""
        sent = self._cursor + 1
        self._top = self.number
        done = self._source_start + self._base + sent - self._source_number
        self._source_stop = min(max(done, self._source_start), self._source_stop)
        self._source = None
        self._queue.clear()
        del self._frames[sent:]
        self._patience = {n: s for n, s in self._patience.items() if n < self._base + sent}
        feedrates = (_FEEDRATE.search(line) for line in reversed(self._frames))
        if (last := next(filter(None, feedrates), None)) is not None:
            self._feedrate_mm_min = float(last[1]) or self._feedrate_mm_min

    def insert_poll(self) -> None:
        """Put an M105 before all that is encoded ahead, which gets new numbers."""
        sent = self._cursor + 1
        number = self._base + sent
        ahead = self._frames[sent:]
        del self._frames[sent:]
        self._frames.append(add_frame(number, self._firmware.report_query))
        self._polls = {n for n in self._polls if n >= self._base}
        self._polls = {n + (n >= number) for n in self._polls} | {number}
        self._patience = {n + (n >= number): s for n, s in self._patience.items()}
        if self._source_number + self._source_stop - self._source_start > number:
            self._source_number += 1  # the program, or the rest of it, comes behind
        for at, old in enumerate(ahead, number + 1):
            self._frames.append(add_frame(at, remove_frame(old)))
        self._careful = max(self._careful + 1, self._base + sent)

    # --- what goes out ---

    def take_encoded(self) -> bytes | None:
        """The next line where it is an everyday one, encoded already; None: call `take_next`."""
        ahead = self._cursor + 1
        if ahead < len(self._frames) and self._base + self._cursor > self._careful:
            self._cursor = ahead
            return self._frames[ahead]
        return None

    def take_next(self) -> bytes | None:
        """The next line; None where there is none."""
        if self._cursor + 1 >= len(self._frames):
            self._encode_ahead()
        if self._cursor + 1 >= len(self._frames):
            return None
        self._cursor += 1
        return self._frames[self._cursor]

    def rewind_to(self, number: int) -> bytes:
        """Line `number` again, and from there on."""
        self._top = self.top
        self._careful = max(self._careful, self._top)
        self._cursor = number - self._base
        return self._frames[self._cursor]

    def _encode_ahead(self) -> None:
        """Encode a block of lines; called where all that was encoded is sent."""
        spare = len(self._frames) - HISTORY_LINES
        if spare > 0:
            del self._frames[:spare]
            self._base += spare
            self._cursor -= spare
            self._patience = {n: s for n, s in self._patience.items() if n >= self._base}
        number = self._base + len(self._frames)
        commands: list[bytes] = []
        if self._queue:
            commands = [*self._queue]
            self._queue.clear()
        elif self._source is not None:
            stop = min(self._source_at + _BLOCK_LINES, self._source_stop)
            commands = self._source(self._source_at, stop)
            self._source_at = stop
        for command in commands:
            if command.startswith(_MOVES):
                self._expect_slow(number, command)
            elif (waiting_s := self._firmware.waiting_s.get(command.split(b" ", 1)[0])) is not None:
                self._patience[number] = waiting_s
                self._careful = number
            if number <= self._slow_until:
                self._patience[number] = max(self._slow_s, self._patience.get(number, 0.0))
            self._frames.append(add_frame(number, command))
            number += 1

    def _expect_slow(self, number: int, move: bytes) -> None:
        """Note a move that may take longer than `LINE_S`, by its feedrate: its length is not known here."""
        if (found := _FEEDRATE.search(move)) is not None and float(found[1]) > 0.0:
            self._feedrate_mm_min = float(found[1])
        if move.startswith(_ARCS):
            takes_s = 60.0 * ARC_REACH_MM / self._feedrate_mm_min
        elif self._feedrate_mm_min * LINE_S >= 60.0 * REACH_MM or not _TRAVELS(move):
            return
        else:
            takes_s = 60.0 * REACH_MM / self._feedrate_mm_min
        if takes_s > LINE_S:
            self._slow_s = max(takes_s, self._slow_s if number <= self._slow_until else 0.0)
            self._slow_until = number + QUEUED_LINES
