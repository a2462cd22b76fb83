"""Error of the print-time model on models that it was not fitted to, and the fit of its factors.

Usage: python -m bench.prices.model [--dataset FILE.csv] [--models DIR] [--unseen SEED] [--parts N]
       [--workers N] [--cache DIR] [--json]

Without an existing dataset, models are made (those of DIR are added), decomposed and sliced, which takes
about 20 minutes with two workers. The table is written to --dataset, so that the fit can be repeated without
slicing.

Each kind of line has its own factor, fitted to the seconds of that kind; the factors of the remaining time
(travel, acceleration, retraction) are fitted to the rest. A setting that changes one kind therefore needs no
new fit. Errors are relative, with cross-validation by model: factors are fitted without any part of the model
that they are tested on.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from bench.prices.parts import (
    SETTINGS,
    SETTINGS_FOR_ALL_PARTS,
    Row,
    list_models,
    list_unseen_models,
    make_print_time_settings,
    make_table,
    read_rows,
    write_rows,
)
from decompose.print_time import (
    ADDITIVE_FEATURES,
    FACTORS,
    FEATURES,
    SUPPORT_TERMS,
    CostModel,
    compute_time_terms,
)

Floats = npt.NDArray[np.float64]

KINDS = {
    "walls_s": ("walls",),
    "fill_s": ("infill", "connections"),
    "skin_s": ("skin", "skin rim"),
    "support_s": ("support", "support sides"),
    "brim_s": ("brim",),
}
REST_TERMS = ("slope ends", "infill ends", "travel", *SUPPORT_TERMS)
ROUNDS, MIN_ERROR = 30, 1e-3  # number of rounds of the fit, and lower limit of an error in the weights
COLUMN_TERM = "support to bed"  # term of the search's tables, in place of the terms of supports


class Dataset:
    """Rows as arrays: seconds of each term before its factor, and the sliced times."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self.models = np.array([row.model for row in rows])
        self.settings = np.array([row.settings for row in rows])
        self.printed = np.array([row.printed for row in rows])
        self.sliced_s = np.array([row.sliced_s for row in rows])
        self.kinds = {kind: np.array([getattr(row, kind) for row in rows]) for kind in KINDS}
        time_settings_by_name = {name: make_print_time_settings(name) for name in SETTINGS}
        features = [_list_features(row, time_settings_by_name[row.settings].brim_mm) for row in rows]
        terms_by_setting = {
            name: compute_time_terms(time_settings) for name, time_settings in time_settings_by_name.items()
        }
        seconds = [
            {term: vector * f for term, vector in terms_by_setting[row.settings].items()}
            for row, f in zip(rows, features, strict=True)
        ]
        self.terms = {term: np.array([s[term].sum() for s in seconds]) for term in FACTORS}
        # Seconds to which the minimum time of a layer applies.
        self.body_terms_s = {term: np.array([s[term][:2].sum() for s in seconds]) for term in FACTORS}
        costs = {
            name: CostModel.from_settings(time_settings)
            for name, time_settings in time_settings_by_name.items()
        }
        self.min_s = np.array([costs[row.settings].min_s_per_mm * row.height_mm for row in rows])

    def fit(self, rows: npt.NDArray[np.bool_]) -> dict[str, float]:
        """Fit the factors to some rows, by the mean absolute relative error."""
        factors = dict.fromkeys(FACTORS, 0.0)
        weight = 1.0 / self.sliced_s[rows]
        rest_s = self.sliced_s - sum(self.kinds.values(), np.zeros(len(self.sliced_s)))
        for names, seconds in [*((KINDS[kind], self.kinds[kind]) for kind in KINDS), (REST_TERMS, rest_s)]:
            matrix = np.array([self.terms[name][rows] * weight for name in names]).T
            for name, factor in zip(names, _fit(matrix, seconds[rows] * weight), strict=True):
                factors[name] += float(factor)
        support = np.sum([factors[name] * self.terms[name] for name in SUPPORT_TERMS], axis=0)
        columns = (self.terms[COLUMN_TERM][rows] * weight)[:, None]
        factors[COLUMN_TERM] = float(_fit(columns, support[rows] * weight)[0])
        return factors

    def compute_errors(self, factors: dict[str, float], by_tables: bool) -> Floats:
        """Compute the relative errors (rows,) of the prices from tables, or with the part's supports."""
        excluded_terms = SUPPORT_TERMS if by_tables else (COLUMN_TERM,)
        total, body = np.zeros((2, len(self.sliced_s)))
        for name, factor in factors.items():
            if name not in excluded_terms:
                total += factor * self.terms[name]
                body += factor * self.body_terms_s[name]
        return (total + np.maximum(0.0, self.min_s - body)) / self.sliced_s - 1.0

    def cross_validate(self, training_rows: npt.NDArray[np.bool_], by_tables: bool = False) -> Floats:
        """Compute the errors (rows,), each with factors that were fitted without the model of the row."""
        errors = np.zeros(len(self.sliced_s))
        for model in np.unique(self.models):
            in_model = self.models == model
            errors[in_model] = self.compute_errors(self.fit(training_rows & ~in_model), by_tables)[in_model]
        return errors


def _fit(matrix: Floats, target: Floats) -> Floats:
    """Fit factors of at least 0 with the least sum of absolute errors, which is robust against outliers."""
    weight = np.ones(len(target))
    for _ in range(ROUNDS):
        factors, _ = nnls(matrix * weight[:, None], target * weight)
        weight = 1.0 / np.sqrt(np.maximum(np.abs(matrix @ factors - target), MIN_ERROR))
    return np.asarray(factors)


def _list_features(row: Row, brim_mm: float) -> Floats:
    """Return the features in the order of `print_time.time_settings.FEATURES`."""
    brim_ring_mm2 = brim_mm * (2.0 * (row.width_mm + row.depth_mm) + math.pi * brim_mm)
    additive = [getattr(row, name) for name in ADDITIVE_FEATURES]
    skin_rim_mm = math.sqrt(row.skin_mm2)
    supports = [row.support_mm3, row.support_side_mm2, row.towers_mm, row.islands_mm]
    # Distances of islands, holes, contours and thin walls were not measured.
    known_features = [*additive, row.height_mm, skin_rim_mm, brim_ring_mm2, *supports]
    return np.array(known_features + [0.0] * (len(FEATURES) - len(known_features)))


def summarise(errors: Floats) -> dict[str, float]:
    """Compute the figures of some relative errors."""
    absolute_errors = np.abs(errors)
    return {
        "rows": len(errors),
        "mean_absolute_error": float(absolute_errors.mean()),
        "mean_error": float(errors.mean()),
        "nine_in_ten_within": float(np.quantile(absolute_errors, 0.9)),
        "worst_error": float(absolute_errors.max()),
    }


def compute_report(rows: Sequence[Row]) -> dict[str, Any]:
    """Compute all figures: for parts priced as in a plan, and for the tables of the search."""
    dataset = Dataset(rows)
    all_rows = np.ones(len(rows), dtype=np.bool_)
    in_settings_for_all_parts = np.isin(dataset.settings, SETTINGS_FOR_ALL_PARTS)
    has_supports = dataset.kinds["support_s"] > 0.02 * dataset.sliced_s
    group_masks = {"printed": dataset.printed, "turned": ~dataset.printed, "with supports": has_supports}
    group_masks |= {name: dataset.printed & (dataset.settings == name) for name in SETTINGS}
    model_masks = {
        str(model): dataset.printed & (dataset.models == model) for model in np.unique(dataset.models)
    }

    def compute_figures(
        errors: Floats, masks: dict[str, npt.NDArray[np.bool_]]
    ) -> dict[str, dict[str, float]]:
        return {name: summarise(errors[mask]) for name, mask in masks.items() if mask.any()}

    return {
        "schema": 1,
        "models": len(model_masks),
        "parts": len({(row.model, row.part) for row in rows}),
        "factors": dataset.fit(all_rows),
        "factors_in_code": dict(FACTORS),
        "held_out": compute_figures(dataset.cross_validate(all_rows), group_masks),
        "held_out_tables": compute_figures(dataset.cross_validate(all_rows, by_tables=True), group_masks),
        "fitted_on_two_settings": compute_figures(
            dataset.cross_validate(in_settings_for_all_parts), group_masks
        ),
        "as_in_code": compute_figures(dataset.compute_errors(dict(FACTORS), by_tables=False), group_masks),
        "by_model": compute_figures(dataset.cross_validate(all_rows), model_masks),
    }


def main() -> int:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--dataset", type=Path, help="read if it exists, else written")
    parser.add_argument("--models", type=Path, help="folder with further models")
    parser.add_argument(
        "--unseen",
        type=int,
        metavar="SEED",
        help="use models of bench.unseen instead of the bench shapes",
    )
    parser.add_argument("--parts", type=int, default=2, help="parts of each model and number of printers")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="folder in which slices are kept")
    parser.add_argument("--json", action="store_true", help="one object on stdout")
    args = parser.parse_args()
    if args.dataset and args.dataset.exists():
        rows = read_rows(args.dataset)
    else:
        models = list_models(args.models) if args.unseen is None else list_unseen_models(args.unseen)
        rows = make_table(models, args.parts, args.workers, args.cache)
        if args.dataset:
            write_rows(args.dataset, rows)
    figures = compute_report(rows)
    if args.json:
        print(json.dumps(figures, indent=1))
        return 0
    for title in ("held_out", "held_out_tables", "fitted_on_two_settings", "as_in_code", "by_model"):
        print(title.replace("_", " "))
        for name, s in figures[title].items():
            print(
                f"  {name:20} {s['rows']:4} rows  error {s['mean_absolute_error']:5.1%}"
                f"  mean {s['mean_error']:+5.1%}  nine in ten {s['nine_in_ten_within']:5.1%}"
                f"  worst {s['worst_error']:5.1%}"
            )
    print("factors: fitted, in the code")
    for name, factor in figures["factors"].items():
        print(f"  {name:14} {factor:6.3f} {FACTORS[name]:6.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
