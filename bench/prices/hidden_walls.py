"""Time that faster and single walls on hidden sides save on the parts of a decomposition.

Usage: python -m bench.prices.hidden_walls FOLDER [--parts 5] [--quality glue] [--cache DIR]

FOLDER was written by `farm decompose` or `bench.decompose`. Each part is sliced with all walls like those of
a visible side, with faster walls on its hidden sides, and with one faster wall. Times are CuraEngine's,
except those of the changed walls, which are computed again. The prices are those of the decomposition, for
one faster wall.
The last column is the length at each end of a side that saves nothing: `SIDE_END_MM` of the cost model.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh

from bench.prices.parts import PRINTER_MODEL, make_print_time_settings
from decompose.print_time import CostModel, PartMesh
from decompose.print_time.hidden_faces import sum_side_ends_mm
from drivers.printers import PROFILES, SLICING_PROFILES, list_usable_volumes
from farm.model import PartPrintOptions
from farm.planning.part_records import SliceTask
from farm.planning.parts.slice_part import slice_part
from farm.planning.printer_settings import build_slicing_printer
from slicing.settings import SettingsRequest, find_engine, find_resources, resolve_settings

NO_OVERRIDES: Mapping[str, Any] = MappingProxyType({})
ON_PLANE_MM = 0.001  # maximum distance of a vertex from the plane of its side
KEPT_WALLS = {"wall_line_count": 2}  # as in the quality, but all walls are printed


def slice_with_sides(
    part: dict[str, Any],
    sides: list[list[float]],
    out: Path,
    args: argparse.Namespace,
    overrides: Mapping[str, Any] = NO_OVERRIDES,
) -> float:
    """Slice a part with the given hidden sides and settings; return its time in seconds."""
    request = SettingsRequest(
        build_slicing_printer(SLICING_PROFILES[PRINTER_MODEL]), args.quality, overrides=overrides
    )
    settings = resolve_settings(request, find_resources())
    names = set(PartPrintOptions.model_fields) & set(part)
    options = PartPrintOptions.model_validate({name: part[name] for name in names} | {"hidden_sides": sides})
    volumes = list_usable_volumes(PROFILES[PRINTER_MODEL], settings.brim_width_mm)
    stl = args.folder / part["file"]
    task = SliceTask(
        part["id"], stl, request, find_resources(), settings, volumes, find_engine(), out, args.cache, options
    )
    return slice_part(task).sliced_s


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--parts", type=int, default=5)
    parser.add_argument("--quality", default="glue")
    parser.add_argument("--cache", type=Path)
    args = parser.parse_args()
    parts = json.loads((args.folder / "decomposition.json").read_text(encoding="utf-8"))["parts"]
    chosen_parts = parts[:: max(1, len(parts) // args.parts)][: args.parts]
    sums_s = np.zeros(3)
    with tempfile.TemporaryDirectory() as folder:
        for part in chosen_parts:
            out = Path(folder) / "part.gcode"
            sides = part["hidden_sides"]
            times_s = np.array(
                [
                    slice_with_sides(part, [], out, args),
                    slice_with_sides(part, sides, out, args, KEPT_WALLS),
                    slice_with_sides(part, sides, out, args),
                ]
            )
            sums_s += times_s
            error = part["estimated_s"] / times_s[-1] - 1.0
            lost_mm = measure_lost_mm(part, args.folder, times_s[0] - times_s[-1])
            print(
                f"{part['id']}  {len(sides)} hidden sides  {format_times(times_s)}  price {error:+.1%}  "
                f"ends {lost_mm:.1f} mm"
            )
    print(f"total {format_times(sums_s)}")


def measure_lost_mm(part: dict[str, Any], folder: Path, saved_s: float) -> float:
    """Measure the length at the ends of hidden sides that saves nothing; nan without ends."""
    mesh = trimesh.load_mesh(folder / part["file"])
    is_hidden = np.zeros(len(mesh.faces), np.bool_)
    for x, y, offset_mm in part["hidden_sides"]:
        is_on_plane = np.abs(mesh.vertices[:, :2] @ (x, y) - offset_mm) < ON_PLANE_MM
        is_hidden |= is_on_plane[mesh.faces].all(axis=1)
    part_mesh = PartMesh(mesh.vertices.view(np.ndarray), mesh.faces.view(np.ndarray), is_hidden)
    ends_mm = sum_side_ends_mm(part_mesh, np.array((0.0, 0.0, 1.0)))
    cost = CostModel.from_settings(make_print_time_settings("glue"))
    saved_mm2 = saved_s / (cost.hidden_side_share * cost.lateral_s_per_mm2)
    return (float(mesh.area_faces[is_hidden].sum()) - saved_mm2) / ends_mm if ends_mm else math.nan


def format_times(times_s: npt.NDArray[np.float64]) -> str:
    """Format the times without hidden sides, with faster walls, and with single walls."""
    plain_s, fast_s, single_s = times_s
    return (
        f"{plain_s:6.0f} s  fast {fast_s:6.0f} s {fast_s / plain_s - 1.0:+.1%}  "
        f"single {single_s:6.0f} s {single_s / plain_s - 1.0:+.1%}"
    )


if __name__ == "__main__":
    main()
