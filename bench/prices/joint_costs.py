"""Print time of grooves, holes, marks and gutters, fitted to slices of parts with only one of these kinds.

Models are cut by the engine `guillotine` and drilled. The first parts are sliced without connectors, and
again with only their keys, pins or gutters. Marks are sliced together with the gutters, which attract the
seams, and compared with the gutters alone. The time that a kind adds is fitted as a price per piece, or per
mm of gutter, separately for faces that are upright, on top, and towards the bed. Errors are relative to the
print time of the bare part, and all models have the same weight. Parts that get support are ignored.
The time of pins, and of marks with their gutters, is also fitted as a price per mm2 of the upright cut faces
and of the other ones. --fit fits the samples of several runs, written with --json, together. The fitted
prices are stored in `decompose.results.connector_prices` and, by area, in `decompose.problem.connector_cost`.

Usage: python -m bench.prices.joint_costs MODEL|SHAPE... [--printers 8] [--longest-side 330] [--slices 4]
       [--json]
       python -m bench.prices.joint_costs --fit FILE...
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from bench.connectors.joint_slices import slice_part
from bench.joints import ALL_CONNECTORS, cut_model, load_case, make_cost
from decompose.connectors import Blank, Connectors, drill_parts
from decompose.files.names import find_part_number
from decompose.pieces import find_cut_faces
from decompose.print_time import CostModel, measure_pose
from decompose.results import Decomposition, Part, connect_parts
from decompose.results.connector_prices import count_tools

MAX_ADDED_SUPPORT_MM = 1.0  # maximum filament of added supports; with more, they add time themselves


@dataclass(frozen=True, slots=True)
class Sample:
    """Part sliced with one kind of connector: amount for each price, area of cut faces, and added time."""

    part: str
    bare_s: float
    added_s: float
    amounts: dict[str, float]
    side_mm2: float
    level_mm2: float

    @property
    def model(self) -> str:
        """Name of the model of the part."""
        return self.part.rpartition(" ")[0]


def slice_kinds(result: Decomposition, count: int, cost: CostModel) -> Iterator[Sample]:
    """Slice the first parts of a drilled result, cut with a cost model, with each kind of connector."""
    blanks = [Blank(find_part_number(p.id), p.solid, p.rotation[2]) for p in result.parts]
    connectors = result.connectors
    kinds = [
        Connectors(pins=tuple(pin for pin in connectors.pins if pin.key_direction is not None)),
        Connectors(pins=tuple(pin for pin in connectors.pins if pin.key_direction is None)),
        Connectors(gutters=connectors.gutters),
        Connectors(marks=connectors.marks, gutters=connectors.gutters),
    ]
    solids_by_kind = [drill_parts(blanks, kind) for kind in kinds]
    for number, part in enumerate(result.parts[:count]):
        side_mm2, level_mm2 = measure_cut_areas_mm2(part, cost)
        with tempfile.TemporaryDirectory() as folder:
            base_slice = bare_slice = slice_part(part, part.solid, Path(folder))
            for kind, solids in zip(kinds, solids_by_kind, strict=True):
                amounts = count_tools(
                    replace(kind, gutters=() if kind.marks else kind.gutters),
                    number,
                    blanks[number].up_direction,
                )
                if amounts:
                    drilled_slice = slice_part(part, solids[number], Path(folder))
                    if (
                        abs(drilled_slice.support_filament_mm - bare_slice.support_filament_mm)
                        < MAX_ADDED_SUPPORT_MM
                    ):
                        added_s = drilled_slice.sliced_s - base_slice.sliced_s
                        yield Sample(
                            part.id, bare_slice.sliced_s, added_s, dict(amounts), side_mm2, level_mm2
                        )
                    if kind.gutters:
                        base_slice = drilled_slice


def fit_prices(samples: list[Sample]) -> dict[str, float]:
    """Fit the prices of each kind to the added shares of time, by least squares; no price is negative."""
    samples_by_kind: dict[str, list[Sample]] = defaultdict(list)
    for sample in samples:
        samples_by_kind[next(iter(sample.amounts)).split()[0]].append(sample)
    prices: dict[str, float] = {}
    for kind_samples in samples_by_kind.values():
        names = sorted({name for sample in kind_samples for name in sample.amounts})
        models = Counter(sample.model for sample in kind_samples)
        weights = np.array([models[sample.model] ** -0.5 / sample.bare_s for sample in kind_samples])
        rows = np.array([[sample.amounts.get(name, 0.0) for name in names] for sample in kind_samples])
        added_s = np.array([sample.added_s for sample in kind_samples])
        fitted_prices_s = nnls(rows * weights[:, None], added_s * weights)[0]
        prices |= dict(zip(names, fitted_prices_s.tolist(), strict=True))
    return prices


def measure_cut_areas_mm2(part: Part, cost: CostModel) -> tuple[float, float]:
    """Measure the areas of the upright and of the other cut faces of a part, as they are priced."""
    vertices, faces = part.solid.arrays()
    is_cut = find_cut_faces(vertices, faces, part.planes)
    side_mm2, level_mm2 = (
        measure_pose(vertices, faces, is_cut, part.rotation, unit_cost).connectors_s
        for unit_cost in (
            replace(cost, connector_side_s_per_mm2=1.0, connector_level_s_per_mm2=0.0),
            replace(cost, connector_side_s_per_mm2=0.0, connector_level_s_per_mm2=1.0),
        )
    )
    return side_mm2, level_mm2


def fit_area_prices(samples: list[Sample]) -> dict[str, tuple[float, float]]:
    """Fit the seconds per mm2 of upright and of other cut faces, for pins and for marks; see `fit_prices`."""
    prices: dict[str, tuple[float, float]] = {}
    for group, kinds in {"pins": ("groove", "hole"), "marks": ("gutter", "mark")}.items():
        parts: dict[str, list[Sample]] = defaultdict(list)
        for sample in samples:
            if next(iter(sample.amounts)).startswith(kinds):
                parts[sample.part].append(sample)
        if not parts:
            continue
        models = Counter(part_samples[0].model for part_samples in parts.values())
        rows, shares = [], []
        for first, *others in parts.values():
            weight = models[first.model] ** -0.5 / first.bare_s
            rows.append([weight * first.side_mm2, weight * first.level_mm2])
            shares.append(weight * sum(sample.added_s for sample in (first, *others)))
        side_s, level_s = nnls(np.array(rows), np.array(shares))[0].tolist()
        prices[group] = (side_s, level_s)
    return prices


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", nargs="*")
    parser.add_argument("--fit", nargs="+", type=Path, default=[])
    parser.add_argument("--printers", type=int, default=8)
    parser.add_argument("--longest-side", type=float, default=330.0)
    parser.add_argument("--slices", type=int, default=4)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    samples = [Sample(**row) for path in options.fit for row in json.loads(path.read_text())["samples"]]
    for name in options.models:
        model = load_case(name, options.longest_side)
        drilled_result = connect_parts(cut_model(model, options.printers, ALL_CONNECTORS))
        for sample in slice_kinds(drilled_result, options.slices, make_cost()):
            samples.append(replace(sample, part=f"{Path(name).stem} {sample.part}"))
            if not options.json:
                print(
                    "  ".join(f"{field} {value}" for field, value in asdict(samples[-1]).items()), flush=True
                )
    prices = fit_prices(samples)
    if options.json:
        rows = [asdict(sample) for sample in samples]
        area_prices = fit_area_prices(samples)
        print(json.dumps({"schema": 2, "samples": rows, "prices_s": prices, "area_prices_s": area_prices}))
    else:
        print("  ".join(f"{name} {price_s:.2f}" for name, price_s in prices.items()))
        for kind, (side_s, level_s) in fit_area_prices(samples).items():
            print(f"{kind}: {side_s:.5f} s per mm2 of upright and {level_s:.5f} of other cut faces")


if __name__ == "__main__":
    main()
