"""A G-code file made ready for the wire, and what has to be known of it beforehand.

The firmware drops a line with a comment and swallows the next one, ends a line at ``:``, takes any ``N``
for a line number and any ``*`` for a checksum, and cuts lines after 94 characters (um2-serial section 1).
So comments and blank lines go here, and what cannot be sent is refused with the number of its line.
"""

from __future__ import annotations

import math
import re
from array import array
from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol
from zlib import crc32

from drivers.errors import BadGcode, Unreadable
from drivers.timeline import Mark, Timeline

COMMAND_BYTES = 80
"""What is left of the firmware's 94 for a command once ``N1234567 `` and ``*255`` are around it."""

_BLOCK_LINES = 256
_MOVE = re.compile(rb"G[01](?: [FXYE]-?[0-9.]+)+\Z")  # nearly every line, and nothing can be wrong with it
_CODE = re.compile(rb"([GMT])0*(\d+)")
_FEEDS = re.compile(rb"G0*[0-3](?!\d)[^E]*E")
_HEATS = frozenset((b"M104", b"M109", b"M140", b"M190"))
_RISES = re.compile(rb"G0*[01](?!\d)[^Z]*Z *(-?[0-9.]+)")
_TARGET = re.compile(rb"S(\d+(?:\.\d*)?)(?: |\Z)")
_MODES = {b"G90": (0, 0), b"G91": (0, 1), b"M82": (1, 0), b"M83": (1, 1)}  # of all axes, of E; relative
_MOST_LAYERS = 1_000_000
_PEAK_MM = 1.0  # a spiral rises with every line: its height is kept in steps of this
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


@dataclass(frozen=True, slots=True)
class Heat:
    """A line that sets a temperature (M104, M140) or also waits for it (M109, M190)."""

    line: int
    heater: HeaterName
    target_c: float
    waits: bool


class Store(Protocol):
    """Where the bytes of a program are kept."""

    def write(self, data: bytes, /) -> object:
        """Put more of them behind those that are there."""

    def read(self, start: int, end: int, /) -> bytes:
        """Bytes `start` to `end` (excluded). Raises OSError where they cannot be had."""


class Memory:
    """A store that is no file."""

    def __init__(self) -> None:
        self._text = bytearray()

    def write(self, data: bytes) -> None:
        self._text += data

    def read(self, start: int, end: int) -> bytes:
        return bytes(self._text[start:end])


@dataclass(frozen=True, slots=True)
class Program:
    """A stripped file. Lines count from 0.

    Attributes
    ----------
    store
        All lines, each with its newline.
    offsets, sums
        Where every 256th line starts in the store, and last where it ends; the CRC-32 of each such block.
    homes
        First G28; `count` where there is none.
    extrudes
        First move with an E; `count` where there is none.
    timeline
        How far the print is.
    heats
        Lines that set a temperature.
    """

    store: Store
    count: int
    offsets: array[int]
    sums: array[int]
    timeline: Timeline
    heats: tuple[Heat, ...]
    homes: int
    extrudes: int
    _relative: array[int]  # lines of which every second one begins a stretch under G91, the others end it
    _relative_e: array[int]  # the same of M83
    _peak_lines: array[int]
    _peaks_mm: array[float]

    @property
    def time_s(self) -> float:
        """Print time of the whole file, in seconds."""
        return self.timeline.time_s

    @property
    def layers(self) -> int:
        """How many layers there are."""
        return self.timeline.layers

    def lines(self, start: int, stop: int) -> list[bytes]:
        """Lines `start` to `stop` (excluded), without newlines.

        Raises
        ------
        Unreadable
            The store does not give them back as they were.
        """
        stop = min(stop, self.count)
        found: list[bytes] = []
        if start >= stop:
            return found
        first = start // _BLOCK_LINES
        for block in range(first, (stop - 1) // _BLOCK_LINES + 1):
            found += self._block(block).split(b"\n")[:-1]
        skip = first * _BLOCK_LINES
        return found[start - skip : stop - skip]

    def _block(self, block: int) -> bytes:
        try:
            data = self.store.read(self.offsets[block], self.offsets[block + 1])
        except OSError as error:
            raise Unreadable(f"its copy cannot be read ({error.strerror}): see to the disk") from error
        if crc32(data) != self.sums[block]:
            raise Unreadable("its copy on the disk is not what it was: see to the disk")
        return data

    def at(self, line: int) -> Mark:
        """How far the print is when `line` lines are done."""
        return self.timeline.at(line, self.count)

    def seconds_at(self, line: int) -> float:
        """Print time in seconds when `line` lines are done, by the slicer's clock."""
        return self.at(line).seconds

    def target_c(self, heater: HeaterName, line: int) -> float | None:
        """What a heater was last set to when `line` lines are done; None before the first."""
        for heat in reversed(self.heats):
            if heat.heater is heater and heat.line < line:
                return heat.target_c
        return None

    def highest_mm(self, line: int) -> float:
        """As high as the first `line` lines may have printed, to the next `_PEAK_MM` above."""
        at = bisect_left(self._peak_lines, line)
        return self._peaks_mm[at - 1] if at else 0.0

    def relative(self, line: int) -> bool:
        """Whether G91 is in force when `line` lines are done."""
        return bisect_left(self._relative, line) % 2 == 1

    def relative_e(self, line: int) -> bool:
        """Whether M83 is in force when `line` lines are done."""
        return bisect_left(self._relative_e, line) % 2 == 1


def strip(raw_lines: Iterable[bytes], store: Store | None = None) -> Program:
    """Make a file ready for the wire.

    Parameters
    ----------
    raw_lines
        The file's lines, as iterating a file opened in binary gives them.
    store
        Gets them as they go over the wire; empty so far.

    Raises
    ------
    BadGcode
        Where a line cannot be sent as it is, or the file is meant for another way of printing.
    """
    text = _Text(store or Memory())
    timeline = Timeline()
    heats: list[Heat] = []
    relative, relative_e = toggles = array("Q"), array("Q")
    peak_lines, peaks_mm = array("Q"), array("d")
    homes = extrudes = -1
    is_move = _MOVE.match
    for number, raw in enumerate(raw_lines, 1):
        line = raw.strip()
        count = text.count
        if len(line) > COMMAND_BYTES or not is_move(line):
            if b";" in line:
                line, _, comment = line.partition(b";")
                line = line.rstrip()
                if comment.startswith(b"TIME_ELAPSED:"):
                    timeline.elapsed(count, _number(comment[13:], number))
                elif comment.startswith(b"LAYER:"):
                    layer = int(_number(comment[6:], number))
                    if abs(layer) > _MOST_LAYERS:
                        raise BadGcode(f"line {number}: {_shown(comment[6:])} is no number of a layer")
                    timeline.layer(count, layer)
                elif comment.startswith(b"TYPE:"):
                    timeline.feature(count, comment[5:].rstrip().decode("ascii", "replace"))
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
                z_mm = _number(rises[1], number)
                timeline.height(z_mm)
                if not len(relative) % 2 and z_mm > (peaks_mm[-1] if peaks_mm else 0.0):
                    peak_lines.append(count)
                    peaks_mm.append(z_mm + _PEAK_MM)
            elif line in _MODES:
                mode, on = _MODES[line]
                if len(toggles[mode]) % 2 != on:
                    toggles[mode].append(count)
        if extrudes < 0 and b"E" in line and _FEEDS.match(line):
            if not any(heat.waits and heat.heater is HeaterName.NOZZLE for heat in heats):
                raise BadGcode(f"line {number}: extrudes before an M109: heat the nozzle first")
            extrudes = count
        text.add(line)
    if not text.count:
        raise BadGcode("line 1: the file has no command in it")
    timeline.close()
    text.close()
    return Program(
        store=text.store,
        count=text.count,
        offsets=text.offsets,
        sums=text.sums,
        timeline=timeline,
        heats=tuple(heats),
        homes=text.count if homes < 0 else homes,
        extrudes=text.count if extrudes < 0 else extrudes,
        _relative=relative,
        _relative_e=relative_e,
        _peak_lines=peak_lines,
        _peaks_mm=peaks_mm,
    )


class _Text:
    """The lines of a file on their way to its store, in blocks."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.count = 0
        self.offsets, self.sums = array("Q", (0,)), array("L")
        self._block = bytearray()

    def add(self, line: bytes) -> None:
        self._block += line
        self._block += b"\n"
        self.count += 1
        if not self.count % _BLOCK_LINES:
            self.close()

    def close(self) -> None:
        """Keep what is there as a block."""
        if self._block:
            data = bytes(self._block)
            self._block.clear()
            self.store.write(data)
            self.offsets.append(self.offsets[-1] + len(data))
            self.sums.append(crc32(data))


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
