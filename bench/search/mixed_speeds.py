"""Makespan of a fleet with slow printers, compared with the ideal for its total speed.

Usage: python -m bench.search.mixed_speeds MODEL... [--printers 20] [--slow 4] [--factor 2] [--side 450]
       [--budget S] [--json]

The ideal is the makespan of as many equal printers, multiplied by the ratio of the total speeds. The ratio
of the ideal to the makespan is 1 if slow printers cost no more than their speed. It can exceed 1, because
another fleet leads to other cuts. Times are prices of the cost model, with default settings; nothing is
sliced.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from bench.unseen import USABLE_VOLUMES_MM
from decompose.decompose import decompose_model
from decompose.geometry import Model, load_model
from decompose.options import BUDGET_S, BestOptions, Options
from decompose.print_time import CostModel, PrintTimeSettings
from decompose.printers import TargetPrinter


@dataclass(frozen=True, slots=True)
class Figures:
    """Makespans of equal printers and of the mixed fleet, and the ratio of the ideal to the latter."""

    model: str
    equal_s: float
    mixed_s: float
    ideal_ratio: float


def find_makespan_s(model: Model, time_factors: list[float], budget_s: float, executor: Executor) -> float:
    """Decompose a model for printers with these time factors; return the makespan in seconds."""
    target_printers = [
        TargetPrinter(str(i), USABLE_VOLUMES_MM, factor) for i, factor in enumerate(time_factors)
    ]
    options, cost = Options(best=BestOptions(budget_s)), CostModel.from_settings(PrintTimeSettings())
    return decompose_model(model, target_printers, options, cost, executor).makespan_s


def measure(path: Path, time_factors: list[float], side_mm: float, budget_s: float) -> Figures:
    """Decompose one model for equal printers, and for printers with these time factors."""
    model = load_model(path, longest_side_mm=side_mm)
    with ThreadPoolExecutor() as executor:
        equal_s = find_makespan_s(model, [1.0] * len(time_factors), budget_s, executor)
        mixed_s = find_makespan_s(model, time_factors, budget_s, executor)
    ideal_s = equal_s * len(time_factors) / sum(1.0 / factor for factor in time_factors)
    return Figures(path.name, equal_s, mixed_s, ideal_s / mixed_s)


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", nargs="+", type=Path)
    parser.add_argument("--printers", type=int, default=20)
    parser.add_argument("--slow", type=int, default=4)
    parser.add_argument("--factor", type=float, default=2.0)
    parser.add_argument("--side", type=float, default=450.0)
    parser.add_argument("--budget", type=float, default=BUDGET_S)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    time_factors = [1.0] * (options.printers - options.slow) + [options.factor] * options.slow
    rows = []
    for path in options.models:
        row = measure(path, time_factors, options.side, options.budget)
        rows.append(row)
        if not options.json:
            print(f"{row.model}: {row.equal_s:.0f} s with equal printers, {row.mixed_s:.0f} s, "
                  f"ideal / actual {row.ideal_ratio:.3f}", flush=True)  # fmt: skip
    if options.json:
        print(json.dumps([asdict(row) for row in rows], indent=1))


if __name__ == "__main__":
    main()
