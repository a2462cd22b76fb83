"""Time until `farm estop` has set all targets to 0, with daemon and agents stopped by SIGSTOP.

``python -m bench.printing.estop [--printers N] [--json]``. The farm consists of real processes and of
emulators whose heaters are on. The time is measured from the start of the command until all targets are 0 in
the status of the emulators.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.printing.followed_print import follow_print, make_start_request
from drivers import messages as m
from drivers.emulator.launch import control, is_running, read_status
from drivers.remote import AgentClient, find_agent_pid, kill_agent

PRINTER_MODEL = "ultimaker2_plus"
FARM = Path(sys.executable).with_name("farm")
START_GCODE = "G21\nG90\nM82\nM107\nM140 S60\nG28\nM190 S60\nM109 S210\nG1 F2400 Z20\nG92 E0\n"
TIMEOUT_S = 120.0


async def start_print(folder: Path, gcode: Path) -> None:
    """Start a print on an agent, and wait until it has heated and prints."""
    client = AgentClient(folder)
    await client.connect(60.0)
    async with asyncio.timeout(TIMEOUT_S):
        async for snapshot in follow_print(client, make_start_request(gcode, 60.0)):
            if snapshot.phase is m.PrintPhase.PRINTING:
                break
    await client.close()


def is_hot(folder: Path) -> bool:
    """Check whether the emulator in an agent's folder has a target above 0."""
    status = read_status(folder / "emulator")
    return bool(status.nozzle_target_c or status.bed_target_c)


async def start_prints(folders: list[Path], gcode: Path) -> None:
    """Start a print on all agents, and wait until they print."""
    await asyncio.gather(*(start_print(folder, gcode) for folder in folders))


def measure(printers: int) -> dict[str, float]:
    """Start a farm, heat it, stop its processes, and measure the emergency stop."""
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        state, fleet, gcode = root / "state", root / "fleet.yaml", root / "a.gcode"
        rows = "".join(
            f"  - {{name: p{i}, model: {PRINTER_MODEL}, port: 'sim://{PRINTER_MODEL}'}}\n"
            for i in range(printers)
        )
        fleet.write_text(f"fleet: {{time_scale: 60}}\nprinters:\n{rows}")
        moves = (f"G1 F6000 X{50 + i % 2 * 100} Y{50 + i % 100} Z0.3 E{i * 0.5}\n" for i in range(100_000))
        gcode.write_text(START_GCODE + "".join(moves))
        path_options = ["--state", str(state), "--fleet", str(fleet)]
        subprocess.run([FARM, "up", *path_options], check=True, stdout=subprocess.DEVNULL)
        folders = [state / "agents" / f"p{i}" for i in range(printers)]
        daemon_pid = int((state / "lock").read_text())
        try:
            asyncio.run(start_prints(folders, gcode))
            for pid in (daemon_pid, *(find_agent_pid(folder) for folder in folders)):
                assert pid is not None
                os.kill(pid, signal.SIGSTOP)
            assert all(map(is_hot, folders))
            start_s = time.monotonic()
            process = subprocess.Popen([FARM, "estop", "--json", *path_options], stdout=subprocess.PIPE)
            while any(map(is_hot, folders)) and time.monotonic() < start_s + TIMEOUT_S:
                time.sleep(0.002)
            targets_off_s = time.monotonic() - start_s
            report = json.loads(process.communicate()[0])
            reported_off_s = time.monotonic() - start_s
        finally:
            os.kill(daemon_pid, signal.SIGKILL)
            for folder in folders:
                kill_agent(folder)
                if is_running(folder / "emulator"):
                    control(folder / "emulator", "power_off")
    return {
        "printers": printers,
        "targets_0_after_s": round(targets_off_s, 3),
        "all_seen_off_after_s": round(reported_off_s, 3),
        "seen_off": sum(row["seen_off"] for row in report["printers"]),
    }


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--printers", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = measure(options.printers)
    print(
        json.dumps({"schema": 1, **result})
        if options.json
        else "\n".join(f"{k}: {v}" for k, v in result.items())
    )


if __name__ == "__main__":
    main()
