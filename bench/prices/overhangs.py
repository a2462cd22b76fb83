"""Overhang angle from which CuraEngine supports a face, compared with the cost model.

Usage: python -m bench.prices.overhangs [--json]

A block with one side that leans outwards is sliced at angles that approach the first supported one, along an
axis of the bed and diagonally, where outlines are rounded differently.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from bench.prices.parts import ENDLESS_BED, PRINTER_MODEL, compute_extrusion_times_s
from drivers.printers import SLICING_PROFILES
from farm.planning.parts.pricing import build_print_time_settings
from farm.planning.printer_settings import build_slicing_printer
from slicing.plate import PlateRequest, slice_plate
from slicing.settings import EngineSettings, SettingsRequest, find_engine, find_resources, resolve_settings

CASES = ((0.25, 45.0), (0.1, 45.0), (0.25, 60.0))  # layer height in mm, support angle in degrees
YAWS_DEG = (0.0, 33.0)
HEIGHT_MM, SIDE_MM = 20.0, 30.0
SEARCH_RANGE_DEG, HALVING_COUNT = 3.0, 6  # start of the search, and number of its halvings


def make_leaning_block(angle_deg: float, yaw_deg: float) -> trimesh.Trimesh:
    """Make a block with one side that leans outwards from the vertical, turned on the bed."""
    overhang_mm = HEIGHT_MM * math.tan(math.radians(angle_deg))
    outline = [(0, 0), (SIDE_MM, 0), (SIDE_MM + overhang_mm, HEIGHT_MM), (0, HEIGHT_MM)]
    block = trimesh.convex.convex_hull(np.array([(x, y, z) for x, z in outline for y in (0.0, SIDE_MM)]))
    block.apply_transform(trimesh.transformations.rotation_matrix(math.radians(yaw_deg), [0, 0, 1]))
    block.apply_translation([*-block.bounds.mean(axis=0)[:2], -block.bounds[0, 2]])
    return block


def is_supported(block: trimesh.Trimesh, settings: EngineSettings, folder: Path) -> bool:
    """Check whether CuraEngine prints any support."""
    stl, path = folder / "block.stl", folder / "block.gcode"
    block.export(stl)
    slice_plate(
        PlateRequest(stl=stl, settings=settings, output_path=path, engine=find_engine(), bed=ENDLESS_BED)
    )
    return compute_extrusion_times_s(path.read_text(encoding="utf-8"))["support_s"] > 0.0


def find_angles(layer_mm: float, angle_deg: float, yaw_deg: float, folder: Path) -> dict[str, Any]:
    """Find the largest angle without support and the smallest with support."""
    overrides = {"layer_height": layer_mm, "support_angle": angle_deg}
    settings = resolve_settings(
        SettingsRequest(build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL]), "paper", overrides=overrides),
        find_resources(),
    )
    bare_deg, supported_deg = angle_deg - SEARCH_RANGE_DEG, angle_deg
    for _ in range(HALVING_COUNT):
        middle_deg = (bare_deg + supported_deg) / 2.0
        if is_supported(make_leaning_block(middle_deg, yaw_deg), settings, folder):
            supported_deg = middle_deg
        else:
            bare_deg = middle_deg
    return {
        "layer_height_mm": layer_mm,
        "support_angle_deg": angle_deg,
        "yaw_deg": yaw_deg,
        "bare_deg": bare_deg,
        "supported_deg": supported_deg,
        "cost_deg": build_print_time_settings(settings, overhead_s=0.0).effective_support_angle_deg,
    }


def main() -> int:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [find_angles(*case, yaw_deg, Path(folder)) for case in CASES for yaw_deg in YAWS_DEG]
    if args.json:
        print(json.dumps({"schema": 1, "rows": rows}, indent=1))
        return 0
    for row in rows:
        print(
            f"layer {row['layer_height_mm']} mm, support angle {row['support_angle_deg']:g}, turned by "
            f"{row['yaw_deg']:g}: bare up to {row['bare_deg']:.2f}, supported from "
            f"{row['supported_deg']:.2f} degrees; {row['cost_deg']:.2f} in the cost model"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
