"""G-code file prepared for sending, with the facts that a print needs in advance. Pure.

Comments and blank lines are removed: the firmware drops a line with a comment and the line after it.
A line that cannot be sent is refused, and the error gives its number (see `drivers.gcode.line`).
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

from drivers.errors import BadGcode, UnreadableFile
from drivers.gcode.line import Command, make_length_error, match_plain_move, quote, read_command, read_number
from drivers.gcode.timeline import Progress, Timeline
from drivers.printers import Profile

MAX_LINE_BYTES = 65536
"""Maximum length of a line with its comment; no slicer writes longer ones."""

_BLOCK_LINES = 256
_EXTRUDING_MOVE = re.compile(rb"G[0-3] [^E]*E")
_RISING_CODES = frozenset((b"G0", b"G1"))
_HEATING_CODES = frozenset((b"M104", b"M109", b"M140", b"M190"))
# Mode (0: axes, 1: E) that each command sets, and its value (0: absolute, 1: relative).
_MODES = {b"G90": (0, 0), b"G91": (0, 1), b"M82": (1, 0), b"M83": (1, 1)}
_MAX_LAYERS = 1e6
_MAX_PRINT_TIME_S = 1e8
_PEAK_STEP_MM = 1.0  # a spiral rises with every line: heights are stored in steps of this size


class HeaterName(StrEnum):
    """The two heaters of the printer."""

    NOZZLE = "nozzle"
    BED = "bed"


@dataclass(frozen=True, slots=True)
class HeatCommand:
    """A line that sets a temperature (M104, M140), or sets it and waits for it (M109, M190)."""

    line: int
    heater: HeaterName
    target_c: float
    waits: bool


class ProgramStore(Protocol):
    """Storage for the bytes of a program."""

    def write(self, data: bytes, /) -> object:
        """Append bytes."""

    def read(self, start: int, end: int, /) -> bytes:
        """Read bytes `start` to `end` (excluded). Raises OSError."""


class MemoryStore:
    """Store in memory."""

    def __init__(self) -> None:
        self._text = bytearray()

    def write(self, data: bytes) -> None:
        """Append bytes."""
        self._text += data

    def read(self, start: int, end: int) -> bytes:
        """Read bytes `start` to `end` (excluded)."""
        return bytes(self._text[start:end])


@dataclass(frozen=True, slots=True)
class Program:
    """The commands of a file as they are sent. Lines are numbered from 0.

    Attributes
    ----------
    store
        All lines, each with its newline.
    line_count
        Number of lines.
    offsets, checksums
        Byte offset of every 256th line in the store, and of the end of the store; the CRC-32 of each block
        of 256 lines.
    timeline
        Progress of the print at each line.
    heat_commands
        Lines that set a temperature.
    home_line
        Number of the first G28; `line_count` if there is none.
    extrusion_line
        Number of the first move with an E; `line_count` if there is none.
    """

    store: ProgramStore
    line_count: int
    offsets: array[int]
    checksums: array[int]
    timeline: Timeline
    heat_commands: tuple[HeatCommand, ...]
    home_line: int
    extrusion_line: int
    _relative_lines: array[int]  # lines at which G91 alternately takes effect and ends
    _relative_e_lines: array[int]  # the same for M83
    _peak_lines: array[int]  # lines that rise above all lines before them, and upper bounds of their heights
    _peaks_mm: array[float]

    @property
    def time_s(self) -> float:
        """Print time of the whole file, in seconds."""
        return self.timeline.time_s

    @property
    def layer_count(self) -> int:
        """Number of layers."""
        return self.timeline.layer_count

    def read_lines(self, start: int, stop: int) -> list[bytes]:
        """Read lines `start` to `stop` (excluded), without newlines.

        Raises
        ------
        UnreadableFile
            The store does not return the written bytes.
        """
        stop = min(stop, self.line_count)
        lines: list[bytes] = []
        if start >= stop:
            return lines
        first = start // _BLOCK_LINES
        for block in range(first, (stop - 1) // _BLOCK_LINES + 1):
            try:
                data = self.store.read(self.offsets[block], self.offsets[block + 1])
            except OSError as error:
                raise UnreadableFile(f"its copy cannot be read ({error.strerror}): check the disk") from error
            if crc32(data) != self.checksums[block]:
                raise UnreadableFile("its copy on the disk has changed: check the disk")
            lines += data.split(b"\n")[:-1]
        skip = first * _BLOCK_LINES
        return lines[start - skip : stop - skip]

    def compute_progress(self, line: int) -> Progress:
        """Compute the progress after `line` lines."""
        return self.timeline.compute_progress(line, self.line_count)

    def find_target_c(self, heater: HeaterName, line: int) -> float | None:
        """Find the target of a heater after `line` lines; None if it has none yet."""
        for heat in reversed(self.heat_commands):
            if heat.heater is heater and heat.line < line:
                return heat.target_c
        return None

    def compute_max_height_mm(self, line: int) -> float:
        """Compute an upper bound of the printed height after `line` lines, in steps of `_PEAK_STEP_MM`."""
        index = bisect_left(self._peak_lines, line)
        return self._peaks_mm[index - 1] if index else 0.0

    def is_relative(self, line: int) -> bool:
        """Return True if G91 is in effect after `line` lines."""
        return bisect_left(self._relative_lines, line) % 2 == 1

    def is_e_relative(self, line: int) -> bool:
        """Return True if M83 is in effect after `line` lines."""
        return bisect_left(self._relative_e_lines, line) % 2 == 1


def read_program(raw_lines: Iterable[bytes], profile: Profile, store: ProgramStore | None = None) -> Program:
    """Prepare a file for sending.

    Parameters
    ----------
    raw_lines
        Lines of the file, as read from a binary file.
    profile
        The printer's model.
    store
        Empty store for the lines in the form in which they are sent; None keeps them in memory.

    Returns
    -------
    Program
        The commands of the file, without comments and blank lines.

    Raises
    ------
    BadGcode
        A line cannot be sent, or the file is not meant for this printer.
    """
    reader = _Reader(profile, store or MemoryStore())
    limit_bytes, writer = profile.firmware.max_command_bytes, reader.writer
    for number, raw in enumerate(raw_lines, 1):
        if len(raw) > MAX_LINE_BYTES:
            raise make_length_error(raw, number, limit_bytes)
        line = raw.strip()
        if len(line) > limit_bytes or not match_plain_move(line):
            line = reader.read_line(line, number)
            if not line:
                continue
        if reader.extrusion_line < 0 and b"E" in line and _EXTRUDING_MOVE.match(line):
            reader.note_first_extrusion(number)
        writer.add(line)
    return reader.finish()


class _Reader:
    """Builder of a program from its file, line by line."""

    def __init__(self, profile: Profile, store: ProgramStore) -> None:
        self._profile = profile
        self.writer = _BlockWriter(store)
        self.extrusion_line = -1
        self._home_line = -1
        self._timeline = Timeline()
        self._heat_commands: list[HeatCommand] = []
        self._toggles = array("Q"), array("Q")
        self._peak_lines, self._peaks_mm = array("Q"), array("d")

    def read_line(self, line: bytes, number: int) -> bytes:
        """Convert a line that is not a plain move; return empty bytes if it is not sent. Raises BadGcode."""
        line, semicolon, comment = line.partition(b";")
        if semicolon:
            self._read_comment(comment, number)
        command = read_command(line, number, self._profile.firmware) if (line := line.rstrip()) else None
        if command is None:
            return b""
        self._note_command(command, number)
        return command.text

    def _note_command(self, command: Command, number: int) -> None:
        line_count = self.writer.line_count
        if command.name in _HEATING_CODES:
            self._heat_commands.append(_read_heat_command(command, number, line_count, self._profile))
        elif command.name in _MODES:
            mode, state = _MODES[command.name]
            if len(self._toggles[mode]) % 2 != state:
                self._toggles[mode].append(line_count)
        elif command.name == b"G28":
            self._home_line = line_count if self._home_line < 0 else self._home_line
        elif (z_mm := command.words.get(b"Z")) is not None and command.name in _RISING_CODES:
            self._timeline.set_layer_height(z_mm)
            if not len(self._toggles[0]) % 2 and z_mm > (self._peaks_mm[-1] if self._peaks_mm else 0.0):
                self._peak_lines.append(line_count)
                self._peaks_mm.append(z_mm + _PEAK_STEP_MM)

    def note_first_extrusion(self, number: int) -> None:
        """Note the first extruding move. Raises BadGcode if the nozzle is cold."""
        if not any(heat.waits and heat.heater is HeaterName.NOZZLE for heat in self._heat_commands):
            raise BadGcode(f"line {number}: extrudes before an M109: heat the nozzle first")
        self.extrusion_line = self.writer.line_count

    def _read_comment(self, comment: bytes, number: int) -> None:
        """Parse the slicer's comments on time, layer and feature. Raises BadGcode."""
        timeline, line_count = self._timeline, self.writer.line_count
        if comment.startswith(b"TIME_ELAPSED:"):
            timeline.add_time(line_count, read_number(comment[13:], number, _MAX_PRINT_TIME_S))
        elif comment.startswith(b"LAYER:"):
            timeline.add_layer(line_count, int(read_number(comment[6:], number, _MAX_LAYERS)))
        elif comment.startswith(b"TYPE:"):
            timeline.add_feature(line_count, comment[5:].rstrip().decode("ascii", "replace"))
        elif comment.startswith(b"FLAVOR:") and b"Marlin" not in comment:
            raise BadGcode(f"line {number}: {quote(comment[7:])} does not print over USB: slice for Marlin")

    def finish(self) -> Program:
        """Build the program. Raises BadGcode if it is empty."""
        writer, line_count = self.writer, self.writer.line_count
        if not line_count:
            raise BadGcode("line 1: the file contains no command")
        self._timeline.close()
        writer.close_block()
        return Program(
            store=writer.store,
            line_count=line_count,
            offsets=writer.offsets,
            checksums=writer.checksums,
            timeline=self._timeline,
            heat_commands=tuple(self._heat_commands),
            home_line=line_count if self._home_line < 0 else self._home_line,
            extrusion_line=line_count if self.extrusion_line < 0 else self.extrusion_line,
            _relative_lines=self._toggles[0],
            _relative_e_lines=self._toggles[1],
            _peak_lines=self._peak_lines,
            _peaks_mm=self._peaks_mm,
        )


class _BlockWriter:
    """Writer of lines to a store, in blocks of `_BLOCK_LINES`."""

    def __init__(self, store: ProgramStore) -> None:
        self.store = store
        self.line_count = 0
        self.offsets, self.checksums = array("Q", (0,)), array("L")
        self._block = bytearray()

    def add(self, line: bytes) -> None:
        self._block += line
        self._block += b"\n"
        self.line_count += 1
        if not self.line_count % _BLOCK_LINES:
            self.close_block()

    def close_block(self) -> None:
        """Write the lines since the last block."""
        if self._block:
            data = bytes(self._block)
            self._block.clear()
            self.store.write(data)
            self.offsets.append(self.offsets[-1] + len(data))
            self.checksums.append(crc32(data))


def _read_heat_command(command: Command, number: int, line_count: int, profile: Profile) -> HeatCommand:
    """Parse a heating line that follows `line_count` lines. Raises BadGcode."""
    target_c = command.words.get(b"S")
    if target_c is None or target_c < 0:
        raise BadGcode(f"line {number}: {quote(command.text)} has no temperature with S")
    heater = HeaterName.NOZZLE if command.name in (b"M104", b"M109") else HeaterName.BED
    limit_c = profile.max_nozzle_c if heater is HeaterName.NOZZLE else profile.max_bed_c
    if target_c > limit_c:
        raise BadGcode(f"line {number}: {target_c:g} C is too hot for the {heater}: at most {limit_c:g} C")
    return HeatCommand(line_count, heater, target_c, waits=command.name in (b"M109", b"M190"))
