"""How well the cost model knows CuraEngine: slice the parts of some models and compare.

Usage: python -m bench.decompose_cost [--quality Q] [--printers N] [--json] MODEL:LONGEST_SIDE_MM ...
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import nnls

from decompose.cost import CostModel, PrinterRoom, pose_seconds
from decompose.mesh import load_model
from decompose.partition import decompose
from decompose.report import Options, Part, write
from drivers.profiles import PROFILES, part_room
from farm.services.recipe import recipe
from slicing.errors import SlicingError
from slicing.plate import PlateRequest, slice_plate
from slicing.resources import find_engine, find_resources
from slicing.settings import SettingsRequest, resolve_settings

TERMS = (
    "fixed_s",
    "volume_s_mm3",
    "lateral_s_mm2",
    "skin_s_mm2",
    "overhang_s_mm3",
    "brim_s_mm2",
    "height_s_mm",
)
MODEL = "ultimaker2_plus"
ANYWHERE = ((-500.0, -500.0, 500.0, 500.0, 500.0),)  # parts are not placed here, only timed


def features(part: Part, cost: CostModel) -> list[float]:
    """What each coefficient is multiplied by, in the pose that is printed."""
    vertices, faces = part.solid.arrays()
    nothing = replace(cost, **dict.fromkeys(TERMS, 0.0))
    pose = part.rotation[None]
    return [float(pose_seconds(vertices, faces, pose, replace(nothing, **{t: 1.0}))[0]) for t in TERMS]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="+")
    parser.add_argument("--quality", default="glue")
    parser.add_argument("--printers", type=int, default=8)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    settings = resolve_settings(SettingsRequest(MODEL, args.quality), find_resources())
    cost = CostModel.from_recipe(recipe(settings, prelude_s=0.0))
    room = part_room(PROFILES[MODEL], settings.brim_width_mm)
    printers = [PrinterRoom(str(i), tuple(b.size_mm for b in room)) for i in range(args.printers)]
    engine = find_engine()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(args.workers) as pool:
        work = []
        for item in args.models:
            path, side = item.rsplit(":", 1)
            model = load_model(Path(path), longest_side_mm=float(side))
            folder = Path(scratch) / Path(path).stem
            result = write(decompose(model, printers, Options(), cost), folder)
            for part in result.parts:
                out = folder / f"{part.id}.gcode"
                request = PlateRequest(folder / part.file, settings, out, engine, ANYWHERE, cache=args.cache)
                work.append((Path(path).stem, part, pool.submit(slice_plate, request)))
        for name, part, sliced in work:
            try:
                sliced_s = sliced.result().print_time_s
            except SlicingError as error:
                print(f"{name} {part.id}: {error}", file=sys.stderr)
                continue
            row: dict[str, Any] = {"model": name, "part": part.id, "up": part.rotation[2].tolist()}
            row |= {"estimated_s": part.estimated_s, "sliced_s": sliced_s}
            row |= {"error": part.estimated_s / sliced_s - 1.0, "features": features(part, cost)}
            rows.append(row)
    matrix = np.array([r["features"] for r in rows])
    times = np.array([r["sliced_s"] for r in rows])
    fitted, _ = nnls(matrix / times[:, None], np.ones(len(rows)))
    after = matrix @ fitted / times - 1.0
    before = np.array([r["error"] for r in rows])
    summary = {
        "schema": 1,
        "quality": args.quality,
        "coefficients": {t: getattr(cost, t) for t in TERMS},
        "fitted": dict(zip(TERMS, fitted.tolist(), strict=True)),
        "mean_error": float(before.mean()),
        "mean_absolute_error": float(np.abs(before).mean()),
        "worst_error": float(before[np.abs(before).argmax()]),
        "mean_absolute_error_fitted": float(np.abs(after).mean()),
        "parts": rows,
    }
    if args.json:
        print(json.dumps(summary, indent=1))
        return 0
    for row, fit in zip(rows, after, strict=True):
        figures = f"{row['estimated_s']:8.0f} s  {row['sliced_s']:8.0f} s  {row['error']:+7.1%}  {fit:+7.1%}"
        print(f"{row['model']:24} {row['part']} {figures}")
    for term, value in zip(TERMS, fitted, strict=True):
        print(f"{term:16} {getattr(cost, term):10.5f}  fitted {value:10.5f}")
    print(f"mean absolute error {np.abs(before).mean():.1%}, mean {before.mean():+.1%}")
    print(f"with the fitted coefficients {np.abs(after).mean():.1%}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
