"""A G-code file made ready for the wire, and what has to be known of it beforehand.

Comments and blank lines go here, as the firmware drops a line with a comment and swallows the next one; what
cannot be sent is refused with the number of its line (`command`).
"""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol
from zlib import crc32

from drivers.errors import BadGcode, Unreadable
from drivers.gcode.command import Command, is_everyday, read, shown, too_long, value
from drivers.gcode.timeline import Mark, Timeline
from drivers.printers import Profile

LONGEST_LINE_BYTES = 65536
"""With its comment: no slicer writes one that is longer."""

_BLOCK_LINES = 256
_FEEDS = re.compile(rb"G[0-3] [^E]*E")
_RISES = frozenset((b"G0", b"G1"))
_HEATS = frozenset((b"M104", b"M109", b"M140", b"M190"))
_MODES = {b"G90": (0, 0), b"G91": (0, 1), b"M82": (1, 0), b"M83": (1, 1)}  # of all axes, of E; relative
_MOST_LAYERS = 1e6
_MOST_S = 1e8
_PEAK_MM = 1.0  # a spiral rises with every line: its height is kept in steps of this


class HeaterName(StrEnum):
    """The two heaters of the printer."""

    NOZZLE = "nozzle"
    BED = "bed"


@dataclass(frozen=True, slots=True)
class Heat:
    """A line that sets a temperature (M104, M140) or also waits for it (M109, M190)."""

    line: int
    heater: HeaterName
    target_c: float
    waits: bool


class Store(Protocol):
    """Storage of the bytes of a program."""

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
        """Number of layers."""
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
        """Compute the progress when `line` lines are done."""
        return self.timeline.at(line, self.count)

    def target_c(self, heater: HeaterName, line: int) -> float | None:
        """Target of a heater when `line` lines are done; None before the first."""
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


def strip(raw_lines: Iterable[bytes], profile: Profile, store: Store | None = None) -> Program:
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
    firmware, most_bytes = profile.firmware, profile.firmware.command_bytes
    text = _Text(store or Memory())
    timeline = Timeline()
    heats: list[Heat] = []
    relative, relative_e = toggles = array("Q"), array("Q")
    peak_lines, peaks_mm = array("Q"), array("d")
    homes = extrudes = -1
    for number, raw in enumerate(raw_lines, 1):
        if len(raw) > LONGEST_LINE_BYTES:
            raise too_long(raw, number, most_bytes)
        line = raw.strip()
        count = text.count
        if len(line) > most_bytes or not is_everyday(line):
            line, semicolon, comment = line.partition(b";")
            if semicolon:
                _note(comment, number, count, timeline)
            command = read(line, number, firmware) if (line := line.rstrip()) else None
            if command is None:
                continue
            line = command.text
            if command.name in _HEATS:
                heats.append(_heat(command, number, count, profile))
            elif command.name in _MODES:
                mode, on = _MODES[command.name]
                if len(toggles[mode]) % 2 != on:
                    toggles[mode].append(count)
            elif command.name == b"G28":
                homes = count if homes < 0 else homes
            elif (z_mm := command.words.get(b"Z")) is not None and command.name in _RISES:
                timeline.height(z_mm)
                if not len(relative) % 2 and z_mm > (peaks_mm[-1] if peaks_mm else 0.0):
                    peak_lines.append(count)
                    peaks_mm.append(z_mm + _PEAK_MM)
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


def _note(comment: bytes, number: int, count: int, timeline: Timeline) -> None:
    """Take what a slicer's comment says of the print; `count` lines are before it."""
    if comment.startswith(b"TIME_ELAPSED:"):
        timeline.elapsed(count, value(comment[13:], number, _MOST_S))
    elif comment.startswith(b"LAYER:"):
        timeline.layer(count, int(value(comment[6:], number, _MOST_LAYERS)))
    elif comment.startswith(b"TYPE:"):
        timeline.feature(count, comment[5:].rstrip().decode("ascii", "replace"))
    elif comment.startswith(b"FLAVOR:") and b"Marlin" not in comment:
        raise BadGcode(f"line {number}: {shown(comment[7:])} does not print over USB: slice for Marlin")


def _heat(command: Command, number: int, count: int, profile: Profile) -> Heat:
    """Read what a heating line sets. Raises BadGcode."""
    target_c = command.words.get(b"S")
    if target_c is None or target_c < 0:
        raise BadGcode(f"line {number}: {shown(command.text)} names no temperature with S")
    heater = HeaterName.NOZZLE if command.name in (b"M104", b"M109") else HeaterName.BED
    most_c = profile.max_nozzle_c if heater is HeaterName.NOZZLE else profile.max_bed_c
    if target_c > most_c:
        raise BadGcode(
            f"line {number}: {target_c:g} degrees are too many for the {heater}: at most {most_c:g}"
        )
    return Heat(count, heater, target_c, waits=command.name in (b"M109", b"M190"))
