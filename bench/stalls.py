"""Time for which one damaged byte, line or answer keeps a hot head still.

``python -m bench.stalls [--kind KIND]... [--faults N] [--seed N] [--json]``. The link and the emulator's
firmware in one process, on a clock of their own, print moves of 10 ms; every 30 lines one fault of a kind is
put on the wire. For each kind it prints the median and the longest time for which the head stood still, and
whether every line was carried out exactly once.
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

MODEL = "ultimaker2_plus"
EVERY_LINES = 30
TO_BOARD_S, TO_HOST_S = 0.001, 0.004  # on the way; the USB chip sends what it has every 4 ms
HEAD = [b"M302 S0", b"G28", b"G92 E0", b"G1 F3000 X90 Y90 Z0.3", b"M400"]
TAIL = [b"M400"] * 3
SPECIAL = {10: b"M106 S%d", 20: b"M400"}  # among the moves, by their place in each 30 lines

Damage = Callable[[bytes, random.Random], bytes]


def cut(data: bytes, at: int, count: int = 1) -> bytes:
    return data[:at] + data[at + count :]


def lose(data: bytes, rng: random.Random) -> bytes:
    return cut(data, rng.randrange(len(data)))


def double(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + data[at : at + 1] + data[at:]


def flip(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes((data[at] ^ 1 << rng.randrange(8),)) + data[at + 1 :]


def spoil(data: bytes, rng: random.Random) -> bytes:
    """Flip a bit so that the line is complete but refused."""
    at = rng.randrange(data.index(b"X") + 1, data.index(b"*"))
    return data[:at] + bytes((data[at] ^ 1,)) + data[at + 1 :]


def take_out(pattern: bytes, by: bytes = b"") -> Damage:
    return lambda data, rng: re.sub(pattern, lambda _: by, data, count=1)


def flip_digit(data: bytes, rng: random.Random) -> bytes:
    digits = [found.start() for found in re.finditer(rb"\d", data[data.index(b"Resend") :])]
    at = data.index(b"Resend") + rng.choice(digits)
    return data[:at] + bytes((data[at] ^ 1 << rng.randrange(3),)) + data[at + 1 :]


def refuse(back: int) -> Damage:
    """Add a refusal that the board never sent after an ok."""

    def damage(data: bytes, rng: random.Random) -> bytes:
        last = refuse.last - back  # type: ignore[attr-defined]
        return data + b"Error:checksum mismatch, Last Line: %d\nResend: %d\nok\n" % (last, last + 1)

    return damage


@dataclass(frozen=True, slots=True)
class Kind:
    """Kind of fault: the damage to a line, and to the next answer.

    Attributes
    ----------
    there, back
        Damage to the line, and to the answer; None for none.
    lines
        Pattern of the lines that are hit.
    """

    there: Damage | None = None
    back: Damage | None = None
    lines: bytes = rb" G1 "


def gone(data: bytes, rng: random.Random) -> bytes:
    return b""


def half(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.randrange(1, len(data) - 1)]


def twice(data: bytes, rng: random.Random) -> bytes:
    return data + data


_OF_A_LINE: dict[str, Damage] = {
    "newline lost": take_out(rb"\n"),
    "byte lost": lose,
    "byte doubled": double,
    "bit flipped": flip,
    "half lost": half,
    "line lost": gone,
    "line doubled": twice,
}
_OF_AN_ANSWER: dict[str, Damage] = {
    "newline lost": take_out(rb"\n"),
    "byte lost": lose,
    "byte doubled": double,
    "bit flipped": flip,
    "answer lost": gone,
    "answer doubled": twice,
    "glued to another": take_out(rb"\n", b"echo:SD init fail\n"),
    "noise before it": lambda data, rng: rng.randbytes(5) + data,
}
_OF_A_REFUSAL: dict[str, Damage] = {
    "arrives": lambda data, rng: data,
    "Error lost": take_out(rb"Error:.*\n"),
    "Resend lost": take_out(rb"Resend:.*\n"),
    "Resend garbled": flip_digit,
    "Error and Resend lost": take_out(rb"(?s)Error:.*Resend: \d+\n"),
    "its ok lost": take_out(rb"ok\n"),
    "all of it lost": gone,
    "newline of Error lost": lambda data, rng: cut(data, data.index(b"\n")),
    "newline of Resend lost": take_out(rb"\nok\n", b"ok\n"),
    "newline of its ok lost": lambda data, rng: data[:-1],
}
_NOT_MOVES = {"M106": rb" M106 ", "M400": rb" M400\*", "M105": rb" M105\*"}

KINDS: dict[str, Kind] = {
    **{f"move: {name}": Kind(there=damage) for name, damage in _OF_A_LINE.items()},
    **{f"ok: {name}": Kind(back=damage) for name, damage in _OF_AN_ANSWER.items()},
    **{f"refusal: {name}": Kind(spoil, damage) for name, damage in _OF_A_REFUSAL.items()},
    "refusal: invented": Kind(back=refuse(0)),
    "refusal: invented, of an older line": Kind(back=refuse(3)),
    "refusal: invented, of a line long ago": Kind(back=refuse(40)),
    **{
        f"{code}: {name}": Kind(there=damage, lines=lines)
        for code, lines in _NOT_MOVES.items()
        for name, damage in _OF_A_LINE.items()
    },
    **{
        f"{code}'s answer: {name}": Kind(back=damage, lines=lines)
        for code, lines in _NOT_MOVES.items()
        for name, damage in _OF_AN_ANSWER.items()
    },
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of one kind of fault.

    Attributes
    ----------
    exact
        Each line was carried out once, and head and filament are where the program leaves them.
    stalls_s
        For each fault, the seconds for which the head stood still.
    """

    fault: str | None
    exact: bool
    stalls_s: tuple[float, ...]
    repeated: int

    @property
    def median_s(self) -> float:
        return median(self.stalls_s) if self.stalls_s else math.inf

    @property
    def worst_s(self) -> float:
        return max(self.stalls_s, default=math.inf)


def make_move(at: int) -> bytes:
    """Make the `at`-th line: half a millimetre in 10 ms, different from its neighbours."""
    special = SPECIAL.get(at % EVERY_LINES)
    if special is not None:
        return special % (at % 255) if b"%" in special else special
    return b"G1 X%.2f Y%.1f E%.4f" % (100 + at % 2 * 0.5, 100 + at // EVERY_LINES % 50 * 0.5, at * 0.02)


class Recorder(EmulatedFirmware):
    """Firmware that records its numbered lines, without requests for reports."""

    def __init__(self, rng: random.Random) -> None:
        self.taken: list[bytes] = []
        super().__init__(PROFILES[MODEL], Faults(), rng, 0.0)

    @property
    def last(self) -> int:
        return self._last_number

    def _read_plain_move(self) -> bool:
        return False

    def _accept(self, line: bytes) -> None:
        previous_number = self._last_number
        super()._accept(line)
        if self._last_number != previous_number and (body := remove_frame(line)) != b"M105":
            self.taken.append(body)


class Way:
    """One direction of the wire, on which bytes take time."""

    def __init__(self, takes_s: float) -> None:
        self._takes_s = takes_s
        self._under_way: deque[tuple[float, bytes]] = deque()

    @property
    def due_s(self) -> float:
        return self._under_way[0][0] if self._under_way else math.inf

    def put(self, data: bytes, now_s: float) -> None:
        if data:
            self._under_way.append((now_s + self._takes_s, data))

    def take(self, now_s: float) -> bytes:
        out = b""
        while self._under_way and self._under_way[0][0] <= now_s:
            out += self._under_way.popleft()[1]
        return out


class Tamperer:
    """Wire that damages one line of every 30, or its answer."""

    def __init__(self, kind: Kind, rng: random.Random) -> None:
        self._kind, self._rng = kind, rng
        self._number = re.compile(rb"N(\d+)" + kind.lines)
        self._next = EVERY_LINES  # the line number from which the next fault may be
        self._armed = False  # its answer is damaged next
        self.hit = 0

    def _draw(self, number: int) -> None:
        self._next = number - number % EVERY_LINES + EVERY_LINES + self._rng.randrange(3)

    def there(self, data: bytes) -> bytes:
        found = self._number.match(data)
        if found is None or int(found[1]) < self._next:
            return data
        self._draw(int(found[1]))
        self._armed = self._kind.back is not None
        self.hit += not self._armed
        return self._kind.there(data, self._rng) if self._kind.there else data

    def back(self, data: bytes) -> bytes:
        if not self._armed or (self._kind.there and b"Resend" not in data):
            return data
        assert self._kind.back is not None
        self._armed = False
        self.hit += 1
        return self._kind.back(data, self._rng)


def run(kind: Kind, faults: int, seed: int) -> Outcome:
    """Print with a number of faults of one kind."""
    rng = random.Random(seed)
    lines = (faults + 2) * EVERY_LINES
    program = [*(make_move(at) for at in range(lines)), *TAIL]
    firmware, link, tamperer = Recorder(rng), Link(ULTIMAKER2), Tamperer(kind, rng)
    link.poll_every_s = 0.2
    link.on_opened(0.0)
    there, back = Way(TO_BOARD_S), Way(TO_HOST_S)
    now_s, is_connected, fault, hit = 0.0, False, None, 0
    marks: list[tuple[float, float]] = []  # at each fault: the time, and how long the head had moved
    while fault is None and not (is_connected and link.drained):
        now_s = max(now_s, min(firmware.deadline_s(), link.deadline_s, there.due_s, back.due_s))
        answer = firmware.feed(there.take(now_s), now_s)
        refuse.last = firmware.last  # type: ignore[attr-defined]
        back.put(tamperer.back(answer) if answer else answer, now_s)
        data = back.take(now_s)
        events = [*((data and link.receive(data, now_s)) or ()), *link.tick(now_s)]
        fault = next((event.fault for event in events if isinstance(event, LinkFault)), None)
        if not is_connected and link.phase is Phase.LIVE:
            is_connected = True
            link.send(now_s, *HEAD)
            link.stream(now_s, lambda a, b: program[a:b], 0, len(program))
        there.put(tamperer.there(link.take()), now_s)
        if tamperer.hit > hit and len(marks) <= faults:
            hit = tamperer.hit
            marks.append((now_s, firmware.printing_s))
    stalls_s = tuple(
        max(0.0, later[0] - earlier[0] - (later[1] - earlier[1])) for earlier, later in pairwise(marks)
    )
    machine = firmware.machine
    ends = abs(machine.position[3] - (lines - 1) * 0.02) < 1e-6
    fed = abs(firmware.board.filament_mm - (lines - 1) * 0.02) < 1e-3
    wanted, taken = [*HEAD, *program], firmware.taken
    once = taken == wanted[: len(taken)] and len(taken) > len(wanted) - len(TAIL)
    return Outcome(fault, fault is None and once and ends and fed, stalls_s, link.repeated)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kind", action="append", help="only those whose names hold this")
    parser.add_argument("--faults", type=int, default=200, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    results: dict[str, dict[str, object]] = {}
    for name, kind in KINDS.items():
        if options.kind and not any(wanted in name for wanted in options.kind):
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
            ended = "exact" if outcome.exact else outcome.fault or "NOT EXACT"
            figures = f"median {outcome.median_s:6.2f} s, worst {outcome.worst_s:6.2f} s"
            print(f"{name:40} {len(outcome.stalls_s):4} faults: {figures}, {ended}", flush=True)
    if options.json:
        print(json.dumps({"schema": 1, "kinds": results}))


if __name__ == "__main__":
    main()
