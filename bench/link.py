"""Figures of links and agents, measured in one run of some minutes on a machine without other load.

``python -m bench.link [--part PART]... [--agents N] [--lines N] [--scale S] [--beside PYTHON] [--json]``.
Real processes: every agent resets its board, heats, streams short moves and ends its print.

* ``throughput``: lines per second through agents and emulators on ptys, and CPU time per line. The clock is
  so fast that moves take almost no time, so the host and the link are the limit.
* ``printcore``: an agent and then printcore print the same moves on one emulator, in wall time and with the
  time of bytes at 250000 baud. It needs a PYTHON that has Printrun (`make interop` makes one).
* ``agent``: N agents at 50 lines/s, on boards that only acknowledge: turnaround, CPU, memory
  (`bench.printing.agent`).
* ``peers``: the same for 50 agents.
* ``memory``: one agent that prints a file of 50 MB.
* ``estop``: time until all targets are 0, with daemon and agents stopped by SIGSTOP (`bench.printing.estop`).
"""

from __future__ import annotations

import argparse
import asyncio
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from statistics import median

from bench.printing import agent, estop
from bench.printing.followed_print import follow_print, make_start_request
from bench.process_use import read_cpu_s
from drivers import messages as m
from drivers.clock import Clock
from drivers.emulator.launch import control
from drivers.errors import DriverError
from drivers.remote import AgentClient, spawn_agent

PARTS = ("throughput", "printcore", "agent", "peers", "memory", "estop")
INTEROP_PYTHON = Path(__file__).parents[1] / ".venv" / "interop" / "bin" / "python"
PRINTER_MODEL = "ultimaker2_plus"
PRINTCORE_SCRIPT = Path(__file__).parents[1] / "tests" / "interop" / "peers" / "printcore_peer.py"
START_GCODE = "G21\nG90\nM82\nM107\nG28\nM109 S180\nG1 F2400 Z20\nG92 E0\n"
# The nozzle stays cold, and moves take less time than their bytes, so only the link is measured.
COMPARISON_START_GCODE = (
    "G21\nG90\nM82\nM107\nG28\nM302 S0\nM109 S30\nG1 F2400 Z205\nG92 E0\nG0 F9000 X10 Y10\nM400\n"
)
COMPARISON_ROUNDS = 3
END_GCODE = "M104 S0\nM140 S0\nG28\nM84\n"


async def print_file(
    folder: Path, clock: Clock, gcode: Path, url: str = f"sim://{PRINTER_MODEL}", keep_emulator: bool = False
) -> tuple[float, float, float]:
    """Print on one printer; return the wall times of first and last line, and the agent's CPU seconds."""
    process = spawn_agent(folder.name, PRINTER_MODEL, url, folder, clock)
    client = AgentClient(folder)
    try:
        await client.connect()
        start_s = end_s = start_cpu_s = end_cpu_s = 0.0
        async for snapshot in follow_print(client, make_start_request(gcode)):
            if snapshot.phase is m.PrintPhase.PRINTING and not start_s:
                start_s, start_cpu_s = time.time(), read_cpu_s(process.pid)
            if snapshot.phase is m.PrintPhase.ENDING and not end_s:
                end_s, end_cpu_s = time.time(), read_cpu_s(process.pid)
    finally:
        # The heaters are switched off and no process keeps running, even after a failure.
        with suppress(DriverError):
            await client.request(m.Shutdown(id=0, now=True))
        await client.close()
        await asyncio.to_thread(process.wait, 30.0)
        if not keep_emulator:
            control(folder / "emulator", "power_off")
    return start_s, end_s, end_cpu_s - start_cpu_s


async def measure(agents: int, lines: int, scale: float) -> dict[str, float]:
    """Print on all agents at the same time; return lines per second and CPU time per line."""
    moves = "".join(
        f"G1 X{100 + i % 2 * 0.2:.3f} Y{100 + i % 7 * 0.1:.3f} E{i * 0.01:.5f}\n" for i in range(lines)
    )
    text = (START_GCODE + "G0 F9000 X100 Y100 Z0.3\n" + moves + END_GCODE).encode()
    with tempfile.TemporaryDirectory() as folder:
        gcode = Path(folder) / "bench.gcode"
        gcode.write_bytes(text)
        clock = Clock(scale, time.time())
        runs = await asyncio.gather(
            *(print_file(Path(folder) / f"p{number}", clock, gcode) for number in range(agents))
        )
    duration_s = max(run[1] for run in runs) - min(run[0] for run in runs)
    return {
        "agents": agents,
        "lines": agents * lines,
        "wall_s": round(duration_s, 2),
        "lines_per_s": round(agents * lines / duration_s),
        "agent_cpu_us_per_line": round(1e6 * sum(run[2] for run in runs) / (agents * lines), 1),
    }


def compare_with_printcore(lines: int, python: Path) -> dict[str, float]:
    """Print the same moves on the same emulator with an agent and with printcore in turn; return medians."""
    moves = "".join(
        f"G1 F18000 X{10 + abs(i % 1200 - 600) * 0.3:.3f} Y{10 + i // 600 * 0.5:.3f} E{i * 0.01:.5f}\n"
        for i in range(lines)
    )
    with tempfile.TemporaryDirectory() as folder:
        whole_file, head_file, moves_file = (
            Path(folder) / name for name in ("whole.gcode", "head.gcode", "moves.gcode")
        )
        whole_file.write_text(COMPARISON_START_GCODE + moves + "M104 S0\n")  # no G28, whose time would count
        head_file.write_text(COMPARISON_START_GCODE)
        moves_file.write_text(moves)
        printer_folder = Path(folder) / "p"
        agent_rates, printcore_rates = [], []
        try:
            for _ in range(COMPARISON_ROUNDS):  # in turn, so that other load affects both
                url = f"sim://{PRINTER_MODEL}?wire=1"
                start_s, end_s, _ = asyncio.run(
                    print_file(printer_folder, Clock(), whole_file, url, keep_emulator=True)
                )
                agent_rates.append(lines / (end_s - start_s))
                control(printer_folder / "emulator", "clear_bed")
                command = [
                    str(python),
                    str(PRINTCORE_SCRIPT),
                    str(printer_folder / "emulator" / "tty"),
                    str(moves_file),
                    str(head_file),
                ]
                printcore_rates.append(
                    lines / float(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
                )
                shutil.rmtree(printer_folder / "spool")
                (printer_folder / "journal.jsonl").unlink()
        finally:
            control(printer_folder / "emulator", "power_off")
    return {
        "wire_lines_per_s": round(median(agent_rates), 1),
        "wire_printcore_lines_per_s": round(median(printcore_rates), 1),
        "wire_ratio": round(median(agent_rates) / median(printcore_rates), 3),
    }


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--part", action="append", choices=PARTS, help="part to measure, may be repeated; default: all"
    )
    parser.add_argument("--agents", type=int, default=8)
    parser.add_argument("--lines", type=int, default=10_000, help="lines of each agent")
    parser.add_argument("--scale", type=float, default=300.0, help="farm seconds per wall second")
    parser.add_argument("--beside", type=Path, default=INTEROP_PYTHON, help="a Python that has Printrun")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    measurements: dict[str, Callable[[], dict[str, float]]] = {
        "throughput": lambda: asyncio.run(measure(options.agents, options.lines, options.scale)),
        "printcore": lambda: compare_with_printcore(options.lines, options.beside),
        "agent": lambda: asyncio.run(agent.measure(options.agents, 1000, 50.0)),
        "peers": lambda: asyncio.run(agent.measure(50, 1000, 50.0)),
        "memory": lambda: asyncio.run(agent.measure(1, 1000, 50.0, megabytes=50)),
        "estop": lambda: estop.measure(2),
    }
    if options.part is None and not options.beside.exists():
        del measurements["printcore"]
    results = {part: measurements[part]() for part in options.part or measurements}
    if options.json:
        print(json.dumps({"schema": 1, **results}))
        return
    for part, result in results.items():
        print(part)
        for name, value in result.items():
            print(f"  {name}: {value}")


if __name__ == "__main__":
    main()
