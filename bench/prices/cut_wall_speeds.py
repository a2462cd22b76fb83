"""Seconds that faster walls on upright cut faces would save on the parts of a decomposition.

Usage: python -m bench.prices.cut_wall_speeds FOLDER [--parts 5] [--quality glue] [--speeds 50,60]

FOLDER was written by `farm decompose` or `bench.decompose`, for a model not turned about z. Each slice's
moves are planned twice, with acceleration and jerk (`bench.prices.move_times`): as they are, and with the
walls along cut faces at least as fast as the given speed. Layers that CuraEngine slows down keep their
speeds.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from bench.prices.move_times import KINDS, plan_moves_s, read_moves
from bench.prices.parts import PRINTER
from decompose.arrays import Bools, Floats
from drivers.printers import BEDS
from farm.planning.printer_settings import build_slicing_printer
from slicing.engine import EngineLimits, run_engine
from slicing.settings import (
    EngineSettings,
    PartSettings,
    SettingsRequest,
    find_engine,
    find_resources,
    resolve_settings,
)

TOLERANCE_MM = 0.05
WALLS = tuple(KINDS.index(name) for name in ("WALL-OUTER", "WALL-INNER"))


@dataclass(frozen=True, slots=True)
class Plane:
    """Upright cut plane of a part on the bed: an outward unit normal (2,), and its offset along it in mm."""

    normal: Floats
    plane_offset_mm: float


def find_cut_planes(part: dict[str, Any], model_mm: Floats) -> list[Plane]:
    """Find the sides of a part's box in the model that are upright on the bed and inside the model's box.

    model_mm: (2, 3) box of the model.
    """
    to_model = np.array(part["to_model"])
    planes = []
    for end, side_mm in enumerate((part["min_mm"], part["max_mm"])):
        for axis in range(3):
            normal = (2 * end - 1) * to_model[axis, :3]  # of the model's axis, on the bed
            if abs(side_mm[axis] - model_mm[end, axis]) > TOLERANCE_MM and abs(normal[2]) < 1e-6:
                plane_offset_mm = (2 * end - 1) * (side_mm[axis] - to_model[axis, 3])
                planes.append(Plane(normal[:2], float(plane_offset_mm)))
    return planes


def slice_gcode(part: dict[str, Any], stl: Path, settings: EngineSettings) -> str:
    run = run_engine(find_engine(), stl, settings.global_, settings.extruder, EngineLimits(5000, 900.0))
    return run.gcode.decode()


def find_cut_walls(
    moves: Floats, kinds: np.ndarray, planes: list[Plane], offset_mm: Floats, line_mm: float
) -> Bools:
    """Find the moves (n,) of walls along cut planes: half a line inside for the outer one, or 1.5 lines."""
    ends_mm = np.cumsum(moves[:, :2], axis=0)
    starts_mm, ends_mm = ends_mm - moves[:, :2] - offset_mm, ends_mm - offset_mm
    is_along_cut = np.zeros(len(moves), np.bool_)
    for plane in planes:
        depths_mm = np.stack(
            [plane.plane_offset_mm - points @ plane.normal for points in (starts_mm, ends_mm)]
        )
        for wall, kind in enumerate(WALLS):
            is_near = np.abs(depths_mm - (wall + 0.5) * line_mm) < TOLERANCE_MM
            is_along_cut |= (kinds == kind) & is_near.all(axis=0)
    return is_along_cut


def measure(part: dict[str, Any], args: argparse.Namespace, model_mm: Floats) -> list[float]:
    """Return seconds: of the slice, of its walls on cut planes, and saved at each of the speeds."""
    request = SettingsRequest(build_slicing_printer(BEDS[PRINTER]), args.quality)
    part_settings = PartSettings(
        brim_width_mm=part["brim_width_mm"],
        bed_face_hidden=part["bed_face_hidden"],
        tops_hidden=part["tops_hidden"],
    )
    settings = resolve_settings(request, find_resources(), part_settings)
    stl = args.folder / part["file"]
    moves, kinds, stops = read_moves(slice_gcode(part, stl, settings))
    is_outer = kinds == WALLS[0]
    points_mm = np.cumsum(moves[:, :2], axis=0)
    centre_mm = (points_mm[is_outer].min(axis=0) + points_mm[is_outer].max(axis=0)) / 2.0
    offset_mm = centre_mm - trimesh.load_mesh(stl).bounds[:, :2].mean(axis=0)
    planes = find_cut_planes(part, model_mm)
    is_along_cut = find_cut_walls(moves, kinds, planes, offset_mm, settings.line_width_mm)
    full_speeds_mm_s = {WALLS[0]: settings.speed_wall_0_mm_s, WALLS[1]: settings.speed_wall_x_mm_s}
    for kind, speed_mm_s in full_speeds_mm_s.items():
        is_along_cut &= (kinds != kind) | (moves[:, 4] > speed_mm_s - 0.1)
    move_times_s = plan_moves_s(moves, stops)
    saved_s = []
    for speed_mm_s in args.speeds:
        faster_moves = moves.copy()
        faster_moves[is_along_cut, 4] = np.maximum(faster_moves[is_along_cut, 4], speed_mm_s)
        saved_s.append(float(move_times_s.sum() - plan_moves_s(faster_moves, stops).sum()))
    return [float(move_times_s.sum()), float(move_times_s[is_along_cut].sum()), *saved_s]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--parts", type=int, default=5)
    parser.add_argument("--quality", default="glue")
    parser.add_argument("--speeds", default="50,60")
    args = parser.parse_args()
    args.speeds = [float(speed) for speed in args.speeds.split(",")]
    report = json.loads((args.folder / "decomposition.json").read_text(encoding="utf-8"))
    parts = report["parts"]
    model_mm = np.array(
        [
            np.min([part["min_mm"] for part in parts], axis=0),
            np.max([part["max_mm"] for part in parts], axis=0),
        ]
    )
    sampled_parts = parts[:: max(1, len(parts) // args.parts)][: args.parts]
    total_s = np.zeros(2 + len(args.speeds))
    for part in sampled_parts:
        total_s += measure(part, args, model_mm)
    print(f"{total_s[0]:.0f} s, of which walls on upright cut faces {total_s[1] / total_s[0]:.1%}")
    for speed_mm_s, saved_s in zip(args.speeds, total_s[2:], strict=True):
        print(f"at {speed_mm_s:g} mm/s: {-saved_s / total_s[0]:+.1%}")


if __name__ == "__main__":
    main()
