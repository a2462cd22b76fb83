"""Rewriting of G-code in which some moves are replaced by others."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slicing.checks import MotionLimits, Toolpath, change_times
from slicing.checks.section import Floats
from slicing.glued_parts.sides import Bools
from slicing.settings import EngineSettings

MOVE_LINE = re.compile(rb"(?m)^G[01] [^\n]*\n")
_WORDS = {letter: re.compile(rb" %b[-+.\d]+" % letter) for letter in (b"E", b"F")}
_E_ROUNDING_MM = 5e-6


@dataclass(frozen=True, slots=True)
class Segment:
    """New move to a point in printer coordinates, and the filament that it extrudes per mm of its length.

    `feature` is CuraEngine's name of the feature that begins with it; empty if the feature is the former one.
    """

    x_mm: float
    y_mm: float
    feed_mm_min: float
    extruded_per_mm: float = 0.0
    feature: str = ""


def replace_moves(gcode: bytes, path: Toolpath, segments: Mapping[int, Sequence[Segment]]) -> bytes:
    """Replace moves of a file, and correct E in the lines after them.

    Parameters
    ----------
    gcode
        G-code with one move in each line; relative moves, such as those at its end, are not changed.
    path
        Moves and comments of the same file.
    segments
        New moves, by the number of the level move that they replace; an empty sequence skips that move.
    """
    lines = [match.span() for match in MOVE_LINE.finditer(gcode)]
    assert len(lines) == len(path.layer), "CuraEngine writes each move as G0 or G1"
    assert _is_replaceable(path)[list(segments)].all(), "moves of the feeder and of Z are not replaced"
    resets = {
        command.next_move for command in path.commands if command.code == "G92" and "E" in command.words
    }
    is_relative = _find_relative_moves(path)
    extruded_mm = path.extruded_mm
    pieces: list[bytes] = []
    offset = 0
    e_mm = feed_mm_min = x_mm = y_mm = 0.0  # position after the new lines so far
    for move, (line_start, next_line_start) in enumerate(lines):
        if move == 0 or move in resets:
            e_mm = float(path.start[move, 3])
        line = gcode[line_start:next_line_start]
        new_segments = segments.get(move)
        if new_segments is None:
            e_mm += float(extruded_mm[move])
            new_line = line
            if not is_relative[move] and abs(e_mm - path.end[move, 3]) > _E_ROUNDING_MM:
                new_line = _WORDS[b"E"].sub(b" E%.5f" % e_mm, new_line)
            if feed_mm_min != path.feed_mm_min[move] and not _WORDS[b"F"].search(new_line):
                new_line = b"%b F%.6g%b" % (new_line[:2], path.feed_mm_min[move], new_line[2:])
            x_mm, y_mm = float(path.end[move, 0]), float(path.end[move, 1])
            feed_mm_min = float(path.feed_mm_min[move])
        else:
            new_line = b""
            for segment in new_segments:
                code, extrusion = b"G0", b""
                if segment.extruded_per_mm > 0.0:
                    length_mm = math.hypot(segment.x_mm - x_mm, segment.y_mm - y_mm)
                    e_mm += segment.extruded_per_mm * length_mm
                    code, extrusion = b"G1", b" E%.5f" % e_mm
                x_mm, y_mm, feed_mm_min = segment.x_mm, segment.y_mm, segment.feed_mm_min
                if segment.feature:
                    new_line += b";TYPE:%b\n" % segment.feature.encode()
                new_line += b"%b F%.6g X%.3f Y%.3f%b\n" % (code, feed_mm_min, x_mm, y_mm, extrusion)
        if new_line != line:
            pieces += [gcode[offset:line_start], new_line]
            offset = next_line_start
    return b"".join((*pieces, gcode[offset:]))


def change_moves(
    gcode: bytes, path: Toolpath, segments: Mapping[int, Sequence[Segment]], settings: EngineSettings
) -> bytes:
    """Replace moves of a file as in `replace_moves`, and correct the times in its comments.

    Parameters
    ----------
    gcode, path, segments
        As in `replace_moves`.
    settings
        Settings with which it was sliced.

    Returns
    -------
    bytes
        The changed G-code; the same object if there are no segments.

    Raises
    ------
    SliceRejected
        `FLAVOUR` if the changed file cannot be read; see `read_toolpath`.
    """
    if not segments:
        return gcode
    new_gcode = replace_moves(gcode, path, segments)
    return change_times(new_gcode, path, MotionLimits.from_settings(settings.global_))


def measure_lengths_mm(path: Toolpath) -> Floats:
    """Measure the length (n,) of each move in the plane of its layer, in mm."""
    return np.asarray(np.hypot(*(path.end - path.start)[:, :2].T))


def measure_extrusion_per_mm(path: Toolpath) -> Floats:
    """Measure the filament (n,) in mm that each move extrudes for each mm of its length."""
    return np.asarray(path.extruded_mm / np.maximum(measure_lengths_mm(path), 1e-9))


def _is_replaceable(path: Toolpath) -> Bools:
    """Mark the moves (n,) at constant Z, except those of the feeder alone and those with a retraction."""
    is_level = path.end[:, 2] == path.start[:, 2]
    extruded_mm = path.extruded_mm
    return np.asarray(is_level & ((extruded_mm == 0.0) | (path.is_head_move & (extruded_mm > 0.0))))


def _find_relative_moves(path: Toolpath) -> Bools:
    """Mark the moves (n,) whose coordinates, or whose extrusion, are relative."""
    is_relative = np.zeros(len(path.layer), np.bool_)
    modes = dict.fromkeys(("G91", "M83"), False)
    for command in path.commands:
        if command.code in ("G90", "G91"):
            modes["G91"] = command.code == "G91"
        elif command.code in ("M82", "M83"):
            modes["M83"] = command.code == "M83"
        else:
            continue
        is_relative[command.next_move :] = any(modes.values())
    return is_relative
