"""What the decomposition reaches: makespan, efficiency, bound and compute time of some models and printers.

Usage: python -m bench.decompose [--granularity G] [--engine E] [--score S] [--faithful] [--json]
       MODEL:LONGEST_SIDE_MM:PLUS:EXTENDED ...

PLUS and EXTENDED are the numbers of Ultimaker 2+ and 2 Extended+.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

from bench.print_time_parts import recipe_of
from decompose.cost import CostModel, PrinterRoom
from decompose.growth import Score
from decompose.mesh import load_model
from decompose.partition import decompose
from decompose.report import Engine, Options
from drivers.profiles import PROFILES, part_room


@dataclass(frozen=True, slots=True)
class Figures:
    """One model on one fleet. `efficiency` is serial time over printers times makespan."""

    model: str
    longest_side_mm: float
    printers: int
    parts: int
    cells: tuple[int, int, int]
    load_s: float
    stages_s: dict[str, float]
    serial_s: float
    makespan_s: float
    sum_s: float
    grid_makespan_s: float
    lower_bound_s: float
    gap: float
    efficiency: float
    speed_up: float
    surface_error: float


def rooms(plus: int, extended: int, brim_mm: float) -> list[PrinterRoom]:
    models = ["ultimaker2_plus"] * plus + ["ultimaker2_extended_plus"] * extended
    return [
        PrinterRoom(str(i), tuple(b.size_mm for b in part_room(PROFILES[m], brim_mm)))
        for i, m in enumerate(models)
    ]


def measure(
    path: Path, side_mm: float, printers: list[PrinterRoom], options: Options, cost: CostModel
) -> Figures:
    start = perf_counter()
    model = load_model(path, longest_side_mm=side_mm)
    loaded_s = perf_counter() - start
    with ThreadPoolExecutor(os.cpu_count()) as executor:
        result = decompose(model, printers, options, cost, executor)
    return Figures(
        model=path.stem,
        longest_side_mm=side_mm,
        printers=len(printers),
        parts=len(result.parts),
        cells=result.cells,
        load_s=loaded_s,
        stages_s=result.compute_s,
        serial_s=result.serial_s,
        makespan_s=result.makespan_s,
        sum_s=result.sum_s,
        grid_makespan_s=result.grid_makespan_s,
        lower_bound_s=result.lower_bound_s,
        gap=result.gap,
        efficiency=result.serial_s / (len(printers) * result.makespan_s),
        speed_up=result.serial_s / result.makespan_s,
        surface_error=result.coverage.surface_error,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="+")
    parser.add_argument("--granularity", default="auto")
    parser.add_argument("--engine", type=Engine, choices=list(Engine), default=Engine.GUILLOTINE)
    parser.add_argument("--score", type=Score, choices=list(Score), default=Score.LOW)
    parser.add_argument("--faithful", action="store_true", help="parallelobox with the paper's settings")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    glue = recipe_of("glue")
    cost = CostModel.from_recipe(glue)
    options = Options(args.engine, args.granularity, score=args.score, faithful=args.faithful)
    figures = []
    for item in args.models:
        path, side, plus, extended = item.rsplit(":", 3)
        fleet = rooms(int(plus), int(extended), glue.brim_mm)
        figures.append(measure(Path(path), float(side), fleet, options, cost))
    if args.json:
        print(json.dumps({"schema": 1, "figures": [asdict(f) for f in figures]}, indent=1))
        return 0
    for f in figures:
        print(
            f"{f.model:24} {f.longest_side_mm:4.0f} mm, {f.parts} parts on {f.printers}: makespan "
            f"{f.makespan_s:.0f} s, by the tables {f.grid_makespan_s:.0f} s, bound {f.lower_bound_s:.0f} s, "
            f"gap {f.gap:.1%}, E {f.efficiency:.2f}, sum {f.sum_s:.0f} s"
        )
        stages = ", ".join(f"{k} {v:.2f}" for k, v in {"load": f.load_s, **f.stages_s}.items())
        print(f"{'':24} {'x'.join(map(str, f.cells))} cells; seconds: {stages}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
