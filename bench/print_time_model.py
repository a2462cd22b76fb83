"""How well the print-time model knows CuraEngine on models that it has not seen, and what its factors are.

Usage: python -m bench.print_time_model [--dataset FILE.csv] [--models DIR] [--parts N] [--json]

Without a dataset that is there already, models are made (and those of DIR added), decomposed and sliced, in
about 20 minutes with two workers. The table goes to --dataset, so that the fit can be made again without
slicing.

Each kind of line has its own factor, fitted to the seconds of that kind; the factors of what is left (travel,
acceleration, retraction) are fitted to the rest. So no kind pays for another, and a setting that changes one
of them needs no new fit. Errors are relative, and held out by model: the factors are fitted without any part
of the model that they are tried on.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from bench.print_time_parts import ALWAYS, SETTINGS, Row, make, read, recipe_of, write
from decompose.cost import FACTORS, CostModel, terms

Floats = npt.NDArray[np.float64]

KINDS = {
    "walls_s": ("walls",),
    "fill_s": ("infill", "connections"),
    "skin_s": ("skin",),
    "support_s": ("support",),
    "brim_s": ("brim",),
}
REST = ("slope ends", "infill ends", "travel", "support")


class Table:
    """The rows as arrays: seconds of each term before its factor, and what was sliced."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self.models = np.array([row.model for row in rows])
        self.settings = np.array([row.settings for row in rows])
        self.printed = np.array([row.printed for row in rows])
        self.sliced_s = np.array([row.sliced_s for row in rows])
        self.kinds = {kind: np.array([getattr(row, kind) for row in rows]) for kind in KINDS}
        recipes = {name: recipe_of(name) for name in SETTINGS}
        each = {name: terms(recipe) for name, recipe in recipes.items()}
        features = np.array([self._features(row, recipes[row.settings].brim_mm) for row in rows])
        self.terms = {
            term: np.array([each[row.settings][term] @ f for row, f in zip(rows, features, strict=True)])
            for term in FACTORS
        }
        costs = {name: CostModel.from_recipe(recipe) for name, recipe in recipes.items()}
        self.least_s = np.array([costs[row.settings].least_s_mm * row.height_mm for row in rows])
        body = features * ([1.0, 1.0] + [0.0] * 4)
        self.body = {
            term: np.array([each[row.settings][term] @ f for row, f in zip(rows, body, strict=True)])
            for term in FACTORS
        }

    @staticmethod
    def _features(row: Row, brim_mm: float) -> list[float]:
        ring = brim_mm * (2.0 * (row.width_mm + row.depth_mm) + math.pi * brim_mm)
        return [row.volume_mm3, row.lateral_mm2, row.skin_mm2, row.slope_mm2, row.column_mm3, ring]

    def fit(self, rows: npt.NDArray[np.bool_]) -> dict[str, float]:
        """The factors that fit these rows best, by relative error."""
        factors = dict.fromkeys(FACTORS, 0.0)
        weight = 1.0 / self.sliced_s[rows]
        rest = self.sliced_s - sum(self.kinds.values(), np.zeros(len(self.sliced_s)))
        for names, seconds in [(names, self.kinds[kind]) for kind, names in KINDS.items()] + [(REST, rest)]:
            matrix = np.array([self.terms[name][rows] * weight for name in names]).T
            for name, factor in zip(names, nnls(matrix, seconds[rows] * weight)[0], strict=True):
                factors[name] += float(factor)
        return factors

    def errors(self, factors: dict[str, float]) -> Floats:
        """(rows,) Relative errors of `decompose.cost.price` with these factors."""
        total = sum((f * self.terms[name] for name, f in factors.items()), np.zeros(len(self.sliced_s)))
        body = sum((f * self.body[name] for name, f in factors.items()), np.zeros(len(self.sliced_s)))
        return (total + np.maximum(0.0, self.least_s - body)) / self.sliced_s - 1.0

    def held_out(self, fitted_on: npt.NDArray[np.bool_]) -> Floats:
        """(rows,) Errors, each by factors that were fitted without its model."""
        errors = np.zeros(len(self.sliced_s))
        for model in np.unique(self.models):
            mine = self.models == model
            errors[mine] = self.errors(self.fit(fitted_on & ~mine))[mine]
        return errors


def summary(errors: Floats) -> dict[str, float]:
    size = np.abs(errors)
    return {
        "rows": len(errors),
        "mean_absolute_error": float(size.mean()),
        "mean_error": float(errors.mean()),
        "nine_in_ten_within": float(np.quantile(size, 0.9)),
        "worst_error": float(size.max()),
    }


def report(rows: Sequence[Row]) -> dict[str, object]:
    table = Table(rows)
    every = np.ones(len(rows), dtype=np.bool_)
    known = np.isin(table.settings, ALWAYS)
    held_out = table.held_out(every)
    unseen = table.held_out(known)
    groups = {"printed": table.printed, "turned": ~table.printed}
    groups |= {name: table.printed & (table.settings == name) for name in SETTINGS}
    return {
        "schema": 1,
        "models": len(np.unique(table.models)),
        "factors": table.fit(every),
        "in_code": dict(FACTORS),
        "held_out": {name: summary(held_out[mask]) for name, mask in groups.items() if mask.any()},
        f"fitted_on_{'_and_'.join(ALWAYS)}": {
            name: summary(unseen[mask]) for name, mask in groups.items() if name in SETTINGS and mask.any()
        },
        "as_in_code": summary(table.errors(dict(FACTORS))[table.printed]),
        "by_model": {
            str(model): summary(held_out[table.printed & (table.models == model)])
            for model in np.unique(table.models[table.printed])
        },
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--dataset", type=Path, help="read where it is there, written where not")
    parser.add_argument("--models", type=Path, help="a folder of more models")
    parser.add_argument("--parts", type=int, default=4, help="of each model and number of printers")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="a folder that keeps slices")
    parser.add_argument("--json", action="store_true", help="one object on stdout")
    args = parser.parse_args()
    if args.dataset and args.dataset.exists():
        rows = read(args.dataset)
    else:
        rows = make(args.models, args.parts, args.workers, args.cache)
        if args.dataset:
            write(args.dataset, rows)
    figures = report(rows)
    if args.json:
        print(json.dumps(figures, indent=1))
        return 0
    for title in ("held_out", f"fitted_on_{'_and_'.join(ALWAYS)}", "by_model"):
        print(title.replace("_", " "))
        for name, s in figures[title].items():  # type: ignore[attr-defined]
            print(
                f"  {name:20} {s['rows']:4} rows  error {s['mean_absolute_error']:5.1%}"
                f"  mean {s['mean_error']:+5.1%}  nine in ten {s['nine_in_ten_within']:5.1%}"
                f"  worst {s['worst_error']:5.1%}"
            )
    print("factors: fitted, in the code")
    for name, factor in figures["factors"].items():  # type: ignore[attr-defined]
        print(f"  {name:14} {factor:6.3f} {FACTORS[name]:6.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
