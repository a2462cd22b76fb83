"""Pins and marks on the joints of decomposed models: how much glue they serve, and what they cost.

Models are cut by the engine `guillotine`, then drilled, all rules checked. With --slices, parts of each model
are sliced as they were cut and with their holes and marks.

Usage: python -m bench.joints MODEL... [--printers 8] [--longest-side 330] [--slices 0] [--json]
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import shapely

from decompose.connectors import pairs_of
from decompose.decompose import decompose_model
from decompose.geometry import load_model, write_stl
from decompose.options import FILAMENT_MM, ConnectorOptions, Engine, Options
from decompose.print_time import CostModel, Recipe
from decompose.printers import PrinterRoom
from decompose.results import Decomposition, connect_parts
from farm.planning.local.slice_file import SliceOptions, slice_to_file

ROOM_MM = ((206.9, 190.9, 205.0), (173.9, 197.9, 205.0), (164.9, 206.9, 205.0))
ALL = ConnectorOptions(FILAMENT_MM, marks=True)
NEAR_MM = 60.0
STEP_MM2 = 100.0  # a step of more glue should have two pins
SLICED = SliceOptions("ultimaker2_plus", "glue", "generic_pla", 0.4)


@dataclass(frozen=True, slots=True)
class Row:
    """Figures of one model; areas in mm2, times in seconds of one core, or of printing."""

    model: str
    parts: int
    steps: int
    pins: int
    steps_without_pair: int
    glue_near_share: float
    marks: int
    faces: int
    lettered_share: float
    failures: int
    compute_s: float
    bare_s: float | None = None
    drilled_s: float | None = None


def measure(path: Path, printers: int, longest_side_mm: float, slices: int) -> Row:
    """Cut a model, drill its parts, and measure them."""
    model = load_model(path, longest_side_mm=longest_side_mm)
    rooms = [PrinterRoom(str(number), ROOM_MM) for number in range(printers)]
    options = Options(Engine.GUILLOTINE, prove=False, connectors=ALL)
    cut = decompose_model(model, rooms, options, CostModel.from_recipe(Recipe())).with_assembly()
    began_s = process_time()
    drilled = connect_parts(cut)
    compute_s = process_time() - began_s
    connectors, steps = drilled.connectors, drilled.assembly.steps
    pairs = pairs_of(connectors.pins)
    row = Row(
        model=path.name,
        parts=len(drilled.parts),
        steps=len(steps),
        pins=len(connectors.pins),
        steps_without_pair=sum(
            step.glue_mm2 > STEP_MM2 and number not in pairs for number, step in enumerate(steps)
        ),
        glue_near_share=measure_near_glue(drilled),
        marks=len(connectors.marks),
        faces=2 * len(drilled.joints),
        lettered_share=sum(bool(m.text.strip(".")) for m in connectors.marks)
        / (2 * len(drilled.joints) or 1),
        failures=len(connectors.failures),
        compute_s=compute_s,
    )
    if not slices:
        return row
    return replace(row, bare_s=slice_parts(cut, slices), drilled_s=slice_parts(drilled, slices))


def measure_near_glue(result: Decomposition) -> float:
    """Measure the share of the glued area that is near a pin of its step."""
    near_mm2 = total_mm2 = 0.0
    for number, step in enumerate(result.assembly.steps):
        pins = [pin.at_mm for pin in result.connectors.pins if pin.step == number]
        for face in (face for joint in step.joints for face in result.joints[joint].faces):
            discs = [
                shapely.Point(face.axes @ at).buffer(np.sqrt(NEAR_MM**2 - off_mm**2))
                for at in pins
                if (off_mm := abs(float(face.normal @ at) - face.offset_mm)) < NEAR_MM
            ]
            near_mm2 += face.outline.intersection(shapely.union_all(discs)).area
            total_mm2 += face.area_mm2
    return near_mm2 / total_mm2 if total_mm2 else 1.0


def slice_parts(result: Decomposition, count: int) -> float:
    """Slice the first parts of a result; return the seconds of their prints."""
    total_s = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for part in result.parts[:count]:
            stl = Path(folder, f"{part.id}.stl")
            write_stl(stl, part.stl_triangles())
            total_s += float(slice_to_file(stl, stl.with_suffix(".gcode"), SLICED)["print_time_s"])
    return total_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="+", type=Path)
    parser.add_argument("--printers", type=int, default=8)
    parser.add_argument("--longest-side", type=float, default=330.0)
    parser.add_argument("--slices", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for path in options.models:
        row = measure(path, options.printers, options.longest_side, options.slices)
        rows.append(asdict(row))
        if not options.json:
            print("  ".join(f"{key} {value}" for key, value in rows[-1].items()))
    if options.json:
        print(json.dumps({"schema": 1, "models": rows}))


if __name__ == "__main__":
    main()
