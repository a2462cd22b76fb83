"""Actual and expected times of finished prints, from the books of a farm.

The table has for each printer the number of successful prints that show its speed, the actual time of their
layers over CuraEngine's, the `time_factor` learned from them, and the error of the expected time without it,
with it, and with the factors by feature. Each print is predicted from the prints before it.

Usage: python -m bench.fleets.reached_times STATE_FOLDER [--json]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from farm.model import PrintState, TimeFactors
from farm.paths import StateFolder
from farm.state import Books
from farm.state.printer_speed import (
    MAX_PRINTS,
    Timing,
    fit_feature_factors,
    is_learnable,
    update_time_factor,
)
from farm.state.storage import Store


@dataclass(frozen=True, slots=True)
class Row:
    """Figures of one printer."""

    printer: str
    prints: int
    mean_ratio: float
    time_factor: float
    error_without: float  # mean of |actual / expected - 1|, layers alone
    error_with: float
    error_by_feature: float  # with factors by feature if earlier prints have shown them, else as `error_with`


def list_rows(books: Books) -> Iterator[Row]:
    """Yield a row for each printer with prints that show its speed."""
    for name in sorted(books.printers):
        ended_prints = sorted(
            (p for p in books.prints.values() if p.printer == name and p.state is PrintState.DONE),
            key=lambda p: p.ended_s or 0.0,
        )
        factor, ratios, factors_before, feature_factors = 1.0, [], [], []
        timings: list[Timing] = []
        for attempt in ended_prints:
            plate = books.plates[attempt.plate]
            if attempt.started_s is None or attempt.ended_s is None:
                continue
            actual_s = attempt.ended_s - attempt.started_s - plate.overhead_s
            if not is_learnable(plate.sliced_s, actual_s, attempt.starved_s):
                continue
            ratios.append(actual_s / plate.sliced_s)
            factors_before.append(factor)
            learned_factors = TimeFactors(factor, fit_feature_factors(timings[-MAX_PRINTS:]))
            feature_factors.append(learned_factors.compute_factor(plate.feature_shares))
            if plate.feature_shares is not None:
                timings.append(Timing(plate.feature_shares, ratios[-1]))
            factor = update_time_factor(factor, plate.sliced_s, actual_s, attempt.starved_s)
        if ratios:
            ratio, factors = np.array(ratios), np.array(factors_before)
            yield Row(
                printer=name,
                prints=len(ratios),
                mean_ratio=float(ratio.mean()),
                time_factor=factor,
                error_without=float(np.abs(ratio - 1).mean()),
                error_with=float(np.abs(ratio / factors - 1).mean()),
                error_by_feature=float(np.abs(ratio / np.array(feature_factors) - 1).mean()),
            )


def main() -> None:
    """Read the books and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("state", type=Path)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    path = StateFolder(arguments.state).books
    if not path.is_file():
        sys.exit(f"{path}: there are no books; name a farm's state folder")
    with Store(path) as store:
        rows = list(list_rows(store.load()))
    if arguments.json:
        print(json.dumps({"printers": [asdict(row) for row in rows]}, indent=2))
        return
    print("printer     prints  actual/expected   time_factor  error without  with  by feature")
    for row in rows:
        print(
            f"{row.printer:12}{row.prints:5}{row.mean_ratio:18.3f}{row.time_factor:13.3f}"
            f"{row.error_without:15.1%}{row.error_with:6.1%}{row.error_by_feature:12.1%}"
        )


if __name__ == "__main__":
    main()
