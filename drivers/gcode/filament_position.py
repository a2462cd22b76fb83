"""Position of the filament during a program, from its lines and the position of the head. Pure.

The firmware acknowledges moves long before it executes them, so the last acknowledged line does not show
where a quick stop (M401) stopped the feeder. But M114 then returns the real position
(docs/explanation/ultimaker2-serial.md, section 3.1): the move that was interrupted passes through it.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Sequence

from drivers.gcode.program import Program

BUFFERED_LINES = 64  # planner and line buffer hold 24 moves, and not every line is a move
WINDOW_LINES = 4096  # number of lines within which the filament is at the nozzle at least once
POSITION_TOLERANCE_MM = 1.0  # M114 rounds positions to 0.01

_POSITION = re.compile(rb"X:(-?[\d.]+)\s*Y:(-?[\d.]+)\s*Z:(-?[\d.]+)\s*E:(-?[\d.]+)")
_WORD = re.compile(rb"([FXYZE])(-?[\d.]+)")
_FEEDRATE = re.compile(rb"F([\d.]+)")
_AXES = {b"X": 0, b"Y": 1, b"Z": 2, b"E": 3}
_MOVE_STARTS = (b"G0 ", b"G1 ", b"G2 ", b"G3 ")

Point = Sequence[float]
"""X, Y, Z, E in mm, in the file's coordinates; NaN if unknown."""


def read_position(answer: bytes) -> Point | None:
    """Parse the answer to M114: the target of the last move, or after M401 the position of the head."""
    match = _POSITION.match(answer)
    if match is None:
        return None
    try:
        return [float(value) for value in match.groups()]
    except ValueError:
        return None


def measure_retraction_mm(program: Program, done_line_count: int, stop_point: Point | None = None) -> float:
    """Compute the distance from the nozzle's tip back to the filament's tip.

    Parameters
    ----------
    program
        The program; the filament was at the nozzle at its first extrusion.
    done_line_count
        Number of acknowledged lines.
    stop_point
        Position of the head after a quick stop; None if all moves were executed.

    Returns
    -------
    float
        Distance in mm; 0 at the tip. It is exact, unless a G92 among the last moves shifted the coordinates.
    """
    motion = MotionState(program, done_line_count)
    return motion.retracted_mm if stop_point is None else motion.find_retraction_mm(stop_point)


class MotionState:
    """State after the last acknowledged lines, tracked as the firmware does.

    Parameters
    ----------
    program
        The program; the filament was at the nozzle at its first extrusion.
    done_line_count
        Number of acknowledged lines.

    Attributes
    ----------
    position_mm
        X, Y, Z, E in the file's coordinates; NaN if no line has set them.
    retracted_mm
        Distance from the nozzle's tip back to the filament's tip.
    feedrate_mm_min
        The last F; NaN if there was none.
    is_relative, is_e_relative
        True if G91, or M83, is in effect.
    """

    def __init__(self, program: Program, done_line_count: int) -> None:
        start = max(0, done_line_count - WINDOW_LINES)
        self.is_relative, self.is_e_relative = program.is_relative(start), program.is_e_relative(start)
        if self.is_relative or self.is_e_relative:  # the position is the sum of all previous lines
            self.is_relative = self.is_e_relative = False
            start = 0
        self.position_mm = [math.nan, math.nan, math.nan, math.nan if start else 0.0]
        self.retracted_mm = 0.0
        self.feedrate_mm_min = _find_feedrate_mm_min(program, start)
        # Start point, end point, and retraction of the filament at the start, in mm.
        self._moves: deque[tuple[list[float], list[float], float]] = deque(maxlen=BUFFERED_LINES)
        for first in range(start, done_line_count, WINDOW_LINES):  # limits the memory for a long file
            for line in program.read_lines(first, min(done_line_count, first + WINDOW_LINES)):
                self._apply_line(line)

    def _apply_line(self, line: bytes) -> None:
        if line.startswith(_MOVE_STARTS):
            self._apply_move(line)
        elif line.startswith(b"G92 "):
            for letter, value in _WORD.findall(line):
                if letter != b"F":
                    self._set_coordinate(_AXES[letter], float(value))
        elif line.split(b" ", 1)[0] == b"G28":  # earlier moves are complete
            self._moves.clear()
            self.position_mm[:3] = [math.nan] * 3
        elif line in (b"G90", b"G91"):
            self.is_relative = line == b"G91"
        elif line in (b"M82", b"M83"):
            self.is_e_relative = line == b"M83"

    def _apply_move(self, line: bytes) -> None:
        start_point = self.position_mm
        end_point = start_point.copy()
        for letter, value in _WORD.findall(line):
            if letter == b"F":
                if float(value) > 0:  # the firmware ignores other feed rates
                    self.feedrate_mm_min = float(value)
                continue
            axis = _AXES[letter]
            is_relative = self.is_relative or (axis == 3 and self.is_e_relative)
            end_point[axis] = float(value) + (start_point[axis] if is_relative else 0.0)
        self._moves.append((start_point, end_point, self.retracted_mm))
        self.position_mm = end_point
        fed_mm = end_point[3] - start_point[3]
        if not math.isnan(fed_mm):
            self.retracted_mm = max(0.0, self.retracted_mm - fed_mm)

    def _set_coordinate(self, axis: int, value: float) -> None:
        """Apply a G92: shift all coordinates, including the coordinates of buffered moves."""
        shift = value - self.position_mm[axis]
        self.position_mm = self.position_mm.copy()
        self.position_mm[axis] = value
        self._moves = deque(
            (
                (_shift_point(start_point, axis, shift), _shift_point(end_point, axis, shift), retracted_mm)
                for start_point, end_point, retracted_mm in self._moves
            ),
            BUFFERED_LINES,
        )

    def find_retraction_mm(self, stop_point: Point) -> float:
        """Compute `retracted_mm` at a stop in a buffered move; at the last line if no move passes there."""
        nearest_mm, found_mm = POSITION_TOLERANCE_MM, self.retracted_mm
        for start_point, end_point, retracted_mm in self._moves:
            distance_mm = _compute_distance_mm(stop_point, start_point, end_point)
            if distance_mm < nearest_mm:
                fed_mm = stop_point[3] - start_point[3]
                nearest_mm = distance_mm
                found_mm = retracted_mm if math.isnan(fed_mm) else max(0.0, retracted_mm - fed_mm)
        return found_mm


def _find_feedrate_mm_min(program: Program, line: int) -> float:
    """Find the last F before `line`; NaN if there was none."""
    while line > 0:
        start_line = max(0, line - WINDOW_LINES)
        for move in reversed(program.read_lines(start_line, line)):
            if move.startswith(_MOVE_STARTS) and (match := _FEEDRATE.search(move)) is not None:
                return float(match[1])
        line = start_line
    return math.nan


def _shift_point(point: list[float], axis: int, distance_mm: float) -> list[float]:
    return [value + distance_mm if index == axis else value for index, value in enumerate(point)]


def _compute_distance_mm(point: Point, start: Point, end: Point) -> float:
    """Compute the distance from a point to a line segment, over the axes that are known."""
    coordinates = [
        (p, b if math.isnan(a) else a, b)
        for p, a, b in zip(point, start, end, strict=True)
        if not math.isnan(b)
    ]
    squared_length_mm2 = sum((b - a) ** 2 for _, a, b in coordinates)
    fraction = (
        sum((p - a) * (b - a) for p, a, b in coordinates) / squared_length_mm2 if squared_length_mm2 else 0.0
    )
    fraction = min(max(fraction, 0.0), 1.0)
    return math.sqrt(sum((p - a - fraction * (b - a)) ** 2 for p, a, b in coordinates))
