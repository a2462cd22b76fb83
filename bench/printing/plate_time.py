"""Time that a plate takes besides its layers, measured on cubes that a real agent prints on an emulator.

The constants `START_CODE_S` and `END_CODE_S` of farm/planning/plate_times.py were measured with this script.

Usage: python -m bench.printing.plate_time [--scale 60] [--json]
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import trimesh

from bench.printing.followed_print import follow_print, make_start_request
from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import Command, control
from drivers.printers import PROFILES, SLICING_PROFILES
from drivers.remote import AgentClient, spawn_agent
from farm.planning.plate_times import compute_plate_seconds
from farm.planning.printer_settings import build_slicing_printer
from slicing.plate import PlateRequest, PlateResult, slice_plate
from slicing.settings import EngineSettings, SettingsRequest, find_engine, find_resources, resolve_settings

PRINTER_MODEL = "ultimaker2_plus"
SIDES_MM = (10.0, 20.0, 40.0)


def slice_cube(side_mm: float, settings: EngineSettings, folder: Path) -> PlateResult:
    """Slice a cube in the middle of the bed."""
    stl = folder / f"cube-{side_mm:g}.stl"
    cube = trimesh.creation.box((side_mm, side_mm, side_mm))
    cube.apply_translation((0.0, 0.0, side_mm / 2))
    cube.export(stl)
    bed = ((-103.0, -96.0, 103.0, 94.0, 205.0),)
    return slice_plate(PlateRequest(stl, settings, stl.with_suffix(".gcode"), find_engine(), bed))


async def print_once(plate: PlateResult, folder: Path, clock: Clock) -> m.PrintSnapshot:
    """Print on a new emulator, cold and with parked filament; return the last snapshot of the print."""
    process = spawn_agent("bench", PRINTER_MODEL, f"sim://{PRINTER_MODEL}", folder, clock)
    client = AgentClient(folder)
    await client.connect()
    request = make_start_request(plate.gcode, plate.sliced_s)
    try:
        return [snapshot async for snapshot in follow_print(client, request)][-1]
    finally:
        await client.request(m.Shutdown(id=0, now=True))
        await client.close()
        process.wait(30)
        control(folder / "emulator", Command.POWER_OFF)


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=60.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    settings = resolve_settings(
        SettingsRequest(build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL])), find_resources()
    )
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        for side_mm in SIDES_MM:
            plate = slice_cube(side_mm, settings, Path(name))
            folder = Path(name) / f"agent-{side_mm:g}"
            ended_print = asyncio.run(print_once(plate, folder, Clock(options.scale, time.time())))
            assert ended_print.started_s is not None and ended_print.ended_s is not None
            actual_s = ended_print.ended_s - ended_print.started_s
            expected_s = compute_plate_seconds(
                PROFILES[PRINTER_MODEL], plate.sliced_s, settings.nozzle_c, settings.bed_c
            )
            rows.append(
                {
                    "cube_mm": side_mm,
                    "layers_s": plate.sliced_s,
                    "actual_s": actual_s,
                    "expected_s": expected_s,
                    "overhead_s": actual_s - plate.sliced_s,
                    "starved_s": ended_print.starved_s,
                }
            )
    if options.json:
        print(json.dumps({"schema": 1, "plates": rows}, indent=1))
        return
    for row in rows:
        print("  ".join(f"{key} {value:.1f}" for key, value in row.items()))


if __name__ == "__main__":
    main()
