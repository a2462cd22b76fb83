"""Seconds of each feature of small parts, by price and by slice, to find errors of prices.

Usage: python -m bench.prices.features --cache DIR [--seeds 1,2] [--qualities glue,paper]
       [--pieces low,high] [--shapes] [--json]

Parts are pieces of the models of `bench.unseen`, and with --shapes the shapes of
`bench.prices.contours`. A slice's seconds are those of its moves with acceleration and jerk
(`bench.prices.move_times`), by the kind of their line. Parts and slices are kept in the cache, so a
change of prices can be measured within seconds.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from bench.prices.contours import SHAPES
from bench.prices.move_times import compute_times_by_kind_s
from bench.prices.parts import PRINTER_MODEL, make_print_time_settings
from bench.unseen import KINDS, draw_model
from decompose.arrays import Bools, Floats, Ints
from decompose.geometry import write_stl
from decompose.print_time import (
    TERM_GROUPS,
    CostModel,
    Pose,
    PrintTimeSettings,
    build_group_cost,
    find_best_pose,
    measure_pose,
)
from drivers.printers import SLICING_PROFILES
from farm.planning.parts.pricing import build_print_time_settings
from farm.planning.printer_settings import build_slicing_printer
from slicing.engine import EngineLimits, run_engine
from slicing.errors import SlicingError
from slicing.settings import PartSettings, SettingsRequest, find_engine, find_resources, resolve_settings

SIDE_MM = 180.0
CORNER_SHARE = 0.45  # length of a cut corner, as a share of each side
LINE_KINDS = {
    "walls": ("WALL-OUTER", "WALL-INNER"),
    "infill": ("FILL",),
    "skins": ("SKIN",),
    "supports": ("SUPPORT", "SUPPORT-INTERFACE"),
    "brim": ("SKIRT",),
    "travel": ("travel", "retraction"),
}
PLANE_TOLERANCE_MM = 1e-4


@dataclass(frozen=True, slots=True)
class PosedPart:
    """Part on the bed: triangles (m, 3, 3) in mm, and which of them (m,) are cuts."""

    name: str
    corners: np.ndarray
    is_cut: np.ndarray


@dataclass(frozen=True, slots=True)
class Row:
    """Seconds of one part by price and by slice, each in total and by feature."""

    part: str
    quality: str
    price_s: float
    sliced_s: float
    price_features_s: dict[str, float]
    sliced_features_s: dict[str, float]

    @property
    def error(self) -> float:
        """Relative error of the price."""
        return self.price_s / self.sliced_s - 1.0


def list_parts(seeds: Sequence[int], pieces: Sequence[str], shapes: bool, cache: Path) -> Iterator[PosedPart]:
    """Yield whole shapes, and pieces of each unseen model; poses are kept in the cache."""
    for name, shape in SHAPES.items() if shapes else ():
        vertices, faces = shape().arrays()
        yield place_on_bed(name, vertices, faces, np.zeros(len(faces), np.bool_), np.eye(3))
    cost = CostModel.from_settings(make_print_time_settings("glue"))
    for seed in seeds:
        for kind in KINDS:
            for corner in pieces:
                cache_file = cache / f"{kind}-{seed}-{corner}.npz"
                if not cache_file.exists():
                    posed_part = cut_piece(kind, seed, corner, cost)
                    np.savez(cache_file, corners=posed_part.corners, cut=posed_part.is_cut)
                with np.load(cache_file) as arrays:
                    yield PosedPart(cache_file.stem, arrays["corners"], arrays["cut"])


def cut_piece(kind: str, seed: int, corner: str, cost: CostModel, side_mm: float = SIDE_MM) -> PosedPart:
    """Cut a corner off an unseen model, across its two longest axes, and put it in its best pose."""
    solid = draw_model(kind, seed, side_mm).solid
    lo, hi = solid.bounds_mm
    planes: list[tuple[int, float]] = []
    if corner != "whole":
        planes = [
            (int(axis), float(lo[axis] + CORNER_SHARE * (hi - lo)[axis])) for axis in np.argsort(lo - hi)[:2]
        ]
    for axis, offset_mm in planes:
        solid = solid.split_by_plane(np.eye(3)[axis], offset_mm)[corner == "high"]
    vertices, faces = solid.arrays()
    is_on_plane = [
        (np.abs(vertices[faces][:, :, axis] - offset_mm) < PLANE_TOLERANCE_MM).all(axis=1)
        for axis, offset_mm in planes
    ]
    is_cut = np.any([*is_on_plane, np.zeros(len(faces), np.bool_)], axis=0)
    pose = find_best_pose(vertices, faces, is_cut, (), cost)
    assert pose is not None
    return place_on_bed("", vertices, faces, is_cut, pose.to_model[:3, :3].T)


def place_on_bed(name: str, vertices: Floats, faces: Ints, is_cut: Bools, rotation: Floats) -> PosedPart:
    """Place a mesh on the bed, centred, in single precision as in an STL."""
    placed_mm = vertices @ rotation.T
    lo, hi = placed_mm.min(axis=0), placed_mm.max(axis=0)
    centred_mm = (placed_mm - [*(lo + hi)[:2] / 2.0, lo[2]])[faces]
    return PosedPart(name, centred_mm.astype(np.float32).astype(np.float64), is_cut)


def measure(posed_part: PosedPart, quality: str, cache: Path) -> Row | None:
    """Price and slice a part; None if the slice is refused."""
    request = SettingsRequest(build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL]), quality)
    settings = resolve_settings(request, find_resources())
    # Parts are sliced alone, so none of their sides is hidden, and without the height of the part.
    plain_settings = replace(settings, hidden_wall_ratio=1.0, has_single_hidden_walls=False, layer_fit=None)
    time_settings = build_print_time_settings(plain_settings, overhead_s=0.0)
    pose = price_part(posed_part, CostModel.from_settings(time_settings), quality == "glue")
    cache_file = cache / f"{posed_part.name}-{quality}.json"
    if not cache_file.exists():
        try:
            cache_file.write_text(
                json.dumps(slice_features_s(posed_part, pose, request, cache)), encoding="utf-8"
            )
        except SlicingError as error:
            print(f"{posed_part.name}: {error}", file=sys.stderr)
            return None
    slice_record = json.loads(cache_file.read_text(encoding="utf-8"))
    return Row(
        posed_part.name,
        quality,
        pose.price_s,
        slice_record.pop("sliced"),
        price_features_s(posed_part, pose, time_settings),
        sum_groups_s(slice_record),
    )


def price_features_s(posed_part: PosedPart, pose: Pose, time_settings: PrintTimeSettings) -> dict[str, float]:
    """Price each group of terms separately; ``slow`` is the time added by the minimum time of a layer."""
    unlimited_settings = replace(
        time_settings,
        min_layer_s=0.0,
        brim_mm=time_settings.brim_mm if pose.brim_width_mm is None else pose.brim_width_mm,
    )
    prices_s = {}
    for group in TERM_GROUPS:
        cost = build_group_cost(unlimited_settings, group)
        prices_s[group] = price_part(posed_part, cost, fits_first_layer=False).price_s
    return prices_s | {"slow": pose.price_s - sum(prices_s.values())}


def merge_corners(corners: Floats) -> tuple[Floats, Ints]:
    """Merge equal corners of triangles (m, 3, 3); return vertices (n, 3) and faces (m, 3)."""
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.int64)


def price_part(posed_part: PosedPart, cost: CostModel, fits_first_layer: bool) -> Pose:
    """Price a part in its pose."""
    vertices, faces = merge_corners(posed_part.corners)
    return measure_pose(vertices, faces, posed_part.is_cut, np.eye(3), cost, fits_first_layer)


def slice_features_s(
    posed_part: PosedPart, pose: Pose, request: SettingsRequest, cache: Path
) -> dict[str, float]:
    """Slice a part with its own settings; return CuraEngine's total, and the seconds of each feature."""
    part_settings = PartSettings(
        brim_width_mm=pose.brim_width_mm,
        layer_0_expansion_mm=pose.layer_0_expansion_mm,
        bed_face_hidden=pose.bed_face_hidden,
        tops_hidden=pose.tops_hidden,
        flat_tops_visible=pose.flat_tops_visible,
    )
    settings = resolve_settings(request, find_resources(), part_settings)
    stl = cache / f"{posed_part.name}-{request.quality}.stl"
    write_stl(stl, posed_part.corners)
    run = run_engine(find_engine(), stl, settings.global_, settings.extruder, EngineLimits(5000, 900.0))
    stl.unlink()
    text = run.gcode.decode()
    sliced_s = float(text[text.rindex(";TIME_ELAPSED:") :].split(":")[1].split("\n")[0])
    return {"sliced": sliced_s, **compute_times_by_kind_s(text)}


def format_row(row: Row) -> str:
    """Format a row: the error of each feature as a share of the whole time."""
    shares = (
        f"{group} {(priced_s - row.sliced_features_s.get(group, 0.0)) / row.sliced_s:+6.1%}"
        for group, priced_s in row.price_features_s.items()
    )
    return f"{row.part:14} {row.quality:6} {row.sliced_s:7.0f} s {row.error:+6.1%}: {', '.join(shares)}"


def sum_groups_s(kinds_s: Mapping[str, float]) -> dict[str, float]:
    """Sum the seconds of the kinds of lines by group."""
    return {group: sum(kinds_s[name] for name in names) for group, names in LINE_KINDS.items()}


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", default="1,2")
    parser.add_argument("--qualities", default="glue,paper")
    parser.add_argument("--pieces", default="low,high", help="pieces of each model: low, high or whole")
    parser.add_argument("--shapes", action="store_true")
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    args.cache.mkdir(parents=True, exist_ok=True)
    rows = []
    for posed_part in list_parts(
        [int(seed) for seed in args.seeds.split(",") if seed], args.pieces.split(","), args.shapes, args.cache
    ):
        for quality in args.qualities.split(","):
            row = measure(posed_part, quality, args.cache)
            if row is not None:
                rows.append(row)
                if not args.json:
                    print(format_row(row), flush=True)
    errors = np.array([row.error for row in rows])
    if args.json:
        print(json.dumps([asdict(row) | {"error": row.error} for row in rows], indent=1))
    else:
        print(f"mean error {np.abs(errors).mean():.1%}, worst {np.abs(errors).max():.1%}")


if __name__ == "__main__":
    main()
