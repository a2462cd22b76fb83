"""Expected and actual time of a job on simulated printers, by the daemon's own figures.

A separate farm is started in a temporary folder, with the real daemon, agents, CuraEngine and emulators. A
run in which the emulators waited for this machine for more than 1 % of the time is not valid: use a lower
--time-scale.

Usage: python -m bench.fleets.job_times [--printers N] [--time-scale S] [--json]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import trimesh

FARM = Path(sys.executable).with_name("farm")
PRINTER_MODEL = "ultimaker2_plus"
LENGTH_MM, WIDTH_MM, HEIGHT_MM = 40.0, 18.0, 12.0  # about half an hour for each printer
MAX_STARVED_SHARE = 0.01  # share of the time in which emulators waited
TIMEOUT_S = 3600.0


def run_farm(state: Path, *arguments: str) -> str:
    """Run a farm command on the state folder."""
    command = [str(FARM), *arguments, "--state", str(state)]
    process = subprocess.run(command, check=False, capture_output=True, text=True, timeout=TIMEOUT_S)
    if process.returncode:
        sys.exit(f"farm {arguments[0]}: {process.stderr.strip()}")
    return process.stdout


def run(folder: Path, printers: int, time_scale: float) -> dict[str, Any]:
    """Print a bar that needs all printers; return the job at its end."""
    state, fleet, model = folder / "state", folder / "fleet.yaml", folder / "bar.stl"
    rows = "".join(
        f"  - {{name: sim-{i}, model: {PRINTER_MODEL}, port: 'sim://{PRINTER_MODEL}'}}\n"
        for i in range(printers)
    )
    fleet.write_text(f"fleet: {{time_scale: {time_scale:g}}}\nprinters:\n{rows}")
    trimesh.creation.box((LENGTH_MM * printers, WIDTH_MM, HEIGHT_MM)).export(model)
    run_farm(state, "up", "--fleet", str(fleet))
    try:
        result = run_farm(state, "submit", str(model), "--printers", str(printers), "--wait", "--json")
        job = json.loads(result)["job"]
        prints = json.loads(run_farm(state, "history", "--json"))["prints"]
        status_printers = json.loads(run_farm(state, "status", "--json"))["printers"]
    finally:
        run_farm(state, "down", "--now")
    return {
        "expected_s": job["estimated_s"],
        "actual_s": job["elapsed_s"],
        "error": job["elapsed_s"] / job["estimated_s"] - 1,
        "starved_share": job["starved_share"],
        "valid": job["starved_share"] <= MAX_STARVED_SHARE,
        "wasted_s": job["wasted_s"],
        "prints": [
            {
                "printer": printer["printer"],
                "expected_s": printer["expected_s"],
                "actual_s": printer["took_s"],
                "error": printer["took_s"] / printer["expected_s"] - 1,
            }
            for printer in prints
        ],
        "time_factors": {printer["name"]: printer["time_factor"] for printer in status_printers},
    }


def main() -> None:
    """Run the job, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--printers", type=int, default=3)
    parser.add_argument("--time-scale", type=float, default=60.0)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        figures = run(Path(folder), arguments.printers, arguments.time_scale)
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    print(
        f"expected {figures['expected_s']:.0f} s, actual {figures['actual_s']:.0f} s: {figures['error']:+.1%}"
    )
    for row in figures["prints"]:
        print(f"  {row['printer']}: {row['expected_s']:.0f} s, {row['actual_s']:.0f} s: {row['error']:+.1%}")
    validity = "valid" if figures["valid"] else "not valid"
    print(f"emulators waited {figures['starved_share']:.2%} of the time: {validity}")


if __name__ == "__main__":
    main()
