"""Time of the checks of a slice compared with CuraEngine's, and their findings on valid models.

Usage: python -m bench.printing.slice_check [STL ...] [--quality glue] [--nozzle 0.4] [--set KEY=VALUE]
       [--json]

Without files, generated models are used. The CPU seconds of this process are for reading the G-code, the
rules, the outlines and the timeline; those of CuraEngine are its own user and system time.
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from bench.prices.parts import ENDLESS_BED
from drivers.printers import SLICING_PROFILES
from farm.planning.printer_settings import build_slicing_printer
from slicing.checks.outline import UnprintedWall
from slicing.errors import SliceRejected
from slicing.plate import PlateRequest, slice_plate
from slicing.settings import EngineSettings, SettingsRequest, find_engine, find_resources, resolve_settings

MOVE = trimesh.transformations.translation_matrix


def make_models() -> dict[str, trimesh.Trimesh]:
    """Make models that are difficult to slice: slopes, flats, holes, islands, hollows, thin walls."""
    create, difference = trimesh.creation, trimesh.boolean.difference
    pins = [create.cylinder(4, 25, transform=MOVE((x, 0, 13))) for x in (-18, -6, 6, 18)]
    fins = [create.box((0.3, 30, 12), MOVE((x, 0, 5))) for x in (-10, 0, 10)]
    ball = create.icosphere(4, 20)
    return {
        "cube": create.box((40, 40, 40)),
        "ball": ball,
        "hollow ball": difference([ball, create.icosphere(4, 16)]),
        "torus": create.torus(30, 8),
        "cone": create.cone(15, 30),
        "islands": trimesh.boolean.union([create.box((50, 20, 3)), *pins]),
        "holes": difference(
            [create.box((60, 30, 8))]
            + [create.cylinder(0.5 + i / 4, 20, transform=MOVE((7 * i - 24, 0, 0))) for i in range(8)]
        ),
        "on its edge": create.box((30, 30, 30), trimesh.transformations.rotation_matrix(0.8, (1, 0, 0))),
        "shell": create.annulus(20, 20.7, 30),
        "fins too thin": trimesh.boolean.union([create.box((40, 40, 5)), *fins]),
    }


@dataclass
class CpuTimes:
    """CPU seconds of this process and of its ended children."""

    own_s: float = 0.0
    engine_s: float = 0.0

    @classmethod
    def read(cls) -> CpuTimes:
        """Read the CPU seconds until now."""
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return cls(time.process_time(), children.ru_utime + children.ru_stime)


def check_model(name: str, mesh: trimesh.Trimesh, settings: EngineSettings, folder: Path) -> dict[str, Any]:
    """Slice and check a model in the middle of the bed."""
    mesh = mesh.copy()
    low_mm, high_mm = mesh.bounds
    mesh.apply_translation((-(low_mm[0] + high_mm[0]) / 2, -(low_mm[1] + high_mm[1]) / 2, -low_mm[2]))
    stl = folder / "model.stl"
    mesh.export(stl)
    request = PlateRequest(stl, settings, folder / "model.gcode", find_engine(), ENDLESS_BED)
    start = CpuTimes.read()
    refusal: str | None = None
    unprinted_walls: tuple[UnprintedWall, ...] = ()
    lines = 0
    try:
        result = slice_plate(request)
        unprinted_walls = result.unprinted_walls
        lines = result.gcode.read_bytes().count(b"\n")
    except SliceRejected as error:
        refusal = str(error)
    end = CpuTimes.read()
    check_s, engine_s = end.own_s - start.own_s, end.engine_s - start.engine_s
    return {
        "model": name,
        "triangles": len(mesh.faces),
        "lines": lines,
        "engine_cpu_s": round(engine_s, 3),
        "check_cpu_s": round(check_s, 3),
        "share": round(check_s / engine_s, 3),
        "refused": refusal,
        "unprinted": [str(wall) for wall in unprinted_walls],
    }


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stl", nargs="*", type=Path)
    parser.add_argument("--quality", default="glue")
    parser.add_argument("--nozzle", type=float, default=0.4, help="mm")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE of a Cura setting")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    models = {str(path): trimesh.load_mesh(path) for path in options.stl} or make_models()
    overrides = dict(pair.split("=", 1) for pair in options.set)
    request = SettingsRequest(
        build_slicing_printer(SLICING_PROFILES["ultimaker2_plus"]),
        options.quality,
        "generic_pla",
        options.nozzle,
        overrides,
    )
    settings = resolve_settings(request, find_resources())
    with tempfile.TemporaryDirectory() as name:
        check_model("first", trimesh.creation.box((5, 5, 5)), settings, Path(name))  # imports and caches
        rows = [check_model(model, mesh, settings, Path(name)) for model, mesh in models.items()]
    share = sum(row["check_cpu_s"] for row in rows) / sum(row["engine_cpu_s"] for row in rows)
    if options.json:
        print(json.dumps({"schema": 1, "share": round(share, 3), "models": rows}, indent=1))
        return
    for row in rows:
        finding = row["refused"] or "; ".join(row["unprinted"]) or "good"
        print(
            f"{row['model']:<40} {row['lines']:>8} lines  engine {row['engine_cpu_s']:7.2f} s  "
            f"checks {row['check_cpu_s']:6.2f} s  {row['share']:5.0%}  {finding}"
        )
    print(f"checks / engine: {share:.1%}; most: {np.max([row['share'] for row in rows]):.0%}")


if __name__ == "__main__":
    main()
