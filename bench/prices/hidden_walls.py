"""Time that faster walls on hidden sides save on the parts of a decomposition, sliced with and without them.

Usage: python -m bench.prices.hidden_walls FOLDER [--parts 5] [--quality glue] [--cache DIR]

FOLDER was written by `farm decompose` or `bench.decompose`. Times are CuraEngine's, with the times of the
faster walls recomputed; the prices are those of the decomposition, which include the faster walls.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from bench.prices.parts import PRINTER
from drivers.printers import BEDS, PROFILES, list_usable_volumes
from farm.model import PartPrintOptions
from farm.planning.part_records import SliceTask
from farm.planning.parts.slice_part import slice_part
from farm.planning.printer_settings import build_slicing_printer
from slicing.settings import SettingsRequest, find_engine, find_resources, resolve_settings


def slice_with_sides(
    part: dict[str, Any], sides: list[list[float]], out: Path, args: argparse.Namespace
) -> float:
    """Slice a part with the given hidden sides; return its time in seconds."""
    request = SettingsRequest(build_slicing_printer(BEDS[PRINTER]), args.quality)
    settings = resolve_settings(request, find_resources())
    names = ("brim_width_mm", "layer_0_expansion_mm", "bed_face_hidden", "tops_hidden")
    options = PartPrintOptions.model_validate({name: part[name] for name in names} | {"hidden_sides": sides})
    room = list_usable_volumes(PROFILES[PRINTER], settings.brim_width_mm)
    stl = args.folder / part["file"]
    task = SliceTask(
        part["id"], stl, request, find_resources(), settings, room, find_engine(), out, args.cache, options
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
    sums_s = [0.0, 0.0]
    with tempfile.TemporaryDirectory() as folder:
        for part in chosen_parts:
            out = Path(folder) / "part.gcode"
            plain_s = slice_with_sides(part, [], out, args)
            fast_s = slice_with_sides(part, part["hidden_sides"], out, args)
            sums_s = [sums_s[0] + plain_s, sums_s[1] + fast_s]
            error = part["estimated_s"] / fast_s - 1.0
            print(
                f"{part['id']}  {len(part['hidden_sides'])} hidden sides  {plain_s:6.0f} to {fast_s:6.0f} s  "
                f"{fast_s / plain_s - 1.0:+.1%}  price {error:+.1%}"
            )
    print(f"total {sums_s[0]:.0f} to {sums_s[1]:.0f} s, {sums_s[1] / sums_s[0] - 1.0:+.1%}")


if __name__ == "__main__":
    main()
