"""Print time of grooves, holes, marks and gutters, fitted to slices of parts with only one of these kinds.

Models are cut by the engine `guillotine` and drilled. The first parts are sliced without connectors, and
again with only their keys, pins or gutters. Marks are sliced together with the gutters, which attract the
seams, and compared with the gutters alone. The time that a kind adds is fitted as a price per piece, or per
mm of gutter, separately for faces that are upright, on top, and towards the bed. Errors are relative to the
print time of the bare part, and all models have the same weight. Parts that get support are ignored.
--fit fits the samples of several runs, written with --json, together. The fitted prices are stored in
`decompose.results.connector_prices`.

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
from bench.joints import cut_case
from decompose.connectors import Blank, Connectors, drill_parts
from decompose.files.names import find_part_number
from decompose.results import Decomposition, connect_parts
from decompose.results.connector_prices import count_tools

MAX_ADDED_SUPPORT_MM = 1.0  # maximum filament of added supports; with more, they add time themselves


@dataclass(frozen=True, slots=True)
class Sample:
    """Part sliced with one kind of connector: the amount for each price, and the added time."""

    part: str
    bare_s: float
    added_s: float
    amounts: dict[str, float]

    @property
    def model(self) -> str:
        """Name of the model of the part."""
        return self.part.rpartition(" ")[0]


def slice_kinds(result: Decomposition, count: int) -> Iterator[Sample]:
    """Slice the first parts of a drilled result with each kind of connector."""
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
                        yield Sample(part.id, bare_slice.sliced_s, added_s, dict(amounts))
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
        drilled_result = connect_parts(cut_case(name, options.printers, options.longest_side))
        for sample in slice_kinds(drilled_result, options.slices):
            samples.append(replace(sample, part=f"{Path(name).stem} {sample.part}"))
            if not options.json:
                print(
                    "  ".join(f"{field} {value}" for field, value in asdict(samples[-1]).items()), flush=True
                )
    prices = fit_prices(samples)
    if options.json:
        print(json.dumps({"schema": 1, "samples": [asdict(s) for s in samples], "prices_s": prices}))
    else:
        print("  ".join(f"{name} {price_s:.2f}" for name, price_s in prices.items()))


if __name__ == "__main__":
    main()
