"""Unusual models and numbers of printers: each quickly yields parts, or a refusal that suggests a change.

Usage: python -m bench.search.edge_cases [--only sheet,rod,...] [--budget 20] [--json]

The cases are a sheet of 450 x 450 x 1 mm, a rod of 2 m, a vase, ten bodies, a sphere, 1 and 100 printers, and
`auto`. Nothing is sliced. `wall_s` and `cpu_s` are measured from the model in memory to the checked parts.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from time import perf_counter, process_time

from bench.models.shapes import make_ellipsoid
from bench.unseen import USABLE_VOLUMES_MM
from decompose.auto import decompose_for_goal
from decompose.decompose import decompose_model
from decompose.errors import DecomposeError
from decompose.geometry import Model, Solid
from decompose.options import BUDGET_S, BestOptions, Options
from decompose.print_time import CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter


@dataclass(frozen=True, slots=True)
class Case:
    """Model and number of printers, and whether the number of parts is chosen automatically."""

    make: Callable[[], Solid]
    printers: int = 20
    auto: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a case: the makespan of its parts, or a refusal."""

    name: str
    printers: int
    parts: int | None
    makespan_s: float | None
    effort_s: float | None
    wall_s: float
    cpu_s: float
    refusal: str = ""


def _make_sphere() -> Solid:
    """Make a sphere of 300 mm."""
    return make_ellipsoid((0.0, 0.0, 0.0), (150.0, 150.0, 150.0))


def _make_vase() -> Solid:
    """Make an open vessel with a wall of 3 mm."""
    outer = make_ellipsoid((0.0, 0.0, 0.0), (90.0, 90.0, 200.0))
    inner = make_ellipsoid((0.0, 0.0, 0.0), (87.0, 87.0, 197.0))
    return outer.subtract(inner).clip((-200.0, -200.0, -150.0), (200.0, 200.0, 120.0))


def _make_ten_bodies() -> Solid:
    """Make ten separate ellipsoids of different heights."""
    return Solid.union(
        [
            make_ellipsoid((90.0 * (i % 5), 100.0 * (i // 5), 0.0), (40.0, 45.0, 25.0 + 10.0 * i))
            for i in range(10)
        ]
    )


CASES: Mapping[str, Case] = {
    "sheet": Case(lambda: Solid.box((0.0, 0.0, 0.0), (450.0, 450.0, 1.0))),
    "rod": Case(lambda: Solid.box((0.0, 0.0, 0.0), (2000.0, 20.0, 20.0))),
    "vase": Case(_make_vase),
    "ten-bodies": Case(_make_ten_bodies),
    "sphere": Case(_make_sphere),
    "one-printer": Case(_make_sphere, printers=1),
    "hundred-printers": Case(_make_sphere, printers=100),
    "auto": Case(_make_vase, printers=100, auto=True),
}


def run_case(name: str, case: Case, budget_s: float) -> Outcome:
    """Decompose the model of a case with default options."""
    model = Model(case.make(), (), 1.0)
    printers = [TargetPrinter(str(number), USABLE_VOLUMES_MM) for number in range(case.printers)]
    options = Options(best=BestOptions(budget_s))
    decompose = decompose_for_goal if case.auto else decompose_model
    start_s, start_cpu_s = perf_counter(), process_time()
    parts, makespan_s, effort_s, refusal = None, None, None, ""
    with ThreadPoolExecutor(os.cpu_count()) as executor:
        try:
            result = decompose(
                model, printers, options, CostModel.from_settings(PrintTimeSettings()), executor
            )
            parts, makespan_s = len(result.parts), result.makespan_s
            effort_s = sum(attempt.effort_s for attempt in result.attempts)
        except DecomposeError as error:
            refusal = str(error)
    wall_s, cpu_s = perf_counter() - start_s, process_time() - start_cpu_s
    return Outcome(name, case.printers, parts, makespan_s, effort_s, wall_s, cpu_s, refusal)


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default=",".join(CASES))
    parser.add_argument("--budget", type=float, default=BUDGET_S)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    outcomes = []
    for name in options.only.split(","):
        row = run_case(name, CASES[name], options.budget)
        outcomes.append(row)
        if not options.json:
            figures = row.refusal or f"{row.parts} parts, {row.makespan_s:.0f} s, effort {row.effort_s:.1f} s"
            print(f"{name:16} {figures}; {row.wall_s:.0f} s of wall, {row.cpu_s:.0f} s of CPU")
            sys.stdout.flush()
    if options.json:
        print(json.dumps([asdict(row) for row in outcomes], indent=1))


if __name__ == "__main__":
    main()
