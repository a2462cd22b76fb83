"""Position of the filament in the middle of a file, by its lines and where the head stood. Pure.

The firmware acknowledges moves long before it makes them, so the last line that it took does not tell where
a quick stop (M401) found the feeder. But M114 then tells the real place
(docs/explanation/ultimaker2-serial.md, section 3.1), and of the last moves only those that lead through it
can have been under way.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Sequence

from drivers.gcode.program import Program

AHEAD_LINES = 64  # planner and line buffer hold 24 moves, and not every line is a move
WINDOW_LINES = 4096  # the filament was surely at the nozzle somewhere in so many lines
NEAR_MM = 1.0  # M114 rounds to 0.01

_PLACE = re.compile(rb"X:(-?[\d.]+)\s*Y:(-?[\d.]+)\s*Z:(-?[\d.]+)\s*E:(-?[\d.]+)")
_WORD = re.compile(rb"([FXYZE])(-?[\d.]+)")
_FEED = re.compile(rb"F([\d.]+)")
_AXES = {b"X": 0, b"Y": 1, b"Z": 2, b"E": 3}
_MOVES = (b"G0 ", b"G1 ", b"G2 ", b"G3 ")

Point = Sequence[float]
"""X, Y, Z, E in mm, as the file counts them; NaN where nobody knows."""


def place(said: bytes) -> Point | None:
    """The answer to M114: the target of the last move, which after M401 is where the head stands."""
    found = _PLACE.match(said)
    if found is None:
        return None
    try:
        return [float(value) for value in found.groups()]
    except ValueError:
        return None


def retracted_mm(program: Program, done: int, stood: Point | None = None) -> float:
    """Compute how far behind the nozzle's tip the filament ends.

    Parameters
    ----------
    program
        What is printed; the filament was at the nozzle when it began to extrude.
    done
        Lines that were acknowledged.
    stood
        Where a quick stop found the head; None where all moves were made.

    Returns
    -------
    float
        In mm, 0 at the tip. Exact but for a G92 among the last moves, which shifts what the firmware counts.
    """
    walk = Walk(program, done)
    return walk.back_mm if stood is None else walk.back_at(stood)


class Walk:
    """The last lines of those that are done, followed as the firmware does.

    Attributes
    ----------
    at
        X, Y, Z, E as the file counts them; NaN where no line has said.
    back_mm
        How far behind the nozzle's tip the filament ends.
    feed_mm_min
        The last F; NaN where there was none.
    relative, relative_e
        Whether G91, or M83, is in force.
    """

    def __init__(self, program: Program, done: int) -> None:
        start = max(0, done - WINDOW_LINES)
        self.relative, self.relative_e = program.relative(start), program.relative_e(start)
        if self.relative or self.relative_e:  # what E counts is the sum of all
            self.relative = self.relative_e = False
            start = 0
        self.at = [math.nan, math.nan, math.nan, math.nan if start else 0.0]
        self.back_mm = 0.0
        self.feed_mm_min = _last_feed(program, start)
        # from, to, and how far back the filament was before
        self._moves: deque[tuple[list[float], list[float], float]] = deque(maxlen=AHEAD_LINES)
        for first in range(start, done, WINDOW_LINES):  # never all lines of a long file at a time
            for line in program.lines(first, min(done, first + WINDOW_LINES)):
                self._follow(line)

    def _follow(self, line: bytes) -> None:
        if line.startswith(_MOVES):
            self._move(line)
        elif line.startswith(b"G92 "):
            for letter, value in _WORD.findall(line):
                if letter != b"F":
                    self._count(_AXES[letter], float(value))
        elif line.split(b" ", 1)[0] == b"G28":  # all moves before it were made
            self._moves.clear()
            self.at[:3] = [math.nan] * 3
        elif line in (b"G90", b"G91"):
            self.relative = line == b"G91"
        elif line in (b"M82", b"M83"):
            self.relative_e = line == b"M83"

    def _move(self, line: bytes) -> None:
        before = self.at
        after = before.copy()
        for letter, value in _WORD.findall(line):
            if letter == b"F":
                if float(value) > 0:  # the firmware goes on as before otherwise
                    self.feed_mm_min = float(value)
                continue
            axis = _AXES[letter]
            relative = self.relative or (axis == 3 and self.relative_e)
            after[axis] = float(value) + (before[axis] if relative else 0.0)
        self._moves.append((before, after, self.back_mm))
        self.at = after
        fed_mm = after[3] - before[3]
        if not math.isnan(fed_mm):
            self.back_mm = max(0.0, self.back_mm - fed_mm)

    def _count(self, axis: int, value: float) -> None:
        """G92: the same place has another name from now on, in the moves under way as well."""
        shift = value - self.at[axis]
        self.at = self.at.copy()
        self.at[axis] = value
        self._moves = deque(
            (
                (_shifted(before, axis, shift), _shifted(after, axis, shift), back_mm)
                for before, after, back_mm in self._moves
            ),
            AHEAD_LINES,
        )

    def back_at(self, stood: Point) -> float:
        """Compute it for where the head stood; by the last line where no move leads there."""
        nearest_mm, found_mm = NEAR_MM, self.back_mm
        for before, after, back_mm in self._moves:
            away_mm = _distance(stood, before, after)
            if away_mm < nearest_mm:
                fed_mm = stood[3] - before[3]
                nearest_mm, found_mm = away_mm, max(0.0, back_mm - (0.0 if math.isnan(fed_mm) else fed_mm))
        return found_mm


def _last_feed(program: Program, line: int) -> float:
    """The last F before `line`; NaN where there was none."""
    while line > 0:
        first = max(0, line - WINDOW_LINES)
        for move in reversed(program.lines(first, line)):
            if move.startswith(_MOVES) and (found := _FEED.search(move)) is not None:
                return float(found[1])
        line = first
    return math.nan


def _shifted(point: list[float], axis: int, by_mm: float) -> list[float]:
    return [value + by_mm if at == axis else value for at, value in enumerate(point)]


def _distance(point: Point, start: Point, end: Point) -> float:
    """From a point to a stretch, over the axes that are known."""
    known = [
        (p, b if math.isnan(a) else a, b)
        for p, a, b in zip(point, start, end, strict=True)
        if not math.isnan(b)
    ]
    long2 = sum((b - a) ** 2 for _, a, b in known)
    along = sum((p - a) * (b - a) for p, a, b in known) / long2 if long2 else 0.0
    along = min(max(along, 0.0), 1.0)
    return math.sqrt(sum((p - a - along * (b - a)) ** 2 for p, a, b in known))
