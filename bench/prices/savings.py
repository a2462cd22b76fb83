"""Time that hidden faces and gradual infill save on parts of unseen models.

Usage: python -m bench.prices.savings [--kinds mechanical,organic,bust] [--seed 1] [--side 150] [--printers 6]
       [--quality glue] [--cache DIR] [--json] [--scheduler tls://HOST:PORT --certificates DIR]

Each model is decomposed four times: with prices that include or ignore hidden faces, each with gradual and
with uniform infill. All parts of the four decompositions are sliced. Times are CuraEngine's.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from bench.clusters.calls import add_cluster_options, count_calls, open_calls
from bench.prices.parts import ENDLESS_BED, PRINTER_MODEL, UNIFORM_INFILL
from bench.unseen import draw_model
from decompose.decompose import decompose_model
from decompose.geometry import write_stl
from decompose.options import Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.results import Part
from drivers.printers import PROFILES, SLICING_PROFILES, list_usable_volumes
from farm.compute import DeferredFunction, TaskFiles
from farm.planning.parts.pricing import build_print_time_settings
from farm.planning.printer_settings import build_slicing_printer
from slicing.glued_parts import HiddenSide
from slicing.plate import PlateRequest, slice_plate
from slicing.settings import PartSettings, SettingsRequest, find_engine, find_resources, resolve_settings


@dataclass(frozen=True, slots=True)
class Row:
    """Times of the parts of one model in seconds: sum and maximum of sliced times and of prices."""

    model: str
    hidden: bool
    gradual: bool
    parts: int
    bed_faces_hidden: int
    tops_hidden: int
    sum_s: float
    makespan_s: float
    price_sum_s: float
    price_makespan_s: float


def slice_part(part: Part, request: SettingsRequest, cache: Path | None, has_hidden_sides: bool) -> float:
    """Slice a part with its own settings; return CuraEngine's time in seconds."""
    part_settings = PartSettings(
        brim_width_mm=part.brim_width_mm,
        layer_0_expansion_mm=part.layer_0_expansion_mm,
        bed_face_hidden=part.bed_face_hidden,
        tops_hidden=part.tops_hidden,
        flat_tops_visible=part.flat_tops_visible,
    )
    settings = resolve_settings(request, find_resources(), part_settings)
    sides = tuple(HiddenSide((x, y), offset_mm) for x, y, offset_mm in part.hidden_sides.tolist())
    sides = sides if has_hidden_sides else ()
    with tempfile.TemporaryDirectory() as folder:
        stl = Path(folder) / "part.stl"
        write_stl(stl, part.build_stl_triangles())
        path = stl.with_suffix(".gcode")
        return slice_plate(
            PlateRequest(stl, settings, path, find_engine(), ENDLESS_BED, cache=cache, hidden_sides=sides)
        ).sliced_s


def measure(kind: str, args: argparse.Namespace) -> list[Row]:
    """Cut a model with and without hidden faces, and slice its parts with and without gradual infill."""
    model = draw_model(kind, args.seed, args.side)
    rows = []
    for has_hidden_faces in (False, True):
        for gradual in (False, True):
            request = SettingsRequest(
                build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL]),
                args.quality,
                overrides={} if gradual else UNIFORM_INFILL,
            )
            settings = resolve_settings(request, find_resources())
            time_settings = build_print_time_settings(settings, overhead_s=0.0)
            if not has_hidden_faces:
                time_settings = replace(
                    time_settings,
                    saved_bed_layer_count=0.0,
                    saved_top_layer_count=0.0,
                    hidden_outer_wall_mm_s=0.0,
                    hidden_inner_wall_mm_s=0.0,
                )
            cost = CostModel.from_settings(time_settings)
            box_sizes_mm = tuple(
                box.size_mm for box in list_usable_volumes(PROFILES[PRINTER_MODEL], time_settings.brim_mm)
            )
            target_printers = [TargetPrinter(str(number), box_sizes_mm) for number in range(args.printers)]
            fit_layer = args.quality == "glue"
            result = decompose_model(
                model, target_printers, Options(fit_first_layer=fit_layer, prove=False), cost
            )
            sliced_s = [slice_part(part, request, args.cache, has_hidden_faces) for part in result.parts]
            prices_s = [part.price_s for part in result.parts]
            rows.append(
                Row(
                    f"{kind}-{args.seed}",
                    has_hidden_faces,
                    gradual,
                    len(sliced_s),
                    sum(part.bed_face_hidden for part in result.parts),
                    sum(part.tops_hidden for part in result.parts),
                    sum(sliced_s),
                    max(sliced_s),
                    sum(prices_s),
                    max(prices_s),
                )
            )
            print(rows[-1], file=sys.stderr, flush=True)
    return rows


def list_files(_: str, args: argparse.Namespace) -> TaskFiles:
    """List the files of `measure`: the cache of slices."""
    return TaskFiles(cache_folders=() if args.cache is None else (args.cache,))


deferred_measure = DeferredFunction("bench.prices.savings:measure", list_files)


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default="mechanical,organic,bust")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--side", type=float, default=150.0)
    parser.add_argument("--printers", type=int, default=6)
    parser.add_argument("--quality", default="glue")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--json", action="store_true")
    add_cluster_options(parser)
    args = parser.parse_args()
    with open_calls(args) as call, ThreadPoolExecutor(count_calls(args)) as threads:
        rows_by_kind = threads.map(lambda kind: call(deferred_measure, kind, args), args.kinds.split(","))
        rows = [row for kind_rows in rows_by_kind for row in kind_rows]
    if args.json:
        print(json.dumps([asdict(row) for row in rows], indent=1))
        return
    for group_start in range(0, len(rows), 4):
        plain_row = rows[group_start]
        for row in rows[group_start : group_start + 4]:
            print(
                f"{row.model:14} hidden {row.hidden:1} gradual {row.gradual:1}  {row.parts:2} parts"
                f"  sum {row.sum_s:7.0f} s {row.sum_s / plain_row.sum_s - 1.0:+6.1%}"
                f"  makespan {row.makespan_s:6.0f} s {row.makespan_s / plain_row.makespan_s - 1.0:+6.1%}"
                f"  price {row.price_sum_s / row.sum_s - 1.0:+5.1%}"
            )


if __name__ == "__main__":
    main()
