"""Quality of decompositions by model, number of printers and engine, with all parts sliced by CuraEngine.

Usage: python -m bench.decompose --models DIR [--printers 20,50,100] [--engines best,parallelobox-faithful]
       [--only NAME,...] [--side 450] [--quality paper] [--granularity auto] [--budget S] [--results DIR]
       [--jobs N] [--no-slices] [--whole as-is,best-pose | --no-whole] [--json]
       [--scheduler tls://HOST:PORT --certificates DIR]

Engines other than `best` run only for the first number of printers. If an engine that takes no number returns
k parts, `best` runs for k printers as well, for a fair comparison. Partitions of the guillotine engine are
balanced again by their sliced times (`decompose.rebalance`) if that makes them faster. Each run is stored in
a file in --results and is not repeated; slices are cached. The uncut model is sliced as it stands, and in its
best pose, on a bed without limits (with --no-whole, its times are the estimates of the cost model).
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import trimesh

from bench.clusters.calls import add_cluster_options, count_calls, open_calls
from bench.prices.parts import ENDLESS_BED, make_print_time_settings
from bench.search.decomposition_rows import (
    AS_IS,
    BEST_POSE,
    PART_ENGINES,
    add_whole,
    compute_row,
    format_row,
    summarise,
)
from bench.search.peak_memory import read_peak_mb
from decompose.decompose import decompose_model
from decompose.errors import DecomposeError
from decompose.export import write_decomposition
from decompose.geometry import load_model
from decompose.options import BUDGET_S, BestOptions, Engine, Options
from decompose.print_time import CostModel, find_best_pose, measure_pose
from decompose.printers import TargetPrinter
from decompose.rebalance import MAX_ROUNDS, SlicedCuts, rebalance_planes
from decompose.results import Decomposition
from drivers.printers import PROFILES, SLICING_PROFILES, list_usable_volumes
from farm.compute import DeferredFunction, TaskFiles
from farm.errors import FarmError
from farm.model import PartPrintOptions
from farm.planning.part_records import SliceTask
from farm.planning.parts.slice_part import resolve_slice_settings
from farm.planning.printer_settings import build_slicing_printer, list_max_part_sizes_mm
from farm.planning.tasks import slice_part
from slicing.errors import SlicingError
from slicing.plate import PlateRequest, slice_plate
from slicing.settings import SettingsRequest, find_engine, find_resources, resolve_settings

MODELS = (
    "stanford-bunny.stl", "utah-teapot.obj", "3DBenchy.stl", "fandisk.stl",
    "thingi10k-1053374.stl", "thingi10k-41084.stl", "thingi10k-77951.stl",
)  # fmt: skip
PRINTER_MODEL = "ultimaker2_plus"
FAITHFUL_SUFFIX = "-faithful"  # suffix of an engine's name
WHOLE_TIMEOUT_S = 3600.0
CUT_FILE = "cutting.pickle"


@dataclass(frozen=True, slots=True)
class Run:
    """Run of one engine on one model for a number of printers."""

    path: Path
    side_mm: float
    printers: int
    engine: str
    quality: str
    granularity: str
    budget_s: float

    @property
    def name(self) -> str:
        variant = f"{self.printers}-{self.engine}-{self.quality}-{self.granularity}"
        return f"{self.path.stem}-{self.side_mm:g}-{variant}"

    @property
    def settings_request(self) -> SettingsRequest:
        return SettingsRequest(build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL]), quality=self.quality)


@dataclass(frozen=True, slots=True)
class SlicedRound:
    """Partition of a run in a file, with the sliced time of each part and the sliced makespan."""

    cut_file: Path
    times_s: list[float]
    makespan_s: float

    def read_cuts(self) -> SlicedCuts:
        """Read the partition for `rebalance_planes`."""
        return SlicedCuts(pickle.loads(self.cut_file.read_bytes()), self.times_s, self.makespan_s)


def cut_model(run: Run, folder: Path) -> dict[str, Any]:
    """Decompose a model in its own process; return the report, with wall time and peak memory."""
    time_settings = make_print_time_settings(run.quality)
    cost = CostModel.from_settings(time_settings)
    settings = resolve_settings(run.settings_request, find_resources())
    boxes_mm = list_max_part_sizes_mm(
        list_usable_volumes(PROFILES[PRINTER_MODEL], settings.brim_width_mm), settings
    )
    printers = [TargetPrinter(str(i), boxes_mm) for i in range(run.printers)]
    is_faithful = run.engine.endswith(FAITHFUL_SUFFIX)
    engine = Engine(run.engine.removesuffix(FAITHFUL_SUFFIX))
    fits_first_layer = run.quality == "glue"
    options = Options(
        engine,
        run.granularity,
        faithful=is_faithful,
        fit_first_layer=fits_first_layer,
        best=BestOptions(run.budget_s),
    )
    _compile_kernels(cost, boxes_mm)
    start_s = perf_counter()
    try:
        model = load_model(run.path, longest_side_mm=run.side_mm)
        with ThreadPoolExecutor(os.cpu_count()) as executor:
            result = decompose_model(model, printers, options, cost, executor)
        wall_s = perf_counter() - start_s
    except DecomposeError as error:
        return {"refused": f"{type(error).__name__}: {error}"}
    return _write_parts(result, folder, wall_s)


def rebalance(run: Run, rounds: list[SlicedRound], folder: Path) -> dict[str, Any] | None:
    """Balance a partition by the sliced times of all rounds so far; None if no gain is expected."""
    start_s = perf_counter()
    model = load_model(run.path, longest_side_mm=run.side_mm)
    cost = CostModel.from_settings(make_print_time_settings(run.quality))
    try:
        with ThreadPoolExecutor(os.cpu_count()) as executor:
            result = rebalance_planes(model, [r.read_cuts() for r in rounds], cost, executor)
    except DecomposeError as error:
        print(f"{run.name}, balanced again: {error}", file=sys.stderr)
        return None
    return None if result is None else _write_parts(result, folder, perf_counter() - start_s)


def list_cut_files(run: Run, folder: Path) -> TaskFiles:
    """List the files of `cut_model`: the model, and the folder of the parts."""
    return TaskFiles(input_files=(run.path,), output_folders=(folder,))


def list_rebalance_files(run: Run, rounds: list[SlicedRound], folder: Path) -> TaskFiles:
    """List the files of `rebalance`: the model, its partitions, and the folder of the parts."""
    return TaskFiles(input_files=(run.path, *(r.cut_file for r in rounds)), output_folders=(folder,))


deferred_cut = DeferredFunction("bench.decompose:cut_model", list_cut_files)
deferred_rebalance = DeferredFunction("bench.decompose:rebalance", list_rebalance_files)


def _write_parts(result: Decomposition, folder: Path, wall_s: float) -> dict[str, Any]:
    """Write the parts and the input of `rebalance` into a folder; return the report."""
    report = write_decomposition(result, folder).as_dict()
    (folder / CUT_FILE).write_bytes(pickle.dumps(result.without_parts()))
    report["wall_s"] = wall_s
    report["peak_mb"] = read_peak_mb()
    return report


def _compile_kernels(cost: CostModel, boxes_mm: tuple[tuple[float, float, float], ...]) -> None:
    """Compile the kernels before the measured time."""
    from decompose.geometry import Model, Solid

    box = Model(Solid.box((0.0, 0.0, 0.0), (300.0, 60.0, 60.0)), (), 1.0)
    options = Options(Engine.GUILLOTINE, granularity=5)
    decompose_model(box, [TargetPrinter(str(i), boxes_mm) for i in range(4)], options, cost)


def slice_parts(
    report: dict[str, Any], run: Run, folder: Path, args: argparse.Namespace
) -> list[float | None]:
    """Slice every part; return CuraEngine's times in seconds, None if a slice is refused."""
    request = run.settings_request
    settings = resolve_settings(request, find_resources())
    volumes = list_usable_volumes(PROFILES[PRINTER_MODEL], settings.brim_width_mm)

    def slice_report_part(part: dict[str, Any]) -> float | None:
        task = SliceTask(
            part["id"], folder / part["file"], request, find_resources(), settings, volumes, find_engine(),
            folder / f"{part['id']}.gcode", args.results / "slices",
            PartPrintOptions(
                brim_width_mm=part["brim_width_mm"],
                layer_0_expansion_mm=part["layer_0_expansion_mm"],
                bed_face_hidden=part["bed_face_hidden"],
                tops_hidden=part["tops_hidden"],
                flat_tops_visible=part["flat_tops_visible"],
                hidden_sides=part["hidden_sides"],
                hidden_grooves=part["hidden_grooves"],
                hidden_recesses=part["hidden_recesses"],
            ),
        )  # fmt: skip
        try:
            sliced_s: float = args.call_in_thread(slice_part, task).sliced_s
            return sliced_s
        except FarmError as error:
            print(f"{run.name} {part['id']}: {error}", file=sys.stderr)
            return None
        finally:
            task.out.unlink(missing_ok=True)
            task.out.with_suffix(".placed.stl").unlink(missing_ok=True)

    with ThreadPoolExecutor(count_calls(args, args.jobs)) as pool:
        return list(pool.map(slice_report_part, report["parts"]))


def slice_whole_model(run: Run, pose_name: str, results: Path, cache: Path) -> float | None:
    """Slice the uncut model as it stands, or in its best pose; return CuraEngine's time in seconds.

    As for a part, its layers are fitted to its height, and its first layer and its brim to its foot; it is
    not scaled to compensate for shrinkage.
    """
    record_path = results / f"{run.path.stem}-{run.side_mm:g}-{run.quality}-uncut-{pose_name}.json"
    if record_path.is_file():
        seconds: float | None = json.loads(record_path.read_text())
        return seconds
    stl = results / f"{run.path.stem}-whole-{pose_name}.stl"
    gcode, resources = stl.with_suffix(".gcode"), find_resources()
    mesh, print_options = _place_whole_model(run, pose_name)
    mesh.export(stl)
    task = SliceTask(
        "whole", stl, run.settings_request, resources, resolve_settings(run.settings_request, resources), (),
        find_engine(), gcode, cache, print_options,
    )  # fmt: skip
    settings = resolve_slice_settings(task, mesh)
    request = PlateRequest(stl, settings, gcode, task.engine, ENDLESS_BED, WHOLE_TIMEOUT_S, cache)
    try:
        seconds = slice_plate(request).sliced_s
    except SlicingError as error:
        print(f"{run.path.stem} whole: {error}", file=sys.stderr)
        seconds = None
    record_path.write_text(json.dumps(seconds))
    stl.unlink()
    gcode.unlink(missing_ok=True)
    return seconds


def _place_whole_model(run: Run, pose_name: str) -> tuple[trimesh.Trimesh, PartPrintOptions]:
    """Place the uncut model on the bed, as it stands or in its best pose; return it with its settings."""
    vertices, faces = load_model(run.path, longest_side_mm=run.side_mm).solid.arrays()
    cost, is_cut = CostModel.from_settings(make_print_time_settings(run.quality)), np.zeros(len(faces), bool)
    fits_first_layer = run.quality == "glue"
    if pose_name == BEST_POSE:
        pose = find_best_pose(vertices, faces, is_cut, (), cost, fits_first_layer)
        assert pose is not None  # no model is too large for a printer without limits
    else:
        pose = measure_pose(vertices, faces, is_cut, np.eye(3), cost, fits_first_layer)
    placed_mm = (vertices - pose.to_model[:3, 3]) @ pose.to_model[:3, :3]
    print_options = PartPrintOptions(
        brim_width_mm=pose.brim_width_mm,
        layer_0_expansion_mm=pose.layer_0_expansion_mm,
        flat_tops_visible=pose.flat_tops_visible,
    )
    return trimesh.Trimesh(placed_mm, faces, process=False), print_options


def load_or_run(run: Run, args: argparse.Namespace) -> dict[str, Any]:
    """Return the row of one run, from its file if there is one."""
    record_path = args.results / f"{run.name}.json"
    if record_path.is_file():
        row: dict[str, Any] = json.loads(record_path.read_text())
        if row.get("sliced") or args.no_slices or "refused" in row:
            return row
    folder = args.results / run.name
    report = args.call(deferred_cut, run, folder)
    sliced_s = None
    if not args.no_slices and "refused" not in report:
        sliced_s = slice_parts(report, run, folder, args)
    row = compute_row(run.path.stem, run.printers, run.engine, report, sliced_s)
    times_s = [part_s for part_s in sliced_s or () if part_s is not None]
    if row.get("sliced") and (folder / CUT_FILE).is_file():
        row = move_planes(row, SlicedRound(folder / CUT_FILE, times_s, row["parallel_s"]), run, folder, args)
    record_path.write_text(json.dumps(row, indent=1))
    return row


def move_planes(
    row: dict[str, Any], first_round: SlicedRound, run: Run, folder: Path, args: argparse.Namespace
) -> dict[str, Any]:
    """Move the planes of a run by its slices, as a job does; return the row of the fastest round."""
    rounds, first_s, first_row = [first_round], row["parallel_s"], row
    while len(rounds) <= MAX_ROUNDS:
        move_folder = folder / f"plane_moves{len(rounds)}"
        report = args.call(deferred_rebalance, run, rounds, move_folder)
        if report is None:
            break
        sliced_s = slice_parts(report, run, move_folder, args)
        moved_row = compute_row(run.path.stem, run.printers, run.engine, report, sliced_s)
        if not moved_row["sliced"]:
            break
        print(f"{run.name}: moved planes {len(rounds)}: {moved_row['parallel_s']:.0f} s", file=sys.stderr)
        if moved_row["parallel_s"] < row["parallel_s"]:
            changes = {"plane_moves": len(rounds), "plane_moves_wall_s": moved_row["wall_s"]}
            first = {"first_s": first_s, "wall_s": first_row["wall_s"], "peak_mb": first_row["peak_mb"]}
            row = moved_row | changes | first
        times_s = [part_s for part_s in sliced_s if part_s is not None]
        rounds.append(SlicedRound(move_folder / CUT_FILE, times_s, moved_row["parallel_s"]))
    return row


def call_in_process(function: Callable[..., Any], *args: Any) -> Any:
    """Call a function in its own process, to measure its peak memory."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(function, *args).result()


def make_rows(path: Path, args: argparse.Namespace) -> list[dict[str, Any]]:
    """Return all rows of one model."""
    rows = []

    def measure_run(printers: int, engine: str) -> dict[str, Any]:
        run = Run(path, args.side, printers, engine, args.quality, args.granularity, args.budget)
        row = load_or_run(run, args)
        for pose_name in args.whole if "refused" not in row else ():
            whole_s = slice_whole_model(run, pose_name, args.results, args.results / "slices")
            add_whole(row, pose_name, whole_s)
        print(format_row(row), file=sys.stderr if args.json else sys.stdout, flush=True)
        rows.append(row)
        return row

    for engine in args.engines:
        for printers in args.printers if engine == "best" else args.printers[:1]:
            row = measure_run(printers, engine)
            if engine.startswith(PART_ENGINES) and row.get("parts", printers) < printers:
                measure_run(row["parts"], "best")
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--models", type=Path, required=True)
    parser.add_argument("--only", type=lambda text: text.split(","), default=list(MODELS))
    parser.add_argument("--printers", type=lambda t: [int(n) for n in t.split(",")], default=[20, 50, 100])
    parser.add_argument("--engines", type=lambda text: text.split(","), default=["best"])
    parser.add_argument("--side", type=float, default=450.0)
    parser.add_argument("--quality", default="paper")
    parser.add_argument("--granularity", default="auto")
    parser.add_argument(
        "--budget", type=float, default=BUDGET_S, help="effort of the engine best, in seconds of one core"
    )
    parser.add_argument("--results", type=Path, default=Path("bench-results"))
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--no-slices", action="store_true")
    parser.add_argument("--whole", type=lambda text: text.split(","), default=[AS_IS, BEST_POSE])
    parser.add_argument("--no-whole", dest="whole", action="store_const", const=[])
    parser.add_argument("--json", action="store_true")
    add_cluster_options(parser)
    args = parser.parse_args()
    args.results = args.results.absolute()
    args.results.mkdir(parents=True, exist_ok=True)
    with open_calls(args, call_in_process) as args.call, open_calls(args) as args.call_in_thread:
        rows = [row for name in args.only for row in make_rows(args.models / name, args)]
    result = {"schema": 1, "runs": rows, **summarise(rows)}
    print(json.dumps(result, indent=1) if args.json else json.dumps(summarise(rows), indent=1))
    return 0


if __name__ == "__main__":
    from bench import decompose  # imported by name so that other processes can unpickle its functions

    sys.exit(decompose.main())
