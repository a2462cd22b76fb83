"""Time and memory of `farm decompose` for a model with millions of triangles.

Usage: python -m bench.models.detailed_model [--million N] [--printers N] [--json]

The model is a torus with waves of several sizes, written as a binary STL and scaled to 450 mm. The memory is
the largest resident memory of the process.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trimesh


def write_wavy_torus(path: Path, triangles: int) -> None:
    """Write a torus with waves, of about this many triangles."""
    minor_count = round((triangles / 4) ** 0.5)
    major_count = 2 * minor_count
    major, minor = np.indices((major_count, minor_count)).reshape(2, -1)
    theta, phi = 2.0 * np.pi * major / major_count, 2.0 * np.pi * minor / minor_count
    radius = 40.0 + 6.0 * np.sin(5 * theta) * np.cos(3 * phi) + 2.0 * np.sin(40 * theta) * np.sin(30 * phi)
    ring = 150.0 + radius * np.cos(phi)
    vertices = np.column_stack([ring * np.cos(theta), ring * np.sin(theta), radius * np.sin(phi)])

    def find_vertex(major_step: int, minor_step: int) -> np.ndarray:
        return (major + major_step) % major_count * minor_count + (minor + minor_step) % minor_count

    a, b, c, d = find_vertex(0, 0), find_vertex(1, 0), find_vertex(1, 1), find_vertex(0, 1)
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    torus = trimesh.Trimesh(vertices, faces, process=False)
    path.write_bytes(trimesh.exchange.stl.export_stl(torus))


def measure(triangles: int, printer_count: int) -> dict[str, float]:
    """Write the model, decompose it, and return the figures."""
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "torus.stl", Path(folder) / "out"
        # In its own process, because the memory of a process counts for those that it starts.
        writer = multiprocessing.get_context("spawn").Process(target=write_wavy_torus, args=(path, triangles))
        writer.start()
        writer.join()
        if writer.exitcode != 0:
            raise SystemExit(f"writing the model ended with {writer.exitcode}")
        command = [str(Path(sys.executable).with_name("farm")), "decompose", str(path), "--out", str(out)]
        command += ["--printers", str(printer_count), "--longest-side", "450"]
        begin_s = time.perf_counter()
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)  # without the process that wrote the model
        process.returncode = os.waitstatus_to_exitcode(status)
        elapsed_s = time.perf_counter() - begin_s
        if process.returncode != 0:
            raise SystemExit(f"farm decompose ended with {process.returncode}")
        decomposition = json.loads((out / "decomposition.json").read_text())
    return {
        "elapsed_s": elapsed_s,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "peak_mb": usage.ru_maxrss / 1e3,
        "makespan_s": decomposition["makespan_s"],
    }


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--million", type=float, default=5.0, help="triangles, in millions")
    parser.add_argument("--printers", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    result = measure(round(1e6 * args.million), args.printers)
    if args.json:
        print(json.dumps(result, indent=2))
    else:
        print(*(f"{name}: {value:.6g}" for name, value in result.items()), sep="\n")


if __name__ == "__main__":
    main()
