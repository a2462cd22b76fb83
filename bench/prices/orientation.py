"""Printing time of parts in their chosen pose, compared with axis poses and the pose in the model.

Parts of decomposed models are sliced with CuraEngine: in the chosen pose, once with the brim and first
layer chosen for the part and once with those of the quality; in every axis pose that fits the printer; and in
the model's pose. A pose whose slice is refused does not count.

Usage: python -m bench.prices.orientation [--parts 30] [--unseen] [--models DIR] [--workers 1] [--cache DIR]
       [--json]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice, zip_longest
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from bench.models.other_shapes import OTHER_SHAPES
from bench.models.shapes import SHAPES
from bench.prices.parts import ENDLESS_BED, PRINTER_COUNTS, PRINTER_MODEL, list_models
from decompose.decompose import decompose_model
from decompose.errors import DecomposeError
from decompose.geometry import Solid, write_stl
from decompose.options import Options
from decompose.pieces import find_cut_faces
from decompose.print_time import (
    MIN_TOUCHED_MM2,
    POSE_ROTATIONS,
    CostModel,
    Pose,
    find_best_pose,
    measure_pose,
)
from decompose.printers import TargetPrinter
from decompose.results import Part
from drivers.printers import PROFILES, SLICING_PROFILES, list_usable_volumes
from farm.planning.parts.pricing import build_print_time_settings
from farm.planning.printer_settings import build_slicing_printer
from slicing.errors import SlicingError
from slicing.plate import PlateRequest, slice_plate
from slicing.settings import (
    DEFAULT_PART,
    PartSettings,
    SettingsRequest,
    find_engine,
    find_resources,
    resolve_settings,
)

Shapes = Mapping[str, Callable[[], Solid]]

REQUEST = SettingsRequest(build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL]), "glue")
NO_ROTATION = 4  # index into POSE_ROTATIONS


@dataclass(frozen=True, slots=True)
class Row:
    """Times of one part in seconds, None if a slice is refused.

    All are CuraEngine's, except `price_s` and `compute_s`.

    Attributes
    ----------
    chosen_s, full_brim_s
        Time in the chosen pose, with the brim chosen for the part and with the quality's.
    axes_s, axes_stand, axes_touched_mm2
        In the axis poses that fit: time, whether the part stands, and area of cut faces that support touches.
    """

    part: str
    price_s: float
    compute_s: float
    chosen_s: float | None
    full_brim_s: float | None
    pose_in_model_s: float | None
    up: list[float]
    brim_mm: float | None
    stands: bool
    touched_mm2: float
    axes_s: list[float | None]
    axes_stand: list[bool]
    axes_touched_mm2: list[float]

    def find_best_axis_s(self, standing_only: bool = False) -> float | None:
        """Find the shortest time among the axis poses; None if every slice was refused."""
        poses = zip(self.axes_s, self.axes_stand, strict=True)
        return min(
            (t for t, stands in poses if t is not None and (stands or not standing_only)), default=None
        )


def list_parts(
    folder: Path | None, shapes: Shapes, cost: CostModel, printer: TargetPrinter, count: int
) -> Iterator[tuple[str, Part]]:
    """Yield `count` parts: one of each decomposed model in turn, in random order."""
    rng = np.random.default_rng(2)

    def list_shuffled_parts() -> Iterator[list[tuple[str, Part]]]:
        for name, model in list_models(folder, shapes):
            for printers in PRINTER_COUNTS:
                try:
                    parts = decompose_model(model, [printer] * printers, Options(prove=False), cost).parts
                except DecomposeError as error:
                    print(f"{name} for {printers}: {error}", file=sys.stderr)
                    continue
                yield [(f"{name}-{printers}-{parts[i].id}", parts[i]) for i in rng.permutation(len(parts))]

    rounds = zip_longest(*list_shuffled_parts())
    yield from islice(
        (entry for row in rounds for entry in row if entry is not None),
        count,
    )


def slice_part(
    folder: Path, cache: Path | None, part: Part, pose: Pose, part_settings: PartSettings
) -> float | None:
    """Slice a part in a pose; return CuraEngine's time in seconds, None if the slice is refused."""
    settings = resolve_settings(REQUEST, find_resources(), part_settings)
    posed_part = Part(part.id, part.solid, pose.to_model, pose.price_s, part.printer)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        stl = Path(scratch) / "part.stl"
        write_stl(stl, posed_part.build_stl_triangles())
        path = stl.with_suffix(".gcode")
        try:
            return slice_plate(
                PlateRequest(stl, settings, path, find_engine(), ENDLESS_BED, cache=cache)
            ).sliced_s
        except SlicingError as error:
            print(f"refused: {error}", file=sys.stderr)
            return None


def measure_poses(
    named_part: tuple[str, Part], printer: TargetPrinter, cost: CostModel, folder: Path, cache: Path | None
) -> Row:
    """Slice one part in its chosen pose, in the axis poses and in the pose in the model."""
    name, part = named_part
    vertices, faces = part.solid.arrays()
    is_cut = find_cut_faces(vertices, faces, part.planes)
    start_s = perf_counter()
    best = find_best_pose(vertices, faces, is_cut, [printer], cost)
    compute_s = perf_counter() - start_s
    if best is None:
        raise SystemExit(f"{name} fits in no pose")
    axis_poses = [measure_pose(vertices, faces, is_cut, rotation, cost) for rotation in POSE_ROTATIONS]
    fitting_poses = [pose for pose in axis_poses if printer.fits(*pose.size_mm)]
    slice_pose = partial(slice_part, folder, cache, part)
    part_settings = PartSettings(
        None,
        best.brim_width_mm,
        best.layer_0_expansion_mm,
        best.bed_face_hidden,
        best.tops_hidden,
        best.flat_tops_visible,
    )
    return Row(
        part=name,
        price_s=best.price_s,
        compute_s=compute_s,
        chosen_s=slice_pose(best, part_settings),
        full_brim_s=slice_pose(best, DEFAULT_PART),
        pose_in_model_s=slice_pose(axis_poses[NO_ROTATION], DEFAULT_PART),
        up=best.to_model[:3, 2].tolist(),
        brim_mm=best.brim_width_mm,
        stands=best.stands,
        touched_mm2=best.touched_mm2,
        axes_s=[slice_pose(pose, DEFAULT_PART) for pose in fitting_poses],
        axes_stand=[pose.stands for pose in fitting_poses],
        axes_touched_mm2=[pose.touched_mm2 for pose in fitting_poses],
    )


def summarise(rows: list[Row]) -> dict[str, Any]:
    """Compute the mean and the worst ratio of times over all parts."""

    def compute_ratios(pairs: list[tuple[float | None, float | None]]) -> dict[str, float]:
        values = [a / b for a, b in pairs if a is not None and b is not None]
        return {"mean": float(np.mean(values)), "worst": max(values), "parts": len(values)}

    is_touched = [t > MIN_TOUCHED_MM2 for r in rows for t in r.axes_touched_mm2]
    return {
        "schema": 1,
        "to_best_axis": compute_ratios([(r.chosen_s, r.find_best_axis_s()) for r in rows]),
        "to_best_axis_full_brim": compute_ratios([(r.full_brim_s, r.find_best_axis_s()) for r in rows]),
        "to_best_standing_axis": compute_ratios(
            [(r.chosen_s, r.find_best_axis_s(standing_only=True)) for r in rows]
        ),
        "to_pose_in_model": compute_ratios([(r.chosen_s, r.pose_in_model_s) for r in rows]),
        "price_ratio": compute_ratios([(r.price_s, r.chosen_s) for r in rows]),
        "stand": sum(r.stands for r in rows),
        "touched": sum(r.touched_mm2 > MIN_TOUCHED_MM2 for r in rows),
        "axes_touched_share": float(np.mean(is_touched)),
        "compute_s": sum(r.compute_s for r in rows),
        "parts": [asdict(r) for r in rows],
    }


def main() -> int:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", type=int, default=30)
    parser.add_argument("--unseen", action="store_true", help="use shapes that were not used for tuning")
    parser.add_argument("--models", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    settings = resolve_settings(REQUEST, find_resources())
    # Parts are sliced without their hidden sides.
    plain_settings = replace(settings, hidden_wall_ratio=1.0, has_single_hidden_walls=False)
    cost = CostModel.from_settings(build_print_time_settings(plain_settings, overhead_s=0.0))
    printer = TargetPrinter(
        "0", tuple(b.size_mm for b in list_usable_volumes(PROFILES[PRINTER_MODEL], settings.brim_width_mm))
    )
    shapes = OTHER_SHAPES if args.unseen else SHAPES
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(args.workers) as pool:
        measure_part = partial(
            measure_poses, printer=printer, cost=cost, folder=Path(scratch), cache=args.cache
        )
        rows = []
        for row in pool.map(measure_part, list_parts(args.models, shapes, cost, printer, args.parts)):
            rows.append(row)
            print(_format_line(row), file=sys.stderr if args.json else sys.stdout, flush=True)
    result = summarise(rows)
    if args.json:
        print(json.dumps(result, indent=1))
        return 0
    for name in (
        "to_best_axis",
        "to_best_axis_full_brim",
        "to_best_standing_axis",
        "to_pose_in_model",
        "price_ratio",
    ):
        figures = result[name]
        print(f"{name:24} mean {figures['mean']:.3f}, worst {figures['worst']:.3f}, {figures['parts']} parts")
    print(
        f"{result['stand']} of {len(rows)} parts stand; "
        f"support touches a cut face of {result['touched']} parts "
        f"and in {result['axes_touched_share']:.0%} of the axis poses"
    )
    print(f"poses chosen in {result['compute_s']:.1f} s")
    return 0


def _format_line(row: Row) -> str:
    up_text = " ".join(f"{v:+.2f}" for v in row.up)
    chosen, axis, in_model = (
        "-" if t is None else f"{t:.0f}" for t in (row.chosen_s, row.find_best_axis_s(), row.pose_in_model_s)
    )
    brim = "-" if row.brim_mm is None else f"{row.brim_mm:g}"
    times_text = f"chosen {chosen:>6}  axis {axis:>6}  in model {in_model:>6}"
    return f"{row.part:24} up {up_text}  brim {brim:>3}  {times_text}"


if __name__ == "__main__":
    sys.exit(main())
