"""Time for which a hot head stands still after one damaged byte, line or answer.

``python -m bench.printing.stalls [--kind KIND]... [--faults N] [--seed N] [--json]``. The link and the
emulator's firmware run in one process, on their own clock, and print moves of 10 ms; every 30 lines, one
fault of a kind occurs on the wire. The output has for each kind the median and the longest time for which the
head stood still, and whether every line was executed exactly once.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.firmware import ULTIMAKER2
from drivers.gcode import remove_frame
from drivers.link import Link, LinkFault, Phase
from drivers.printers import PROFILES

PRINTER_MODEL = "ultimaker2_plus"
LINES_PER_FAULT = 30
TO_BOARD_S, TO_HOST_S = 0.001, 0.004  # transfer times; the USB chip sends its buffer every 4 ms
START_LINES = [b"M302 S0", b"G28", b"G92 E0", b"G1 F3000 X90 Y90 Z0.3", b"M400"]
END_LINES = [b"M400"] * 3
SPECIAL_LINES = {10: b"M106 S%d", 20: b"M400"}  # in place of moves, by their index in each 30 lines

Damage = Callable[[bytes, random.Random], bytes]


def remove_bytes(data: bytes, index: int, count: int = 1) -> bytes:
    """Remove bytes at an index."""
    return data[:index] + data[index + count :]


def remove_byte(data: bytes, rng: random.Random) -> bytes:
    """Remove a random byte."""
    return remove_bytes(data, rng.randrange(len(data)))


def double_byte(data: bytes, rng: random.Random) -> bytes:
    """Double a random byte."""
    index = rng.randrange(len(data))
    return data[:index] + data[index : index + 1] + data[index:]


def flip_bit(data: bytes, rng: random.Random) -> bytes:
    """Flip a random bit."""
    index = rng.randrange(len(data))
    return data[:index] + bytes((data[index] ^ 1 << rng.randrange(8),)) + data[index + 1 :]


def corrupt_number(data: bytes, rng: random.Random) -> bytes:
    """Flip a bit of a number, so that the line arrives whole but is refused."""
    index = rng.randrange(data.index(b"X") + 1, data.index(b"*"))
    return data[:index] + bytes((data[index] ^ 1,)) + data[index + 1 :]


def replace_match(pattern: bytes, replacement: bytes = b"") -> Damage:
    """Return damage that replaces the first match of a pattern."""
    return lambda data, rng: re.sub(pattern, lambda _: replacement, data, count=1)


def flip_digit(data: bytes, rng: random.Random) -> bytes:
    """Flip a bit of a digit in the number of a Resend."""
    digits = [match.start() for match in re.finditer(rb"\d", data[data.index(b"Resend") :])]
    index = data.index(b"Resend") + rng.choice(digits)
    return data[:index] + bytes((data[index] ^ 1 << rng.randrange(3),)) + data[index + 1 :]


def add_refusal(age: int) -> Damage:
    """Return damage that adds a refusal after an ok, which no real board sends."""

    def damage(data: bytes, rng: random.Random) -> bytes:
        last = add_refusal.last_number - age  # type: ignore[attr-defined]
        return data + b"Error:checksum mismatch, Last Line: %d\nResend: %d\nok\n" % (last, last + 1)

    return damage


@dataclass(frozen=True, slots=True)
class FaultKind:
    """Kind of fault: the damage to a line, and to the next answer.

    Attributes
    ----------
    to_board, to_host
        Damage to the line, and to the answer; None for no damage.
    line_pattern
        Regular expression of the lines that are damaged.
    """

    to_board: Damage | None = None
    to_host: Damage | None = None
    line_pattern: bytes = rb" G1 "


def remove_all_bytes(data: bytes, rng: random.Random) -> bytes:
    """Remove all bytes."""
    return b""


def remove_last_bytes(data: bytes, rng: random.Random) -> bytes:
    """Remove the bytes after a random position."""
    return data[: rng.randrange(1, len(data) - 1)]


def repeat_bytes(data: bytes, rng: random.Random) -> bytes:
    """Send all bytes twice."""
    return data + data


_LINE_DAMAGES: dict[str, Damage] = {
    "newline lost": replace_match(rb"\n"),
    "byte lost": remove_byte,
    "byte doubled": double_byte,
    "bit flipped": flip_bit,
    "end lost": remove_last_bytes,
    "line lost": remove_all_bytes,
    "line doubled": repeat_bytes,
}
_ANSWER_DAMAGES: dict[str, Damage] = {
    "newline lost": replace_match(rb"\n"),
    "byte lost": remove_byte,
    "byte doubled": double_byte,
    "bit flipped": flip_bit,
    "answer lost": remove_all_bytes,
    "answer doubled": repeat_bytes,
    "joined to another": replace_match(rb"\n", b"echo:SD init fail\n"),
    "noise before it": lambda data, rng: rng.randbytes(5) + data,
}
_REFUSAL_DAMAGES: dict[str, Damage] = {
    "arrives": lambda data, rng: data,
    "Error lost": replace_match(rb"Error:.*\n"),
    "Resend lost": replace_match(rb"Resend:.*\n"),
    "Resend garbled": flip_digit,
    "Error and Resend lost": replace_match(rb"(?s)Error:.*Resend: \d+\n"),
    "its ok lost": replace_match(rb"ok\n"),
    "all lost": remove_all_bytes,
    "newline of Error lost": lambda data, rng: remove_bytes(data, data.index(b"\n")),
    "newline of Resend lost": replace_match(rb"\nok\n", b"ok\n"),
    "newline of its ok lost": lambda data, rng: data[:-1],
}
_OTHER_COMMANDS = {"M106": rb" M106 ", "M400": rb" M400\*", "M105": rb" M105\*"}

KINDS: dict[str, FaultKind] = {
    **{f"move: {name}": FaultKind(to_board=damage) for name, damage in _LINE_DAMAGES.items()},
    **{f"ok: {name}": FaultKind(to_host=damage) for name, damage in _ANSWER_DAMAGES.items()},
    **{f"refusal: {name}": FaultKind(corrupt_number, damage) for name, damage in _REFUSAL_DAMAGES.items()},
    "refusal without cause: of the last line": FaultKind(to_host=add_refusal(0)),
    "refusal without cause: of the third line before it": FaultKind(to_host=add_refusal(3)),
    "refusal without cause: of the 40th line before it": FaultKind(to_host=add_refusal(40)),
    **{
        f"{code}: {name}": FaultKind(to_board=damage, line_pattern=pattern)
        for code, pattern in _OTHER_COMMANDS.items()
        for name, damage in _LINE_DAMAGES.items()
    },
    **{
        f"{code}'s answer: {name}": FaultKind(to_host=damage, line_pattern=pattern)
        for code, pattern in _OTHER_COMMANDS.items()
        for name, damage in _ANSWER_DAMAGES.items()
    },
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of one kind of fault.

    Attributes
    ----------
    exact
        True if each line was executed once, and head and filament end at the program's positions.
    stalls_s
        For each fault, the seconds for which the head stood still.
    """

    fault: str | None
    exact: bool
    stalls_s: tuple[float, ...]
    repeated: int

    @property
    def median_s(self) -> float:
        """Median of the stalls; infinite without a fault."""
        return median(self.stalls_s) if self.stalls_s else math.inf

    @property
    def worst_s(self) -> float:
        """Longest stall; infinite without a fault."""
        return max(self.stalls_s, default=math.inf)


def make_move(i: int) -> bytes:
    """Make the `i`-th line: half a millimetre in 10 ms, different from its neighbours."""
    special = SPECIAL_LINES.get(i % LINES_PER_FAULT)
    if special is not None:
        return special % (i % 255) if b"%" in special else special
    return b"G1 X%.2f Y%.1f E%.4f" % (
        100 + i % 2 * 0.5,
        100 + i // LINES_PER_FAULT % 50 * 0.5,
        i * 0.02,
    )


class RecordingFirmware(EmulatedFirmware):
    """Firmware that records the numbered lines that it accepts, except requests for reports."""

    def __init__(self, rng: random.Random) -> None:
        self.received: list[bytes] = []
        super().__init__(PROFILES[PRINTER_MODEL], Faults(), rng, 0.0)

    @property
    def last_number(self) -> int:
        """Number of the last accepted line."""
        return self._last_number

    def _read_plain_move(self) -> bool:
        return False

    def _accept_line(self, line: bytes) -> None:
        previous_number = self._last_number
        super()._accept_line(line)
        if self._last_number != previous_number and (body := remove_frame(line)) != b"M105":
            self.received.append(body)


class WireDirection:
    """One direction of the wire, with a delay."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._in_flight: deque[tuple[float, bytes]] = deque()

    @property
    def due_s(self) -> float:
        """Arrival time of the next bytes; infinite if none are in flight."""
        return self._in_flight[0][0] if self._in_flight else math.inf

    def put(self, data: bytes, now_s: float) -> None:
        """Send bytes."""
        if data:
            self._in_flight.append((now_s + self._delay_s, data))

    def take(self, now_s: float) -> bytes:
        """Return the bytes that have arrived by now."""
        data = b""
        while self._in_flight and self._in_flight[0][0] <= now_s:
            data += self._in_flight.popleft()[1]
        return data


class FaultInjector:
    """Wire that damages one line in every 30, or its answer."""

    def __init__(self, kind: FaultKind, rng: random.Random) -> None:
        self._kind, self._rng = kind, rng
        self._line_pattern = re.compile(rb"N(\d+)" + kind.line_pattern)
        self._next_number = LINES_PER_FAULT  # first line number of the next fault
        self._damages_next_answer = False
        self.fault_count = 0

    def _schedule_next(self, number: int) -> None:
        self._next_number = number - number % LINES_PER_FAULT + LINES_PER_FAULT + self._rng.randrange(3)

    def damage_line(self, data: bytes) -> bytes:
        """Return a line as the board receives it."""
        match = self._line_pattern.match(data)
        if match is None or int(match[1]) < self._next_number:
            return data
        self._schedule_next(int(match[1]))
        self._damages_next_answer = self._kind.to_host is not None
        self.fault_count += not self._damages_next_answer
        return self._kind.to_board(data, self._rng) if self._kind.to_board else data

    def damage_answer(self, data: bytes) -> bytes:
        """Return an answer as the host receives it."""
        if not self._damages_next_answer or (self._kind.to_board and b"Resend" not in data):
            return data
        assert self._kind.to_host is not None
        self._damages_next_answer = False
        self.fault_count += 1
        return self._kind.to_host(data, self._rng)


def run(kind: FaultKind, faults: int, seed: int) -> Outcome:
    """Print with a number of faults of one kind."""
    rng = random.Random(seed)
    lines = (faults + 2) * LINES_PER_FAULT
    program = [*(make_move(index) for index in range(lines)), *END_LINES]
    firmware, link, injector = RecordingFirmware(rng), Link(ULTIMAKER2), FaultInjector(kind, rng)
    link.poll_interval_s = 0.2
    link.on_opened(0.0)
    to_board, to_host = WireDirection(TO_BOARD_S), WireDirection(TO_HOST_S)
    now_s, is_connected, fault, fault_count = 0.0, False, None, 0
    # For each fault: its time, and the seconds of motion until then.
    fault_marks: list[tuple[float, float]] = []
    while fault is None and not (is_connected and link.is_drained):
        now_s = max(now_s, min(firmware.compute_deadline_s(), link.deadline_s, to_board.due_s, to_host.due_s))
        answer = firmware.feed(to_board.take(now_s), now_s)
        add_refusal.last_number = firmware.last_number  # type: ignore[attr-defined]
        to_host.put(injector.damage_answer(answer) if answer else answer, now_s)
        data = to_host.take(now_s)
        line = link.take_line_after_ok(data, now_s)
        events = [*(link.receive(data, now_s) if line is None else ()), *link.tick(now_s)]
        fault = next((event.fault for event in events if isinstance(event, LinkFault)), None)
        if not is_connected and link.phase is Phase.LIVE:
            is_connected = True
            link.send(now_s, *START_LINES)
            link.stream(now_s, lambda a, b: program[a:b], 0, len(program))
        to_board.put(injector.damage_line((line or b"") + link.take()), now_s)
        if injector.fault_count > fault_count and len(fault_marks) <= faults:
            fault_count = injector.fault_count
            fault_marks.append((now_s, firmware.moving_s))
    stalls_s = tuple(
        max(0.0, next_mark[0] - mark[0] - (next_mark[1] - mark[1]))
        for mark, next_mark in pairwise(fault_marks)
    )
    machine = firmware.machine
    is_at_end = abs(machine.position_mm[3] - (lines - 1) * 0.02) < 1e-6
    has_fed = abs(firmware.board.filament_mm - (lines - 1) * 0.02) < 1e-3
    expected_lines, received_lines = [*START_LINES, *program], firmware.received
    is_exact = received_lines == expected_lines[: len(received_lines)] and len(received_lines) > len(
        expected_lines
    ) - len(END_LINES)
    return Outcome(fault, fault is None and is_exact and is_at_end and has_fed, stalls_s, link.resend_count)


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kind", action="append", help="only kinds whose names contain this")
    parser.add_argument("--faults", type=int, default=200, help="number of faults of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results: dict[str, dict[str, object]] = {}
    for name, kind in KINDS.items():
        if options.kind and not any(pattern in name for pattern in options.kind):
            continue
        outcome = run(kind, options.faults, options.seed)
        results[name] = {
            "fault": outcome.fault,
            "exact": outcome.exact,
            "faults": len(outcome.stalls_s),
            "median_s": round(outcome.median_s, 3),
            "worst_s": round(outcome.worst_s, 3),
        }
        if not options.json:
            outcome_text = "exact" if outcome.exact else outcome.fault or "NOT EXACT"
            figures = f"median {outcome.median_s:6.2f} s, worst {outcome.worst_s:6.2f} s"
            print(f"{name:40} {len(outcome.stalls_s):4} faults: {figures}, {outcome_text}", flush=True)
    if options.json:
        print(json.dumps({"schema": 1, "kinds": results}))


if __name__ == "__main__":
    main()
