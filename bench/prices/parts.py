"""Dataset of the print-time model: parts of decompositions, sliced with several groups of settings.

Only figures are stored, because the scripts can recreate models, parts and slices.
"""

from __future__ import annotations

import csv
import math
import re
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from bench.models.shapes import SHAPES
from bench.unseen import KINDS, draw_model
from decompose.decompose import decompose_model
from decompose.errors import DecomposeError
from decompose.geometry import Model, Solid, load_model, round_triangles, write_stl
from decompose.options import Options
from decompose.print_time import (
    POSE_ROTATIONS,
    CostModel,
    PrintTimeSettings,
    measure_columns,
    sum_pose_features,
)
from decompose.printers import TargetPrinter
from drivers.printers import PROFILES, SLICING_PROFILES, list_usable_volumes
from farm.planning.parts.pricing import build_print_time_settings
from farm.planning.printer_settings import build_slicing_printer
from slicing.errors import SlicingError
from slicing.plate import PlateRequest, slice_plate
from slicing.settings import EngineSettings, SettingsRequest, find_engine, find_resources, resolve_settings

PRINTER_MODEL = "ultimaker2_plus"
# Larger than any model: only times and walls are measured, so the printer's limits do not matter.
ENDLESS_BED = ((-1000.0, -1000.0, 1000.0, 1000.0, 1000.0),)
PRINTER_COUNTS = (4, 9)  # printers, for parts of two sizes
OTHER_MODEL_MM = 200.0  # longest side of a model from a folder

UNIFORM_INFILL: Mapping[str, Any] = {"gradual_infill_steps": 0}

# As in `glue` when the dataset was made: uniform infill, narrow lines, and Cura's speeds of skins and inner
# walls.
_DATASET_OVERRIDES: Mapping[str, Any] = {
    **UNIFORM_INFILL,
    "roofing_layer_count": 0,
    "infill_line_width": 0.35,
    "skin_line_width": 0.35,
    "layer_height": 0.2,  # the mean of the fitted layers
    "speed_topbottom": 30,
    "speed_wall_x": 50,
}

# This project's two qualities, and settings that differ in all terms of the physical model; `even` is `glue`
# as it was when the dataset was made.
SETTINGS: dict[str, tuple[str, float, Mapping[str, Any]]] = {
    "even": ("glue", 0.4, _DATASET_OVERRIDES),
    "paper": ("paper", 0.4, {}),
    "glue": ("glue", 0.4, {}),
    "fine": (
        "glue",
        0.4,
        {
            **_DATASET_OVERRIDES,
            "layer_height": 0.15,
            "infill_sparse_density": 20,
        },
    ),
    "wide": (
        "glue",
        0.6,
        {
            **_DATASET_OVERRIDES,
            "infill_line_width": 0.53,
            "layer_height": 0.3,
            "skin_line_width": 0.53,
            "speed_topbottom": 20,
            "speed_wall_x": 40,
        },
    ),
    "other": (
        "glue",
        0.4,
        {
            **_DATASET_OVERRIDES,
            "layer_height": 0.25,
            "line_width": 0.4,
            "infill_line_width": 0.4,
            "skin_line_width": 0.4,
            "speed_wall_0": 25,
            "speed_wall_x": 35,
            "speed_infill": 80,
            "speed_topbottom": 20,
            "infill_pattern": "grid",
            "infill_sparse_density": 15,
            "support_angle": 60,
        },
    ),
}
OTHER_POSES = (0, 1, 2, 3, 5)  # indices into POSE_ROTATIONS; 4 does not rotate a part
# Names of the settings with which all parts are sliced; every second part is sliced with the others, too.
SETTINGS_FOR_ALL_PARTS = ("even", "paper")
FIELDS_BY_FEATURE = {
    "WALL-OUTER": "walls_s",
    "WALL-INNER": "walls_s",
    "FILL": "fill_s",
    "SKIN": "skin_s",
    "SUPPORT": "support_s",
    "SUPPORT-INTERFACE": "support_s",
    "SKIRT": "brim_s",
}


@dataclass(frozen=True, slots=True)
class Row:
    """Features of one part sliced with one group of settings, with CuraEngine's times.

    `sliced_s` is the total time; the other `*_s` are the length of the lines of a kind divided by their
    speed.
    """

    model: str
    part: str
    printed: bool  # True in the pose that the decomposition chose, False in another axis pose
    settings: str
    volume_mm3: float
    lateral_mm2: float
    skin_mm2: float
    slope_mm2: float
    column_mm3: float
    width_mm: float
    depth_mm: float
    height_mm: float
    support_mm3: float
    support_side_mm2: float
    towers_mm: float
    islands_mm: float
    sliced_s: float
    walls_s: float
    fill_s: float
    skin_s: float
    support_s: float
    brim_s: float


def resolve_named_settings(name: str) -> EngineSettings:
    """Resolve one of SETTINGS, or a quality."""
    quality, nozzle_mm, overrides = SETTINGS.get(name, (name, 0.4, {}))
    request = SettingsRequest(
        build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL]),
        quality,
        nozzle_mm=nozzle_mm,
        overrides=overrides,
    )
    return resolve_settings(request, find_resources())


def make_print_time_settings(name: str) -> PrintTimeSettings:
    """Make the cost model's settings for one of SETTINGS."""
    return build_print_time_settings(resolve_named_settings(name), overhead_s=0.0)


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV, with six significant digits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(f.name for f in fields(Row))
        for row in rows:
            values = asdict(row).values()
            writer.writerow(f"{v:.6g}" if isinstance(v, float) else v for v in values)


def read_rows(path: Path) -> list[Row]:
    """Read rows from a CSV file."""

    def parse(name: str, text: str) -> Any:
        if name == "printed":
            return text == "True"
        return text if name in ("model", "part", "settings") else float(text)

    with path.open(newline="", encoding="utf-8") as file:
        return [
            Row(**{name: parse(name, text) for name, text in row.items()}) for row in csv.DictReader(file)
        ]


def list_models(
    folder: Path | None, shapes: Mapping[str, Callable[[], Solid]] = SHAPES
) -> Iterator[tuple[str, Model]]:
    """Yield the bench shapes, and the models of a folder that can be read and repaired."""
    for name, make in shapes.items():
        yield name, Model(make(), (), 1.0)
    for path in sorted(folder.iterdir()) if folder else ():
        if path.suffix.lower() in (".stl", ".obj"):
            try:
                yield path.stem, load_model(path, longest_side_mm=OTHER_MODEL_MM)
            except DecomposeError as error:
                print(f"{path.name}: {error}", file=sys.stderr)


@dataclass(frozen=True, slots=True)
class PosedPart:
    """Part in its pose on the bed."""

    model: str
    part: str
    is_chosen_pose: bool
    corners: np.ndarray  # (m, 3, 3) float32

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (3 m, 3) in mm, and faces (m, 3)."""
        corners = self.corners.reshape(-1, 3).astype(np.float64)
        return corners, np.arange(len(corners)).reshape(-1, 3)


def list_unseen_models(seed: int) -> Iterator[tuple[str, Model]]:
    """Yield a model of each kind of `bench.unseen`, drawn by a seed."""
    for kind in KINDS:
        yield f"{kind}-{seed}", draw_model(kind, seed, OTHER_MODEL_MM)


def list_parts(models: Iterable[tuple[str, Model]], max_parts: int) -> Iterator[PosedPart]:
    """Yield some parts of each model for each number of printers; some parts also in another axis pose."""
    cost = CostModel.from_settings(make_print_time_settings("glue"))
    box_sizes_mm = tuple(
        box.size_mm
        for box in list_usable_volumes(PROFILES[PRINTER_MODEL], make_print_time_settings("glue").brim_mm)
    )
    for name, model in models:
        for count in PRINTER_COUNTS:
            printers = [TargetPrinter(str(i), box_sizes_mm) for i in range(count)]
            try:
                parts = list(decompose_model(model, printers, Options(prove=False), cost).parts)
            except DecomposeError as error:
                print(f"{name} for {count}: {error}", file=sys.stderr)
                continue
            # The generator is seeded for each model, so adding a model does not change the other rows.
            rng = np.random.default_rng(count)
            rng.shuffle(parts)  # type: ignore[arg-type]
            for part in parts[:max_parts]:
                part_name = f"{count}-{part.id}"
                yield PosedPart(name, part_name, True, part.build_stl_triangles())
                if rng.random() < 0.35:
                    vertices, faces = part.build_printing_mesh()
                    turned_mm = vertices @ POSE_ROTATIONS[rng.choice(OTHER_POSES)].T
                    lo, hi = turned_mm.min(axis=0), turned_mm.max(axis=0)
                    corners = round_triangles(turned_mm - [*(lo + hi)[:2] / 2.0, lo[2]], faces)
                    if corners is not None:
                        yield PosedPart(name, f"{part_name}-turned", False, corners)


def measure(posed_part: PosedPart, settings_name: str, folder: Path, cache: Path | None) -> Row | None:
    """Slice one part with one group of settings; return None if the slice is refused."""
    settings = resolve_named_settings(settings_name)
    name = f"{posed_part.model}-{posed_part.part}-{settings_name}"
    stl, output = folder / f"{name}.stl", folder / f"{name}.gcode"
    write_stl(stl, posed_part.corners)
    request = PlateRequest(
        stl=stl, settings=settings, output_path=output, engine=find_engine(), bed=ENDLESS_BED, cache=cache
    )
    try:
        sliced_s = slice_plate(request).sliced_s
    except SlicingError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return None
    kinds = compute_extrusion_times_s(output.read_text(encoding="utf-8"))
    stl.unlink()
    output.unlink()
    cost = CostModel.from_settings(build_print_time_settings(settings, overhead_s=0.0))
    (features,), (extents,) = sum_pose_features(*posed_part.arrays, POSE_ROTATIONS[4:5], cost)
    no_marks = np.zeros(len(posed_part.corners), dtype=np.bool_)
    support = measure_columns(posed_part.corners.astype(np.float64), no_marks, cost.overhang_cos)
    figures = [*map(float, features), *map(float, extents)]
    figures += [
        support.support_mm3,
        support.support_side_mm2,  # not the fine ones, as in all rows of print_time.csv
        support.towers_mm,
        support.islands_mm,
        sliced_s,
    ]
    return Row(posed_part.model, posed_part.part, posed_part.is_chosen_pose, settings_name, *figures, **kinds)


def compute_extrusion_times_s(gcode: str) -> dict[str, float]:
    """Compute the seconds of extrusion of each kind of line: length over speed, without acceleration."""
    seconds = dict.fromkeys(FIELDS_BY_FEATURE.values(), 0.0)
    kind, position, feed_mm_s = "", dict.fromkeys("XYZEF", 0.0), 1.0
    for line in gcode.splitlines():
        if line.startswith(";TYPE:"):
            kind = FIELDS_BY_FEATURE.get(line[6:], "")
        elif line.startswith(("G0 ", "G1 ", "G92 ")):
            next_position = position | {
                text[0]: float(text[1:]) for text in re.findall(r"[XYZEF]-?[\d.]+", line)
            }
            length_mm = math.dist([position[a] for a in "XYZ"], [next_position[a] for a in "XYZ"])
            feed_mm_s = next_position["F"] / 60.0 or feed_mm_s
            if kind and next_position["E"] > position["E"] and not line.startswith("G92"):
                seconds[kind] += length_mm / feed_mm_s
            position = next_position
    return seconds


def make_table(
    models: Iterable[tuple[str, Model]], max_parts: int, workers: int, cache: Path | None
) -> list[Row]:
    """Slice all parts with their groups of settings; return the rows of the table."""
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(workers) as pool:
        futures = []
        for number, posed_part in enumerate(list_parts(models, max_parts)):
            settings_names = SETTINGS if number % 2 == 0 else SETTINGS_FOR_ALL_PARTS
            futures += [
                pool.submit(measure, posed_part, name, Path(scratch), cache) for name in settings_names
            ]
        return [row for future in futures if (row := future.result()) is not None]
