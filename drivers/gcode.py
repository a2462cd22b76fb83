"""A G-code file made ready for the wire, and what has to be known of it beforehand.

The firmware drops a line with a comment and swallows the next one, ends a line at ``:``, takes any ``N``
for a line number and any ``*`` for a checksum, and cuts lines after 94 characters (um2-serial section 1).
So comments and blank lines go here, and what cannot be sent is refused with the number of its line.
"""

from __future__ import annotations

import math
import re
from array import array
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from drivers.errors import BadGcode

COMMAND_BYTES = 80
"""What is left of the firmware's 94 for a command once ``N1234567 `` and ``*255`` are around it."""

_BLOCK_LINES = 256
_MOVE = re.compile(rb"G[01](?: [FXYE]-?[0-9.]+)+\Z")  # nearly every line, and nothing can be wrong with it
_CODE = re.compile(rb"([GMT])0*(\d+)")
_FEEDS = re.compile(rb"G0*[0-3](?!\d)[^E]*E")
_HEATS = frozenset((b"M104", b"M109", b"M140", b"M190"))
_RISES = re.compile(rb"G0*[01](?!\d)[^Z]*Z *(-?[0-9.]+)")
_TARGET = re.compile(rb"S(\d+(?:\.\d*)?)(?: |\Z)")
_NEEDLESS = frozenset((b"M105", b"M117"))  # the link asks; a text is read as commands
_NEVER = {
    b"M0": "waits for the knob for ever",
    b"M1": "waits for the knob for ever",
    b"M25": "belongs to the SD card",
    b"M28": "belongs to the SD card",
    b"M112": "does not exist in this firmware",
    b"M303": "heats as it likes",
    b"M600": "does not exist in this firmware",
    b"M999": "restarts a board that stopped for a reason",
    b"M85": "is the farm's dead-man",
    b"M110": "is the link's line number",
    b"G10": "retracts by the printer's own settings, not by the file's",
    b"G11": "retracts by the printer's own settings, not by the file's",
}


class HeaterName(StrEnum):
    """The two heaters of the printer."""

    NOZZLE = "nozzle"
    BED = "bed"


MOST_C = {HeaterName.NOZZLE: 260.0, HeaterName.BED: 115.0}  # the firmware stops above 275 and 130


class Feature(StrEnum):
    """What a move prints, by the names of Cura's ``;TYPE:`` comments."""

    SKIRT = "SKIRT"  # a brim too
    SUPPORT = "SUPPORT"
    SUPPORT_INTERFACE = "SUPPORT-INTERFACE"
    WALL_OUTER = "WALL-OUTER"
    WALL_INNER = "WALL-INNER"
    SKIN = "SKIN"
    FILL = "FILL"
    PRIME_TOWER = "PRIME-TOWER"


_FEATURES = {feature.value.encode(): feature for feature in Feature}


@dataclass(frozen=True, slots=True)
class Mark:
    """How far a print is from a line on (0-based, of the stripped file).

    Attributes
    ----------
    seconds
        Print time, by the slicer's clock: without heating, homing, start and end.
    layer
        From 0, as the file counts; None before the first.
    z_mm
        The layer's height; 0 before the first.
    feature
        What is printed; None where the file does not say.
    """

    line: int
    seconds: float
    layer: int | None = None
    z_mm: float = 0.0
    feature: Feature | None = None


@dataclass(frozen=True, slots=True)
class Heat:
    """A line that sets a temperature (M104, M140) or also waits for it (M109, M190)."""

    line: int
    heater: HeaterName
    target_c: float
    waits: bool


@dataclass(frozen=True, slots=True)
class Program:
    """A stripped file. Lines count from 0.

    Attributes
    ----------
    text
        All lines, each with its newline.
    offsets
        Where every 256th line starts in `text`.
    homes
        First G28; `count` where there is none.
    extrudes
        First move with an E; `count` where there is none.
    timeline
        Rising in line and seconds; time between two marks passes evenly over the lines.
    layers
        How many there are.
    """

    text: bytes
    count: int
    offsets: array[int]
    timeline: tuple[Mark, ...]
    heats: tuple[Heat, ...]
    homes: int
    extrudes: int
    time_s: float
    layers: int

    def lines(self, start: int, stop: int) -> list[bytes]:
        """Lines `start` to `stop` (excluded), without newlines."""
        stop = min(stop, self.count)
        if start >= stop:
            return []
        first, last = start // _BLOCK_LINES, (stop - 1) // _BLOCK_LINES + 1
        end = self.offsets[last] if last < len(self.offsets) else len(self.text)
        block = self.text[self.offsets[first] : end].split(b"\n")
        skip = first * _BLOCK_LINES
        return block[start - skip : stop - skip]

    def at(self, line: int) -> Mark:
        """How far the print is when `line` lines are done."""
        at = bisect_right(self.timeline, line, key=lambda mark: mark.line)
        before = self.timeline[at - 1] if at else Mark(0, 0.0)
        if line >= self.count or at == len(self.timeline):
            return replace(before, line=line, seconds=self.time_s if line >= self.count else before.seconds)
        after = self.timeline[at]
        share = (line - before.line) / (after.line - before.line)
        return replace(before, line=line, seconds=before.seconds + share * (after.seconds - before.seconds))

    def seconds_at(self, line: int) -> float:
        """Print time in seconds when `line` lines are done, by the slicer's clock."""
        return self.at(line).seconds

    def target_c(self, heater: HeaterName, line: int) -> float | None:
        """What a heater was last set to when `line` lines are done; None before the first."""
        for heat in reversed(self.heats):
            if heat.heater is heater and heat.line < line:
                return heat.target_c
        return None


def strip(raw_lines: Iterable[bytes]) -> Program:
    """Make a file ready for the wire.

    Parameters
    ----------
    raw_lines
        The file's lines, as iterating a file opened in binary gives them.

    Raises
    ------
    BadGcode
        Where a line cannot be sent as it is, or the file is meant for another way of printing.
    """
    text = bytearray()
    offsets = array("Q")
    timeline = _Timeline()
    heats: list[Heat] = []
    count = 0
    homes = extrudes = -1
    is_move = _MOVE.match
    for number, raw in enumerate(raw_lines, 1):
        line = raw.strip()
        if len(line) > COMMAND_BYTES or not is_move(line):
            if b";" in line:
                line, _, comment = line.partition(b";")
                line = line.rstrip()
                if comment.startswith(b"TIME_ELAPSED:"):
                    timeline.elapsed(count, _number(comment[13:], number))
                elif comment.startswith(b"LAYER:"):
                    timeline.layer(count, int(_number(comment[6:], number)))
                elif comment.startswith(b"TYPE:"):
                    timeline.feature(count, _FEATURES.get(comment[5:].rstrip()))
                elif comment.startswith(b"FLAVOR:") and b"Marlin" not in comment:
                    raise BadGcode(
                        f"line {number}: {_shown(comment[7:])} does not print over USB: slice for Marlin"
                    )
            if not line or line.split(b" ", 1)[0] in _NEEDLESS:
                continue
            heat = _check(line, number, count)
            if heat is not None:
                heats.append(heat)
            if homes < 0 and line.startswith(b"G28"):
                homes = count
            elif (rises := _RISES.match(line)) is not None:
                timeline.height(_number(rises[1], number))
        if extrudes < 0 and b"E" in line and _FEEDS.match(line):
            if not any(heat.waits and heat.heater is HeaterName.NOZZLE for heat in heats):
                raise BadGcode(f"line {number}: extrudes before an M109: heat the nozzle first")
            extrudes = count
        if not count % _BLOCK_LINES:
            offsets.append(len(text))
        text += line
        text += b"\n"
        count += 1
    if not count:
        raise BadGcode("line 1: the file has no command in it")
    return Program(
        text=bytes(text),
        count=count,
        offsets=offsets,
        timeline=timeline.marks(),
        heats=tuple(heats),
        homes=count if homes < 0 else homes,
        extrudes=count if extrudes < 0 else extrudes,
        time_s=timeline.time_s,
        layers=timeline.layers,
    )


class _Timeline:
    """The marks of a file, gathered from its comments; seconds are NaN where it does not say them."""

    def __init__(self) -> None:
        self.time_s = 0.0
        self.layers = 0
        self._lines: list[int] = []
        self._seconds: list[float] = []
        self._states: list[tuple[int | None, float, Feature | None]] = []  # layer, height, feature
        self._layer: int | None = None
        self._z_mm = 0.0
        self._feature: Feature | None = None

    def elapsed(self, line: int, seconds: float) -> None:
        self.time_s = max(self.time_s, seconds)
        self._mark(line, self.time_s)

    def layer(self, line: int, layer: int) -> None:
        self.layers = max(self.layers, layer + 1)
        self._layer, self._feature = layer, None
        self._mark(line, math.nan if self._lines else 0.0)  # the slicer's clock starts at the first

    def feature(self, line: int, feature: Feature | None) -> None:
        self._feature = feature
        self._mark(line, math.nan)

    def height(self, z_mm: float) -> None:
        """A move names its height; a layer's is named before its first feature."""
        self._z_mm = z_mm
        if self._states and self._feature is None:
            self._states[-1] = (self._layer, z_mm, None)

    def _mark(self, line: int, seconds: float) -> None:
        state = (self._layer, self._z_mm, self._feature)
        if self._lines and self._lines[-1] == line:
            self._states[-1] = state
            if not math.isnan(seconds):
                self._seconds[-1] = seconds
            return
        self._lines.append(line)
        self._seconds.append(seconds)
        self._states.append(state)

    def marks(self) -> tuple[Mark, ...]:
        """All of them, with seconds by the lines where the file does not say them."""
        seconds = self._seconds
        before = (0, 0.0)
        unknown: list[int] = []
        for i, line in enumerate(self._lines):
            if math.isnan(seconds[i]):
                unknown.append(i)
                continue
            for j in unknown:
                share = (self._lines[j] - before[0]) / (line - before[0])
                seconds[j] = before[1] + share * (seconds[i] - before[1])
            unknown.clear()
            before = (line, seconds[i])
        for j in unknown:
            seconds[j] = before[1]
        return tuple(
            Mark(line, at_s, *state)
            for line, at_s, state in zip(self._lines, seconds, self._states, strict=True)
        )


def _check(line: bytes, number: int, count: int) -> Heat | None:
    """Refuse what the firmware would misread; give back what a heating line sets."""
    if len(line) > COMMAND_BYTES:
        raise BadGcode(
            f"line {number}: {len(line)} characters, and the printer takes {COMMAND_BYTES}: shorten it"
        )
    for letter in b":N*":
        if letter in line:
            raise BadGcode(
                f"line {number}: the printer misreads a {chr(letter)!r}: take it out of {_shown(line)}"
            )
    if not (line.isascii() and line.decode("ascii").isprintable()):
        raise BadGcode(f"line {number}: not plain text: is this a G-code file?")
    code = _CODE.match(line)
    if code is None:
        raise BadGcode(f"line {number}: no command that the printer knows: {_shown(line)}")
    name = code[1] + code[2]
    if (why := _NEVER.get(name)) is not None:
        raise BadGcode(f"line {number}: {name.decode()} {why}: take it out")
    if name not in _HEATS:
        return None
    target = _TARGET.search(line)
    if target is None:
        raise BadGcode(f"line {number}: {_shown(line)} names no temperature with S")
    heater = HeaterName.NOZZLE if name in (b"M104", b"M109") else HeaterName.BED
    target_c = float(target[1])
    if target_c > MOST_C[heater]:
        raise BadGcode(
            f"line {number}: {target_c:g} degrees are too many for the {heater}: at most {MOST_C[heater]:g}"
        )
    return Heat(count, heater, target_c, waits=name in (b"M109", b"M190"))


def _number(text: bytes, number: int) -> float:
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise BadGcode(f"line {number}: {_shown(text)} is no number")
    return found


def _shown(text: bytes) -> str:
    return repr(text[:40].decode("ascii", "replace"))
