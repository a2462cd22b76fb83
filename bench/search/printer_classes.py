"""Gain of cutting each part for the volume and speed of its own printer, over cutting for the smallest.

Usage: python -m bench.search.printer_classes MODEL... [--plus 16] [--extended 4] [--wide 0] [--spread 0.1]
       [--side 450] [--cells auto] [--json]

Makespans are those of the cost model, with each part on its printer. "Shared" is a cut for equal printers
with the smallest volume and one speed, whose parts are then assigned so that the makespan is shortest.
`--spread` is the share by which the time factors of the printers are spread evenly around 1, in random order.
`--wide` is the number of Ultimaker 2+ with a wide nozzle, with which a part takes 0.45 of the time.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from bench.prices.parts import make_print_time_settings
from decompose.engines.guillotine import cut_by_guillotine
from decompose.engines.guillotine.exact_search import cut_for_uniform_printers
from decompose.errors import NoFit
from decompose.geometry import load_model
from decompose.options import Engine, Options
from decompose.pieces import assign_printers
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.problem import Partition, Problem
from drivers.printers import PROFILES, list_usable_volumes

WIDE_TIME_RATIO = 0.45


def make_fleet(
    plus_count: int, extended_count: int, wide_count: int, spread: float, brim_mm: float
) -> tuple[TargetPrinter, ...]:
    """Make a fleet in which the first `wide_count` Ultimaker 2+ have a wide nozzle."""
    factors = 1.0 + spread * np.linspace(-1.0, 1.0, plus_count + extended_count)
    np.random.default_rng(0).shuffle(factors)
    factors[:wide_count] *= WIDE_TIME_RATIO
    models = ["ultimaker2_plus"] * plus_count + ["ultimaker2_extended_plus"] * extended_count
    box_sizes_mm = {
        name: tuple(b.size_mm for b in list_usable_volumes(PROFILES[name], brim_mm)) for name in set(models)
    }
    return tuple(
        TargetPrinter(f"{name}-{i}", box_sizes_mm[name], float(factor))
        for i, (name, factor) in enumerate(zip(models, factors, strict=True))
    )


def compute_makespan_s(problem: Problem, partition: Partition) -> float:
    """Compute the end of the last part on the printers of a problem."""
    poses = [pose for pose in problem.find_poses(list(partition.pieces)) if pose is not None]
    assigned_printers = assign_printers(poses, problem.printers)
    assert len(poses) == len(partition.pieces)
    assert assigned_printers is not None
    return max(
        pose.price_s * printer.time_factor for pose, printer in zip(poses, assigned_printers, strict=True)
    )


def make_uniform_printers(printers: Sequence[TargetPrinter]) -> tuple[TargetPrinter, ...]:
    """Make the same number of printers with one speed and the build volume of the least height."""
    smallest_boxes = min(
        (printer.box_sizes_mm for printer in printers), key=lambda boxes: max(box[2] for box in boxes)
    )
    return tuple(replace(printer, box_sizes_mm=smallest_boxes, time_factor=1.0) for printer in printers)


def compare_makespans(path: Path, side_mm: float, problem: Problem) -> dict[str, Any]:
    """Compare both makespans for one model, with CPU seconds; a makespan is None if no cut fits."""
    row: dict[str, Any] = {"model": path.stem, "side_mm": side_mm, "printers": len(problem.printers)}
    for name, printers, search in (
        ("shared", make_uniform_printers(problem.printers), cut_for_uniform_printers),
        ("unequal", problem.printers, cut_by_guillotine),
    ):
        start_cpu_s = process_time()
        row |= {f"{name}_s": None, f"{name}_parts": 0}
        with suppress(NoFit):
            result = search(replace(problem, printers=printers))
            row |= {
                f"{name}_s": compute_makespan_s(problem, result),
                f"{name}_parts": len(result.pieces),
            }
        row[f"{name}_cpu_s"] = process_time() - start_cpu_s
    return row


def main() -> None:
    """Compare the makespans, and print them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--plus", type=int, default=16)
    parser.add_argument("--extended", type=int, default=4)
    parser.add_argument("--wide", type=int, default=0)
    parser.add_argument("--spread", type=float, default=0.1)
    parser.add_argument("--side", type=float, default=450.0)
    parser.add_argument("--cells", default="auto", help="value of farm decompose --granularity")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    time_settings = make_print_time_settings("paper")
    cost = CostModel.from_settings(time_settings)
    printers = make_fleet(options.plus, options.extended, options.wide, options.spread, time_settings.brim_mm)
    decompose_options = Options(Engine.GUILLOTINE, granularity=options.cells, prove=False)
    rows = []
    with ThreadPoolExecutor(os.cpu_count()) as executor:
        for path in options.models:
            model = load_model(path, longest_side_mm=options.side)
            rows.append(
                compare_makespans(
                    path, options.side, Problem(model, printers, cost, decompose_options, executor)
                )
            )
    if options.json:
        parameters = {
            name: getattr(options, name) for name in ("plus", "extended", "wide", "spread", "cells")
        }
        print(json.dumps({**parameters, "rows": rows}))
        return
    for row in rows:
        shared_h, unequal_h = ((row[f"{name}_s"] or math.inf) / 3600.0 for name in ("shared", "unequal"))
        print(
            f"{row['model']:>20}: {shared_h:6.2f} h shared, {unequal_h:6.2f} h unequal, "
            f"{row['shared_parts']} and {row['unequal_parts']} parts, "
            f"{row['shared_cpu_s']:.0f} and {row['unequal_cpu_s']:.0f} CPU s"
        )


if __name__ == "__main__":
    main()
