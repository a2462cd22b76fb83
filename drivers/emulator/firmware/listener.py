"""The firmware's ``get_command``: split bytes into lines, check these, acknowledge or refuse them. Pure.

A refused line empties the ring buffer, and its number is requested again. The Ultimaker 2 acknowledges moves
when they are read, other commands after execution (docs/explanation/ultimaker2-serial.md, section 1.4). A
line also ends after 95 characters. In the Ultimaker 2, it also ends at a ``:``, and a ``;`` drops its line
and the next one (section 1.5).
"""

from __future__ import annotations

import math
import random
import re
from abc import ABC, abstractmethod
from collections import deque
from enum import StrEnum

from drivers.emulator.faults import Faults, FaultSampler
from drivers.emulator.firmware import wording
from drivers.emulator.firmware.dialects.dialect import Dialect
from drivers.emulator.firmware.machine import Machine, read_value
from drivers.emulator.firmware.planner import CAPACITY
from drivers.emulator.hardware.noise import Noise
from drivers.gcode import compute_checksum

RING_BYTES = 127
MAX_LINE_BYTES = 95
_COMMAND = re.compile(rb"[GMT]")
_WHOLE_NUMBER = re.compile(rb"[ \t]*([-+]?\d+)")
# A complete numbered move as slicers write it; `add_frame` may have doubled a blank. Used by the fast path.
_MOVE = re.compile(
    rb"N(\d+) ?G[01](?:  ?F(\d+\.?\d*))?"
    + b"".join(rb"(?:  ?%b(-?(?:\d+\.?\d*|\.\d+)))?" % axis for axis in (b"X", b"Y", b"Z", b"E"))
    + rb"\*(\d+)\n"
)
_SPECIAL_CHARACTER_PATTERN = re.compile(rb"[\r:;]")


class Phase(StrEnum):
    """Phase of the board's processor."""

    BOOTLOADER = "bootloader"  # bytes are lost
    BOOTING = "booting"  # bytes wait in the ring buffer
    RUNNING = "running"
    HALTED = "halted"  # kill(): waits for a reset by the watchdog or by the host
    MUTE = "mute"  # a fault: reads and sends nothing, and keeps heating


class Listener(ABC):
    """Reader of the lines that the host sends to the board, from one reset to the next.

    Parameters
    ----------
    dialect
        Behaviour of this firmware.
    faults
        Faults to inject.
    rng
        Random generator of the faults.

    Attributes
    ----------
    line_count, error_count
        Number of accepted lines, and of errors, since power-on.
    noise
        Noise on the wire, if any.
    """

    machine: Machine

    def __init__(self, dialect: Dialect, faults: Faults, rng: random.Random) -> None:
        self.dialect = dialect
        self.line_count = 0
        self.error_count = 0
        self.noise = Noise(faults, rng) if faults.affects_bytes else None
        self.phase = Phase.BOOTLOADER
        self._faults = faults
        self._affects_lines = faults.affects_lines
        self._sampler = FaultSampler(faults, rng)
        self._output: list[bytes] = []
        self._time_s = 0.0  # time that the main loop has reached
        self._drop_input()

    def _drop_input(self) -> None:
        """Drop all received input, at a reset."""
        self._receiver = Receiver(self.dialect.line_ends, self.dialect.comment_spans_lines)
        self._number = 0  # number of the line being executed
        self._is_ok_pending = False  # a move waits for a free place in the planner before its ok
        self._busy_message_s = math.inf  # time of the next busy message
        self._buffer: deque[bytes] = deque()
        self._last_number = 0
        self._stuck_number = -1  # line that is requested endlessly
        if self.noise is not None:
            self.noise.forget_lines()

    @abstractmethod
    def _is_busy(self) -> bool:
        """Return True while a command is executed."""

    @abstractmethod
    def _trigger_due_faults(self) -> None:
        """Trigger the faults that are due after an accepted line."""

    # --- lines ---

    def _read_plain_move(self) -> bool:
        """Read a well-formed numbered move as the slow path would; return False if that path is needed."""
        receiver = self._receiver
        move = receiver.match_move()
        if move is None or self._affects_lines:
            return False
        n, f, x, y, z, e, check = move.groups()
        machine = self.machine
        if (
            int(n) != self._last_number + 1
            or machine.is_stopped
            or compute_checksum(receiver.ring[: move.start(7) - 1]) != int(check)
        ):
            return False
        receiver.ring = receiver.ring[move.end() :]
        self._last_number += 1
        self.line_count += 1
        if self.noise is not None:
            self.noise.check_accepted_line(self._last_number, move[0])
        if self.dialect.acknowledges_read_moves:
            self._output.append(wording.OK)
        machine.planner.advance(self._time_s)
        machine.queue_linear_move(
            None if f is None else float(f),
            None if x is None else float(x),
            None if y is None else float(y),
            None if z is None else float(z),
            None if e is None else float(e),
            self._time_s,
        )
        machine.last_command_at_s = self._time_s
        if not self.dialect.acknowledges_read_moves:
            self._end_move(self._last_number)
        return True

    def _end_move(self, number: int) -> None:
        """Acknowledge a move if it is in the planner; otherwise leave its ok pending."""
        self._number = number
        self._busy_message_s = self._time_s + self.machine.keep_alive_interval_s
        if self.machine.waiting_moves:
            self._is_ok_pending = True
        else:
            self._acknowledge()

    def _get_command(self) -> None:
        """Fill the line buffer from the ring buffer."""
        capacity = self.dialect.buffer_lines - (self.dialect.reads_while_busy and self._is_busy())
        while len(self._buffer) < capacity and self.phase is Phase.RUNNING:
            line = self._receiver.take_line()
            if line is None:
                return
            self._accept_line(line)

    def _accept_line(self, line: bytes) -> None:
        """Check number and checksum, and buffer the line or refuse it."""
        if self._affects_lines:
            if self._sampler.swallows_line():
                return
            line = self._sampler.disturb_line(line)
        line = line.partition(b"\0")[0]
        star = line.find(b"*")
        if b"N" in line:
            match = _WHOLE_NUMBER.match(line, line.find(b"N") + 1)
            n = int(match[1]) if match else 0
            if n != self._last_number + 1 and b"M110" not in line:
                self._refuse_line(wording.WRONG_LINE_NUMBER)
                return
            if star < 0:
                self._refuse_line(wording.NO_CHECKSUM)
                return
            if int(read_value(line, b"*") or 0.0) != compute_checksum(line[:star]):
                self._refuse_line(wording.WRONG_CHECKSUM)
                return
            if (n == self._stuck_number or self._sampler.refuses_line()) and b"M110" not in line:
                self._refuse_line(wording.WRONG_CHECKSUM)
                return
            self._last_number = n
            if self.noise is not None:
                self.noise.check_accepted_line(n, line)
        elif star >= 0 and self.dialect.checksum_needs_number:
            # Without a command, the line is a query.
            report = self._report_error if _COMMAND.search(line) else self._send
            report(wording.format_line_error(wording.NO_LINE_NUMBER, self._last_number))
            return
        elif (command := self.dialect.urgent_commands.get(int(read_value(line, b"M") or 0))) is not None:
            command(self.machine, self._time_s)
            if self.phase is not Phase.RUNNING:
                return
        if _is_move(line):
            if self.machine.is_stopped:
                self._send(wording.STOPPED_MESSAGE)
            elif self.dialect.acknowledges_read_moves:
                self._acknowledge()
        self._buffer.append(line)
        self.line_count += 1
        if self._affects_lines:
            self._trigger_due_faults()

    def _refuse_line(self, reason: bytes) -> None:
        self._report_error(wording.format_line_error(reason, self._last_number))
        self._request_resend()

    def _request_resend(self) -> None:
        self._receiver.flush()
        self._send(b"Resend: %d\n" % (self._last_number + 1))
        if not self._faults.mute_resend:
            self.machine.last_command_at_s = max(self.machine.last_command_at_s, self._time_s)
            self._send(self._sampler.garble_ok(wording.OK))

    # --- messages ---

    def _send(self, text: bytes) -> None:
        self._output.append(text)

    def _finish_command(self) -> None:
        """Acknowledge a finished command (``ClearToSend``)."""
        self.machine.last_command_at_s = max(self.machine.last_command_at_s, self._time_s)
        self._acknowledge()

    def _acknowledge(self) -> None:
        text = wording.OK
        if self._faults.advanced_ok and self.dialect.advanced_ok:
            free = (
                max(0, CAPACITY - 1 - len(self.machine.planner)),
                self.dialect.buffer_lines - len(self._buffer),
            )
            text = b"ok N%d P%d B%d\n" % (self._number, *free)
        self._send(self._sampler.garble_ok(text))

    def _report_error(self, text: bytes) -> None:
        self.error_count += 1
        self._send(text)


def _is_move(line: bytes) -> bool:
    code = read_value(line, b"G")
    return code is not None and 0 <= int(code) <= 3


class Receiver:
    """Ring buffer and incomplete line; see `Dialect` for the parameters."""

    __slots__ = ("_comment_spans_lines", "_is_in_comment", "_line_ends", "_partial_line", "ring")

    def __init__(self, line_ends: bytes, comment_spans_lines: bool) -> None:
        self.ring = b""
        self._line_ends = line_ends
        self._comment_spans_lines = comment_spans_lines
        self._partial_line = b""
        self._is_in_comment = False

    def put(self, data: bytes) -> bytes:
        """Store the bytes that fit, and return the rest."""
        free_bytes = RING_BYTES - len(self.ring)
        self.ring += data[:free_bytes]
        return data[free_bytes:]

    def flush(self) -> None:
        """Empty the ring buffer, as the firmware does at each error."""
        self.ring = b""

    def match_move(self) -> re.Match[bytes] | None:
        """Match a well-formed numbered move at the front without removing it: N, F, X, Y, Z, E, checksum."""
        if self._partial_line or self._is_in_comment:
            return None
        match = _MOVE.match(self.ring)
        return match if match is not None and match.end() <= MAX_LINE_BYTES else None

    def take_line(self) -> bytes | None:
        """Remove the next line and return it without its line end; None if no line is complete."""
        while self.ring:
            if not self._partial_line and not self._is_in_comment:
                end = self.ring.find(b"\n")
                if 0 < end <= MAX_LINE_BYTES and not _SPECIAL_CHARACTER_PATTERN.search(self.ring, 0, end):
                    line, self.ring = self.ring[:end], self.ring[end + 1 :]
                    return line
            char, self.ring = self.ring[:1], self.ring[1:]
            is_line_end = char in b"\n\r" or (char in self._line_ends and not self._is_in_comment)
            if is_line_end or len(self._partial_line) >= MAX_LINE_BYTES:
                if not self._partial_line:
                    self._is_in_comment = False
                    continue
                line, self._partial_line = self._partial_line, b""
                if not self._is_in_comment:
                    return line
                if not self._comment_spans_lines:
                    self._is_in_comment = False
                    return line
            elif char == b";":
                self._is_in_comment = True
            elif not self._is_in_comment:
                self._partial_line += char
        return None
