"""Errors of expected times on printers whose firmware differs: with one factor, and with factors by feature.

Usage: python -m bench.prices.feature_factors --cache DIR [--seeds 1,2,3,4] [--side 90] [--splits 20] [--json]

Parts are quarters of the models of `bench.unseen`, sliced by CuraEngine. The actual time of a slice's
layers is that of its moves in the emulator's planner, with limits other than those that CuraEngine assumes.
The factors are learned from 30 parts, as the farm learns them from prints, and tested on the others; the
errors are means over several random splits. Parts are kept in the cache, and the first run, which slices
them, takes minutes.
"""

from __future__ import annotations

import argparse
import json
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bench.prices.features import cut_piece
from bench.prices.parts import PRINTER_MODEL, make_print_time_settings
from bench.unseen import KINDS
from decompose.geometry import write_stl
from decompose.print_time import CostModel
from drivers.emulator.firmware.planner import Limits, Planner
from drivers.printers import PROFILES, SLICING_PROFILES
from farm.model import FeatureSeconds, TimeFactors
from farm.planning.printer_settings import build_slicing_printer
from farm.state.printer_speed import (
    MIN_PRINTS,
    Timing,
    fit_feature_factors,
    is_learnable,
    update_time_factor,
)
from slicing.checks import Toolpath, read_toolpath
from slicing.errors import SlicingError
from slicing.plate import PlateRequest, PlateResult, slice_plate
from slicing.settings import SettingsRequest, find_engine, find_resources, resolve_settings

BED = ((-111.5, -111.5, 111.5, 111.5, 205.0),)


def make_limits(**changes: float) -> Limits:
    """Make the limits of the assumed firmware with some of them changed."""
    limits = Limits.from_profile(PROFILES[PRINTER_MODEL])
    for name, value in changes.items():
        setattr(limits, name, value)
    return limits


def make_feeder_limits(feed_mm_s: float, jerk_e_mm_s: float) -> Limits:
    """Make the limits of the assumed firmware with another feed rate and jerk of the feeder."""
    limits = make_limits(jerk_e_mm_s=jerk_e_mm_s)
    limits.feedrate_mm_s[3] = feed_mm_s
    return limits


FIRMWARES: Mapping[str, Callable[[], Limits]] = {
    "as assumed": make_limits,
    "third of the acceleration": lambda: make_limits(print_acceleration_mm_s2=1000.0),
    "half of the jerk": lambda: make_limits(jerk_xy_mm_s=10.0),
    "both": lambda: make_limits(print_acceleration_mm_s2=1000.0, jerk_xy_mm_s=10.0),
    "slow feeder": lambda: make_feeder_limits(12.0, 1.0),
    "quicker": lambda: make_limits(print_acceleration_mm_s2=5000.0, jerk_xy_mm_s=30.0),
}


@dataclass(frozen=True, slots=True)
class PartTimes:
    """Sliced seconds of a part's layers, by feature, and the actual seconds with each firmware."""

    part: str
    sliced_s: float
    features: dict[str, float]
    actual_s: dict[str, float]

    @property
    def shares(self) -> tuple[float, ...]:
        """Share of each feature in the sliced time."""
        shares = FeatureSeconds(**self.features).shares
        assert shares is not None
        return shares


@dataclass(frozen=True, slots=True)
class Errors:
    """Means over parts and splits of |actual / expected - 1|, and means over splits of the worst part."""

    firmware: str
    no_factor: float
    one_factor: float
    by_feature: float
    worst_one_factor: float
    worst_by_feature: float


def list_parts(seeds: Sequence[int], side_mm: float, cache: Path) -> Iterator[PartTimes]:
    """Yield the times of all parts; parts that are not in the cache are cut, sliced and simulated."""
    cost = CostModel.from_settings(make_print_time_settings("glue"))
    for seed in seeds:
        for kind in KINDS:
            for corner in ("low", "high"):
                name = f"{kind}-{seed}-{corner}-{side_mm:g}"
                path = cache / f"{name}.json"
                if not path.exists():
                    stl = cache / f"{name}.stl"
                    write_stl(stl, cut_piece(kind, seed, corner, cost, side_mm).corners)
                    try:
                        times = measure_part(name, stl, cache)
                    except SlicingError as error:
                        print(f"{name}: {error}")
                        continue
                    path.write_text(json.dumps(asdict(times)), encoding="utf-8")
                yield PartTimes(**json.loads(path.read_text(encoding="utf-8")))


def measure_part(name: str, stl: Path, cache: Path) -> PartTimes:
    """Slice a part, and time its layers with each firmware."""
    result = slice_part(stl, cache)
    path = read_toolpath(result.gcode.read_bytes())
    actual_s = {firmware: time_layers_s(path, limits()) for firmware, limits in FIRMWARES.items()}
    result.gcode.unlink()
    return PartTimes(name, result.sliced_s, asdict(result.features), actual_s)


def slice_part(stl: Path, cache: Path) -> PlateResult:
    """Slice a part with the quality `glue`."""
    request = SettingsRequest(build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL]), "glue")
    settings = resolve_settings(request, find_resources())
    return slice_plate(PlateRequest(stl, settings, cache / f"{stl.stem}.gcode", find_engine(), BED))


def time_layers_s(path: Toolpath, limits: Limits) -> float:
    """Time the layers of a file with a planner that is always kept full, in seconds."""
    time_moves = [comment.next_move for comment in path.comments if comment.text.startswith("TIME_ELAPSED:")]
    first_move = next(comment.next_move for comment in path.comments if comment.text.startswith("LAYER:"))
    last_move = time_moves[-1]
    start = tuple(path.start[first_move].tolist())
    planner, now_s = Planner(limits, start, lambda e_mm, z_mm: None), 0.0
    position_mm = np.array(start)
    moves = (path.end - path.start)[first_move:last_move]
    for move, feed_mm_s in zip(moves, path.feed_mm_min[first_move:last_move] / 60.0, strict=True):
        position_mm = position_mm + move
        now_s = max(now_s, planner.compute_next_free_s())
        planner.advance(now_s)
        planner.add(tuple(position_mm.tolist()), max(feed_mm_s, 1.0), now_s)
    planner.advance(np.inf)
    return planner.moving_s


def learn_factors(parts: Sequence[PartTimes], actual_times_s: Sequence[float]) -> TimeFactors:
    """Learn the factors from parts in their order, as the farm does from a printer's prints."""
    factor, timings = 1.0, []
    for part, actual_s in zip(parts, actual_times_s, strict=True):
        factor = update_time_factor(factor, part.sliced_s, actual_s)
        if is_learnable(part.sliced_s, actual_s):
            timings.append(Timing(part.shares, actual_s / part.sliced_s))
    return TimeFactors(factor, fit_feature_factors(timings))


def compute_errors(parts: Sequence[PartTimes], firmware: str, splits: int, pauses: int = 0) -> Errors:
    """Compute the errors on held-out parts, over several splits, with factors learned from 30 parts.

    Parameters
    ----------
    pauses
        Number of training parts whose prints took 20 % longer, because of an unnoticed pause.
    """
    rows = []
    for split in range(splits):
        rng = random.Random(split)
        shuffled_parts = list(parts)
        rng.shuffle(shuffled_parts)
        training_parts, test_parts = shuffled_parts[:MIN_PRINTS], shuffled_parts[MIN_PRINTS:]
        actual_times_s = [
            part.actual_s[firmware] * (1.2 if i < pauses else 1.0) for i, part in enumerate(training_parts)
        ]
        timed_parts = list(zip(training_parts, actual_times_s, strict=True))
        rng.shuffle(timed_parts)
        factors = learn_factors([part for part, _ in timed_parts], [actual_s for _, actual_s in timed_parts])
        ratios = np.array([part.actual_s[firmware] / part.sliced_s for part in test_parts])
        by_feature = np.array([factors.compute_factor(part.shares) for part in test_parts])
        errors = [np.abs(ratios / expected - 1.0) for expected in (1.0, factors.overall_factor, by_feature)]
        rows.append((*(error.mean() for error in errors), errors[1].max(), errors[2].max()))
    name = firmware + (f", {pauses} pauses" if pauses else "")
    return Errors(name, *np.mean(rows, axis=0).tolist())


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--seeds", default="1,2,3,4")
    parser.add_argument("--side", type=float, default=90.0)
    parser.add_argument("--splits", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    args.cache.mkdir(parents=True, exist_ok=True)
    seeds = [int(seed) for seed in args.seeds.split(",")]
    parts = [
        part
        for part in list_parts(seeds, args.side, args.cache)
        if is_learnable(part.sliced_s, part.sliced_s)
    ]
    rows = [compute_errors(parts, firmware, args.splits) for firmware in FIRMWARES]
    rows.append(compute_errors(parts, "both", args.splits, pauses=3))
    if args.json:
        print(json.dumps({"parts": len(parts), "errors": [asdict(row) for row in rows]}, indent=1))
        return
    print(f"{len(parts)} parts, {MIN_PRINTS} for training, {args.splits} splits; in parentheses: worst part")
    for row in rows:
        print(
            f"{row.firmware:26} no factor {row.no_factor:6.2%}, one factor {row.one_factor:6.2%}"
            f" ({row.worst_one_factor:6.2%}), by feature {row.by_feature:6.2%} ({row.worst_by_feature:6.2%})"
        )


if __name__ == "__main__":
    main()
