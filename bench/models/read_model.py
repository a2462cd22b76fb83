"""CPU time and memory that are needed to read a large model, check it and convert it to a solid.

Usage: python -m bench.models.read_model [--million N] [--json]

The model is a torus as a binary STL, 50 bytes per triangle. It is read in its own process, whose CPU and
largest resident memory are measured.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

import trimesh

from bench.search.peak_memory import read_peak_mb
from decompose.geometry.model import load_model


def write_torus(path: Path, triangles: int) -> None:
    """Write a torus of about this many triangles, with three times as many major as minor sections."""
    minor_sections = round((triangles / 6) ** 0.5)
    torus = trimesh.creation.torus(
        100.0, 40.0, major_sections=3 * minor_sections, minor_sections=minor_sections
    )
    path.write_bytes(trimesh.exchange.stl.export_stl(torus))


def read_torus(path: Path, pipe: Connection) -> None:
    """Read a model, and send the time and memory of reading."""
    begin_cpu_s, begin_s = time.process_time(), time.perf_counter()
    model = load_model(path)
    result = {
        "file_mb": path.stat().st_size / 1e6,
        "cpu_s": time.process_time() - begin_cpu_s,
        "elapsed_s": time.perf_counter() - begin_s,
        "peak_mb": read_peak_mb(),
        "triangles": len(model.solid.arrays()[1]),
    }
    pipe.send(result)


def measure(triangles: int) -> dict[str, float]:
    """Write the model in one process and read it in another, so that neither affects the other's figures."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "torus.stl"
        for target, args in ((write_torus, (path, triangles)), (read_torus, (path, sender))):
            process = context.Process(target=target, args=args)
            process.start()
            process.join()
            if process.exitcode != 0:
                raise SystemExit(f"{target.__name__} ended with {process.exitcode}")
    result: dict[str, float] = receiver.recv()
    return result


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--million", type=float, default=6.0, help="triangles, in millions")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    result = measure(round(1e6 * args.million))
    if args.json:
        print(json.dumps(result, indent=2))
    else:
        print(*(f"{name}: {value:.6g}" for name, value in result.items()), sep="\n")


if __name__ == "__main__":
    main()
