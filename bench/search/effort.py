"""Counted effort of decomposition compared with CPU time, and the price of each kind of work.

Usage: python -m bench.search.effort MODEL... [--printers 8,20] [--engines guillotine,parallelobox]
       [--side 450] [--json]

Every search runs without a budget in one thread. `fit_ns` are the prices, at least 0, that fit these runs
best by least squares of the relative errors; `problem.effort.WORK_NS` was derived from them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from scipy.optimize import nnls

from bench.prices.parts import make_print_time_settings
from decompose.decompose import ENGINES
from decompose.errors import NoFit
from decompose.geometry import Model, Solid, load_model
from decompose.options import Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Effort, Problem, Work
from drivers.printers import PROFILES, list_usable_volumes

PRINTER_MODEL = "ultimaker2_plus"


def measure_search(problem: Problem) -> tuple[Effort, dict[str, float]]:
    """Measure the counted effort of a search, and the CPU seconds until the end of each of its stages."""
    effort, stage_ends_s, start_s = Effort(), {}, process_time()

    def record_stage_end(stage: str) -> None:
        stage_ends_s[stage] = process_time() - start_s

    try:
        ENGINES[problem.options.engine](replace(problem, effort=effort, on_stage=record_stage_end))
    except NoFit as error:
        print(f"{problem.options.engine}: {error}", file=sys.stderr)
    record_stage_end("all")
    return effort, stage_ends_s


def fit_prices(runs: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Fit the nanoseconds per unit of each kind of work."""
    kinds = [str(work) for work in Work]
    rows = np.array([[run["done"].get(kind, 0) / run["cpu_s"] for kind in kinds] for run in runs])
    scale = np.maximum(rows.max(axis=0), 1e-12)
    solution, _ = nnls(rows / scale, np.ones(len(runs)))
    return dict(zip(kinds, (solution / scale * 1e9).round(1).tolist(), strict=True))


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--printers", type=lambda t: [int(n) for n in t.split(",")], default=[8, 20])
    parser.add_argument(
        "--engines", type=lambda t: [Engine(e) for e in t.split(",")],
        default=[Engine.GUILLOTINE, Engine.PARALLELOBOX],
    )  # fmt: skip
    parser.add_argument("--side", type=float, default=450.0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    time_settings = make_print_time_settings("paper")
    cost = CostModel.from_settings(time_settings)
    box_sizes_mm = tuple(
        box.size_mm for box in list_usable_volumes(PROFILES[PRINTER_MODEL], time_settings.brim_mm)
    )
    small_model = Model(Solid.box((0.0, 0.0, 0.0), (300.0, 60.0, 60.0)), (), 1.0)
    for engine in options.engines:  # compiles, or loads compiled code
        target_printers = tuple(TargetPrinter(str(i), box_sizes_mm) for i in range(4))
        measure_search(Problem(small_model, target_printers, cost, Options(engine, 5)))
    runs: list[dict[str, Any]] = []
    for path in options.models:
        model = load_model(path, longest_side_mm=options.side)
        for printers in options.printers:
            for engine in options.engines:
                target_printers = tuple(TargetPrinter(str(i), box_sizes_mm) for i in range(printers))
                effort, stage_ends_s = measure_search(Problem(model, target_printers, cost, Options(engine)))
                cpu_s = stage_ends_s["all"]
                units_by_work = {str(work): units for work, units in effort.done_units.items()}
                run = {"model": path.stem, "printers": printers, "engine": str(engine), "cpu_s": cpu_s}
                runs.append(run | {"effort_s": effort.spent_s, "ends_s": stage_ends_s, "done": units_by_work})
                if not options.json:
                    times_text = f"{effort.spent_s:6.1f} s counted, {cpu_s:6.1f} s of CPU"
                    print(f"{path.stem:20} N {printers:3} {engine:13} {times_text}", flush=True)
    report = {"schema": 1, "runs": runs, "fit_ns": fit_prices(runs)}
    print(json.dumps(report, indent=1) if options.json else json.dumps(report["fit_ns"], indent=1))


if __name__ == "__main__":
    main()
