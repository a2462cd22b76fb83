"""Moves per second of an emulator: its firmware alone, and through its port.

``python -m bench.printing.emulator_throughput [--lines N] [--scale S] [--json]`` streams a spiral of short
moves, one line in flight. The first figure is the CPU time of a line in `EmulatedFirmware.feed`, with the
clock ahead of the moves; the second is the wall time of a round trip through a pseudo-terminal to an emulator
process whose clock runs fast enough never to wait; the third is the same with a clock of `--scale`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import select
import tempfile
import time
from functools import reduce
from operator import xor
from pathlib import Path

from bench.process_use import read_cpu_s
from drivers.clock import Clock
from drivers.emulator.faults import Faults
from drivers.emulator.firmware.firmware import EmulatedFirmware
from drivers.emulator.launch import Command, control, launch, read_status
from drivers.printers import PROFILES

PRINTER_MODEL = "ultimaker2_plus"
SEGMENT_MM = 0.8
PREPARATION = (b"M110", b"M302 S0", b"G28", b"G92 E0", b"G1 F3000 X112 Y112 Z0.3")


def list_moves(lines: int) -> list[bytes]:
    """List numbered, checksummed moves of about 40 bytes, like those of a slicer."""
    bodies = list(PREPARATION)
    angle_rad, e_mm = 0.0, 0.0
    for _ in range(lines):
        radius_mm = 10.0 + 80.0 * (0.5 + 0.5 * math.sin(angle_rad / 40.0))
        angle_rad += SEGMENT_MM / radius_mm
        e_mm += 0.03
        x, y = 112 + radius_mm * math.cos(angle_rad), 112 + radius_mm * math.sin(angle_rad)
        bodies.append(f"G1 F3000 X{x:.3f} Y{y:.3f} E{e_mm:.5f}".encode())
    numbered_moves = (b"N%d %b" % (n, body) for n, body in enumerate(bodies))
    return [b"%b*%d\n" % (line, reduce(xor, line)) for line in numbered_moves]


def measure_firmware_us(lines: list[bytes]) -> float:
    """Measure the CPU microseconds of a move in the firmware, including its wake-ups."""
    firmware = EmulatedFirmware(PROFILES[PRINTER_MODEL], Faults(), random.Random(0), 0.0)
    now_s = 10.0
    firmware.feed(b"", now_s)
    start_s = 0.0
    for index, line in enumerate(lines):
        if index == len(PREPARATION):
            start_s = time.process_time()
        reply = firmware.feed(line, now_s)
        while not reply:
            now_s = firmware.compute_deadline_s()
            reply = firmware.feed(b"", now_s)
    return (time.process_time() - start_s) / (len(lines) - len(PREPARATION)) * 1e6


def measure_port_us(lines: list[bytes], scale: float) -> tuple[float, float]:
    """Measure wall microseconds of a round trip through the port, and the emulator's CPU microseconds."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tty = launch(f"sim://{PRINTER_MODEL}", folder, Clock(scale, time.time()))
        port = os.open(tty, os.O_RDWR | os.O_NOCTTY)
        try:
            reply = b""
            while b"SD init" not in reply:
                select.select([port], [], [])
                reply += os.read(port, 4096)
            start_s, start_cpu_s = 0.0, 0.0
            pid = read_status(folder).pid
            for index, line in enumerate(lines):
                if index == len(PREPARATION):
                    start_s, start_cpu_s = time.perf_counter(), read_cpu_s(pid)
                os.write(port, line)
                reply = b""
                while b"ok" not in reply:
                    select.select([port], [], [])
                    reply += os.read(port, 4096)
            moves = len(lines) - len(PREPARATION)
            wall_s, cpu_s = time.perf_counter() - start_s, read_cpu_s(pid) - start_cpu_s
            return wall_s / moves * 1e6, cpu_s / moves * 1e6
        finally:
            os.close(port)
            control(folder, Command.POWER_OFF)


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--lines", type=int, default=20_000)
    parser.add_argument(
        "--scale",
        type=float,
        default=60.0,
        help="emulated seconds per wall second, in the run with a limited clock",
    )
    options = parser.parse_args()
    lines = list_moves(options.lines)
    feed_us = measure_firmware_us(lines)
    round_trip_us, free_cpu_us = measure_port_us(lines, scale=1e6)
    paced_us, paced_cpu_us = measure_port_us(lines, options.scale)
    figures = {
        "schema": 1,
        "lines": options.lines,
        "feed_cpu_us": round(feed_us, 1),
        "round_trip_us": round(round_trip_us, 1),
        "round_trip_cpu_us": round(free_cpu_us, 1),
        "scale": options.scale,
        "paced_line_us": round(paced_us, 1),
        "paced_cpu_us": round(paced_cpu_us, 1),
    }
    if options.json:
        print(json.dumps(figures))
        return
    print(f"firmware alone: {feed_us:.1f} us of CPU per move")
    print(f"through the port: {round_trip_us:.1f} us per round trip, {free_cpu_us:.1f} us of CPU")
    print(f"at {options.scale:g} times real time: {paced_us:.1f} us per move, {paced_cpu_us:.1f} us of CPU")


if __name__ == "__main__":
    main()
