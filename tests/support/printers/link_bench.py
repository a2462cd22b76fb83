"""Board that checks line numbers and checksums like the firmware, and a wire that loses or changes bytes."""

import math
import random
import re
from functools import reduce
from operator import xor

from drivers.errors import Fault
from drivers.firmware import ULTIMAKER2
from drivers.gcode import remove_frame
from drivers.link import Events, Link, LinkFault

BANNER = b"start\necho:Marlin 1.0.0\necho: Last Updated | Author: Vers:_3.3.0\necho:   M301 P10 I1 D70\n"


class Firmware:
    """Firmware without a machine that checks numbered lines and answers them."""

    def __init__(self) -> None:
        self.last_number = 0
        self.partial_line = b""
        self.executed_lines: list[tuple[int, bytes]] = []  # numbers and commands
        self.is_mute = False

    def feed(self, data: bytes) -> bytes:
        answers = b""
        *lines, self.partial_line = (self.partial_line + data).split(b"\n")
        for line in lines:
            answers += self.execute(line)
        return b"" if self.is_mute else answers

    def execute(self, line: bytes) -> bytes:
        body = line
        number = re.search(rb"N(-?\d+)", line)
        star_index = line.find(b"*")
        if number is not None:
            n = int(number[1])
            if n != self.last_number + 1 and b"M110" not in line:
                return self.reject(b"Line Number is not Last Line Number+1")
            if star_index < 0:
                return self.reject(b"No Checksum with line number")
            checksum_match = re.match(rb"\d*", line[star_index + 1 :])
            if reduce(xor, line[:star_index], 0) != int((checksum_match and checksum_match[0]) or b"-1"):
                return self.reject(b"checksum mismatch")
            self.last_number = n
            body = remove_frame(line)
        elif star_index >= 0:
            return b"Error:No Line Number with checksum, Last Line: %d\n" % self.last_number
        if not body.strip():
            return b""
        if number is not None and not body.startswith((b"M110", b"M105")):
            self.executed_lines.append((self.last_number, body))
        if body.startswith(b"M105"):
            return b"ok T:200.0 /210.0 B:60.0 /60.0 @:0 B@:0\n"
        if b"M119" in body:
            return b"Reporting endstop status\nx_min: openy_max: openz_max: openok\n"
        return b"ok\n"

    def reject(self, data: bytes) -> bytes:
        self.partial_line = b""
        return b"Error:%b, Last Line: %d\nResend: %d\nok\n" % (data, self.last_number, self.last_number + 1)


class Wire:
    """Wire that loses or changes bytes at random, and delivers them in pieces of `piece_bytes`.

    It changes each bit of a byte at most once in a line: the checksum, an exclusive or of all bytes, cannot
    detect two changes of the same bit.
    """

    def __init__(self, loss_share: float, change_share: float, piece_bytes: int, seed: int) -> None:
        self.loss_share, self.change_share, self.piece_bytes = loss_share, change_share, piece_bytes
        self.rng = random.Random(seed)

    def transmit(self, data: bytes) -> list[bytes]:
        if self.loss_share or self.change_share:
            data = self._disturb(data)
        return [data[i : i + self.piece_bytes] for i in range(0, len(data), self.piece_bytes)]

    def _disturb(self, data: bytes) -> bytes:
        """Lose and change bytes of data."""
        result, changed_bits = bytearray(), 0
        for byte in data:
            roll = self.rng.random()
            if roll >= self.loss_share:
                mask = 1 << self.rng.randrange(8) if roll < self.loss_share + self.change_share else 0
                mask &= ~changed_bits
                changed_bits |= mask
                result.append(byte ^ mask)
            if byte == ord("\n"):
                changed_bits = 0
        return bytes(result)


def pass_to_link(link: Link, data: bytes, now_s: float) -> tuple[bytes, Events]:
    """Pass received bytes to a link, as the agent does; return the line to write at once, and the events."""
    line = link.take_line_after_ok(data, now_s)
    return (b"", link.receive(data, now_s)) if line is None else (line, ())


class Bench:
    """A link and a board at the ends of a wire, with their own clock."""

    def __init__(self, wire: Wire | None = None, min_timeout_s: float = 0.0) -> None:
        self.firmware = Firmware()
        self.wire = wire or Wire(0.0, 0.0, 10_000, 0)
        self.link = Link(ULTIMAKER2, min_timeout_s)
        self.now_s = 0.0
        self.events: list[object] = []
        self.next_line = b""  # line to write at once

    def boot(self) -> "Bench":
        self.link.on_opened(self.now_s)
        self.events += self.link.receive(BANNER, self.now_s)
        return self

    def run(self, until_s: float = 1e6) -> None:
        """Run until the link has nothing to send and no deadline, or until a given time."""
        for _ in range(20_000):
            if self.now_s >= until_s:
                return
            sent, self.next_line = self.next_line + self.link.take(), b""
            if sent:
                for received in self.wire.transmit(sent):
                    for answer in self.wire.transmit(self.firmware.feed(received)):
                        line, events = pass_to_link(self.link, answer, self.now_s)
                        self.next_line += line
                        self.events += events
                self.now_s += 0.01
            elif self.link.deadline_s == math.inf:
                return
            else:
                self.now_s = self.link.deadline_s
                self.events += self.link.tick(self.now_s)
        raise AssertionError(f"the link does not finish: {self.events[-5:]}")

    def list_faults(self) -> list[Fault]:
        return [event.fault for event in self.events if isinstance(event, LinkFault)]


def make_lines(count: int) -> list[bytes]:
    return [b"G1 X%d.%03d Y1 E%d" % (i % 200, i % 1000, i) for i in range(count)]


def stream_program(bench: Bench, program: list[bytes]) -> None:
    bench.link.stream(bench.now_s, lambda a, b: program[a:b], 0, len(program))
