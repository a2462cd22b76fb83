"""Time for the curve of makespan over the number of printers, and for the proof of a bound.

Usage: python -m bench.search.curve MODEL [--most 100] [--printers 20] [--side 450] [--json]

The curve is for 1 to --most printers, the bound for --printers. Times are wall and CPU seconds, on a machine
without other load.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from bench.prices.parts import make_print_time_settings
from bench.search.peak_memory import read_peak_mb
from decompose.bound import bound_makespan
from decompose.engines.guillotine import Partitioner, compute_makespan_curve
from decompose.geometry import load_model
from decompose.options import Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Problem
from drivers.printers import PROFILES, list_usable_volumes

PRINTER_MODEL = "ultimaker2_plus"


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("--most", type=int, default=100)
    parser.add_argument("--printers", type=int, default=20)
    parser.add_argument("--side", type=float, default=450.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    time_settings = make_print_time_settings("paper")
    box_sizes_mm = tuple(
        box.size_mm for box in list_usable_volumes(PROFILES[PRINTER_MODEL], time_settings.brim_mm)
    )
    printers = tuple(TargetPrinter(str(i), box_sizes_mm) for i in range(options.printers))
    model = load_model(options.model, longest_side_mm=options.side)
    problem = Problem(model, printers, CostModel.from_settings(time_settings), Options())
    times_s: dict[str, dict[str, float]] = {}

    def measure_stage(stage: str, compute: Callable[[], Any]) -> Any:
        start_s, start_cpu_s = perf_counter(), process_time()
        result = compute()
        times_s[stage] = {"wall_s": perf_counter() - start_s, "cpu_s": process_time() - start_cpu_s}
        return result

    grid = measure_stage("grid", lambda: problem.build_grid(model))
    problem.price_boxes(grid)  # compiles, or loads compiled code
    boxes = measure_stage("boxes", lambda: problem.price_boxes(grid))
    solver = Partitioner(boxes)
    for break_ties in (False, True):
        solver.solve(0.0, break_ties)
    printer_counts = np.arange(1, options.most + 1)[:, None]  # of equal printers
    with ThreadPoolExecutor(os.cpu_count()) as executor:
        points = measure_stage("curve", lambda: compute_makespan_curve([boxes], printer_counts, executor))
    report: dict[str, Any] = {"cells": grid.shape, "boxes": len(boxes.seconds), "stages": times_s}
    if measure_stage("search", lambda: solver.find_min_makespan_s(options.printers, 0.0)) is not None:
        makespan_s = solver.find_longest_time_s()
        proven = measure_stage(
            "bound", lambda: bound_makespan(boxes, grid.is_needed, options.printers, makespan_s)
        )
        report |= {"makespan_s": makespan_s, "bound_s": proven.seconds}
    report["peak_mb"] = read_peak_mb()
    report["curve"] = [[point.printer_count, point.makespan_s] for point in points]
    if options.json:
        print(json.dumps(report))
        return
    print(f"{report['boxes']} boxes of {grid.shape} cells; peak {report['peak_mb']:.0f} MB")
    for stage, times in times_s.items():
        print(f"{stage:>8}: {times['wall_s']:6.1f} s, {times['cpu_s']:6.1f} s of CPU")


if __name__ == "__main__":
    main()
