"""Very long print over a wire with errors: every line arrives once and unaltered, or a fault is reported.

``python -m bench.printing.soak [--lines N] [--damage P] [--seed N] [--json]``. The link and the emulator's
firmware run in one process, on their own clock. Each byte is damaged with the given probability, in both
directions: half of the damaged bytes have a bit flipped, a quarter are lost, a quarter are doubled. A
checksum of 8 bits does not detect all damage; the emulator counts the lines that it accepted although they
differed from the lines sent.
"""

from __future__ import annotations

import argparse
import json
import random
import time
from dataclasses import dataclass

from drivers.emulator.faults import Faults
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.firmware import ULTIMAKER2
from drivers.link import Link, LinkFault, Phase
from drivers.printers import PROFILES

PRINTER_MODEL = "ultimaker2_plus"
START_LINES = [b"M302 S0", b"G28", b"G92 E0", b"G1 F9000 X90 Y90 Z0.3"]
BARRIERS = [b"M400"] * 3


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of the print.

    Attributes
    ----------
    fault
        Reason why the link gave up; None if it printed to the end.
    exact
        True if the firmware made each move once, and head and filament end at the file's positions.
    altered
        Number of lines that were executed although they differed from the lines sent: their checksums
        matched.
    """

    lines: int
    fault: str | None
    exact: bool
    moves: int
    altered: int
    damaged_bytes: int
    repeated: int
    cpu_s: float


def make_move(i: int) -> bytes:
    """Make the `i`-th line: a move of half a millimetre, different from its neighbours."""
    return b"G1 X%.2f Y%.1f E%.4f" % (
        100 + i % 2 * 0.5 + i % 7 * 0.01,
        100 + i % 50 * 0.5,
        i * 0.02,
    )


def print_over_noisy_wire(lines: int, damage: float, seed: int = 0) -> Outcome:
    """Print a number of lines over a wire on which each byte is damaged with the probability `damage`."""
    faults = Faults(noise=damage / 2, lost=damage / 4, doubled=damage / 4)
    now_s = 0.0
    firmware = EmulatedFirmware(PROFILES[PRINTER_MODEL], faults, random.Random(seed), now_s)
    link = Link(ULTIMAKER2)
    link.on_opened(now_s)
    fault: str | None = None
    start_s = time.process_time()
    is_connected, line = False, None
    while fault is None:
        sent_bytes = (line or b"") + link.take()
        if not sent_bytes:
            due_s = min(firmware.compute_deadline_s(), link.deadline_s)
            now_s = max(now_s + 1e-4, due_s)
        else:
            now_s += 0.002
        answer = firmware.feed(sent_bytes, now_s)
        line = link.take_line_after_ok(answer, now_s)
        events = [*(link.receive(answer, now_s) if line is None else ()), *link.tick(now_s)]
        fault = next((event.fault for event in events if isinstance(event, LinkFault)), None)
        if not is_connected and link.phase is Phase.LIVE:
            is_connected = True
            link.send(now_s, *START_LINES)
            link.stream(now_s, lambda a, b: list_lines(a, b, lines), 0, lines + len(BARRIERS))
        elif is_connected and link.is_drained:
            break
    machine = firmware.machine
    moves = machine.planner.move_count - 1  # without the move in `START_LINES`
    last_move = make_move(lines - 1)
    is_at_end = (
        b"E%.4f" % machine.position_mm[3] == last_move.split()[-1]
        and b"X%.2f" % machine.position_mm[0] == last_move.split()[1]
    )
    has_fed = abs(firmware.board.filament_mm - (lines - 1) * 0.02) < 1e-3
    return Outcome(
        lines=lines,
        fault=fault,
        exact=fault is None and moves == lines and is_at_end and has_fed,
        moves=moves,
        altered=firmware.noise.altered_line_count if firmware.noise is not None else 0,
        damaged_bytes=firmware.noise.damaged_byte_count if firmware.noise is not None else 0,
        repeated=link.resend_count,
        cpu_s=round(time.process_time() - start_s, 1),
    )


def list_lines(start: int, stop: int, lines: int) -> list[bytes]:
    """List some lines of the file and of the barriers after it."""
    return [make_move(index) for index in range(start, min(stop, lines))] + [BARRIERS[0]] * max(
        0, stop - max(start, lines)
    )


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lines", type=int, default=1_000_000)
    parser.add_argument("--damage", type=float, default=0.00005, help="probability that a byte is damaged")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    outcome = print_over_noisy_wire(options.lines, options.damage, options.seed)
    result = {name: getattr(outcome, name) for name in Outcome.__slots__}
    print(
        json.dumps({"schema": 1, "damage": options.damage, **result})
        if options.json
        else "\n".join(f"{k}: {v}" for k, v in result.items())
    )


if __name__ == "__main__":
    main()
