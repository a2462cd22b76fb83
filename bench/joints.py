"""Pins and marks on the joints of decomposed models: share of the glued area near a pin, and cost.

Models are cut with and without pins and marks. The parts with them are drilled, and all rules are checked.
With --slices, the first of these parts are sliced without and with their holes and marks. Marks are read back
from the outer walls, and the material of supports is compared.

Usage: python -m bench.joints MODEL|SHAPE... [--printers 8,20] [--longest-side 330] [--slices 0]
    [--engine best] [--budget 1800] [--resume FILE] [--json]

A SHAPE is a name of `bench.models.shapes`. No case is started after --budget seconds. --resume stores a line
of JSON for each finished case in FILE, and skips the cases that are already in it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic, process_time
from typing import Any

import numpy as np
import shapely

from bench.connectors.joint_slices import slice_part
from bench.models.shapes import SHAPES
from bench.prices.parts import make_print_time_settings
from decompose.connectors import find_pairs
from decompose.decompose import decompose_model
from decompose.geometry import Model, load_model
from decompose.options import FILAMENT_MM, ConnectorOptions, Engine, Options
from decompose.print_time import CostModel
from decompose.printers import TargetPrinter
from decompose.rebalance import SlicedCuts, rebalance_planes
from decompose.results import Decomposition, connect_parts

USABLE_VOLUMES_MM = ((206.9, 190.9, 205.0), (173.9, 197.9, 205.0), (164.9, 206.9, 205.0))
ALL_CONNECTORS = ConnectorOptions(FILAMENT_MM, marks=True)
MAX_PIN_DISTANCE_MM = 60.0  # maximum distance of glue that counts as near a pin
MIN_TWO_PINS_MM2 = 100.0  # glued area above which a step should have two pins


@dataclass(frozen=True, slots=True)
class Row:
    """Figures of one model; areas in mm2.

    Attributes
    ----------
    steps_without_pair
        Number of steps with room for two pins whose parts have no pair of pins.
    glue_near_share
        Share of the glued area that is near a pin.
    faces
        Number of glued faces.
    lettered_share
        Share of the glued faces that have a mark with letters or digits.
    failures
        Number of connectors omitted because they broke a rule.
    compute_s
        CPU seconds of drilling.
    added_time_share
        Increase of the makespan by connectors, as a share, by price. The planes of the result with connectors
        were moved once more by the prices of its drilled parts.
    """

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
    added_time_share: float
    sliced: SlicedFigures | None = None


@dataclass(frozen=True, slots=True)
class SlicedFigures:
    """Figures of the slices of some parts: print times without and with holes and marks, and legible marks.

    `priced_added_s` is the time for holes and marks in the prices of these parts.
    """

    parts: int
    bare_s: float
    drilled_s: float
    priced_added_s: float
    support_filament_mm: float
    support_filament_added_mm: float
    marks: int
    illegible: tuple[str, ...]


def load_case(name: str, longest_side_mm: float) -> Model:
    """Load a model file, or build one of the bench shapes in its own size."""
    if name in SHAPES:
        return Model(SHAPES[name](), (), 1.0)
    return load_model(Path(name), longest_side_mm=longest_side_mm)


def cut_model(
    model: Model, printers: int, connectors: ConnectorOptions, engine: Engine = Engine.GUILLOTINE
) -> Decomposition:
    """Cut a model for a number of printers, and compute the order of its assembly."""
    target_printers = [TargetPrinter(str(number), USABLE_VOLUMES_MM) for number in range(printers)]
    options = Options(engine, prove=False, connectors=connectors)
    return decompose_model(model, target_printers, options, make_cost()).with_assembly()


def make_cost() -> CostModel:
    """Make the cost model of the quality `glue`."""
    return CostModel.from_settings(make_print_time_settings("glue"))


def find_longest_price_s(result: Decomposition) -> float:
    """Find the price of the longest part, in seconds."""
    return max(part.price_s for part in result.parts)


def level_planes(model: Model, drilled_result: Decomposition) -> Decomposition:
    """Move the planes of a drilled result once by the prices of its parts, as a job does by their slices."""
    prices_s = [part.price_s for part in drilled_result.parts]
    levelled_result = rebalance_planes(
        model, [SlicedCuts(drilled_result, prices_s, max(prices_s))], make_cost()
    )
    if levelled_result is None:
        return drilled_result
    return min((drilled_result, connect_parts(levelled_result.with_assembly())), key=find_longest_price_s)


def measure(name: str, printers: int, longest_side_mm: float, slices: int, engine: Engine) -> Row:
    """Cut a model, drill its parts, and measure them."""
    model = load_case(name, longest_side_mm)
    bare_result = cut_model(model, printers, ConnectorOptions(), engine)
    cut_result = cut_model(model, printers, ALL_CONNECTORS, engine)
    start_s = process_time()
    drilled_result = connect_parts(cut_result)
    compute_s = process_time() - start_s
    levelled_result = level_planes(model, drilled_result)
    connectors, steps = drilled_result.connectors, drilled_result.assembly.steps
    pairs = find_pairs(connectors.pins)
    row = Row(
        model=Path(name).name,
        parts=len(drilled_result.parts),
        steps=len(steps),
        pins=len(connectors.pins),
        steps_without_pair=sum(
            step.glue_mm2 > MIN_TWO_PINS_MM2 and number not in pairs for number, step in enumerate(steps)
        ),
        glue_near_share=measure_glue_near_pins(drilled_result),
        marks=len(connectors.marks),
        faces=2 * len(drilled_result.joints),
        lettered_share=sum(bool(m.text.strip(".")) for m in connectors.marks)
        / (2 * len(drilled_result.joints) or 1),
        failures=len(connectors.failures),
        compute_s=compute_s,
        added_time_share=find_longest_price_s(levelled_result) / find_longest_price_s(bare_result) - 1.0,
    )
    return replace(row, sliced=slice_parts(drilled_result, slices)) if slices else row


def measure_glue_near_pins(result: Decomposition) -> float:
    """Measure the share of the glued area that is near a pin of its step."""
    near_mm2 = total_mm2 = 0.0
    for number, step in enumerate(result.assembly.steps):
        pins = [pin.position_mm for pin in result.connectors.pins if pin.step == number]
        for face in (face for joint in step.joints for face in result.joints[joint].faces):
            discs = [
                shapely.Point(face.axes @ position_mm).buffer(
                    np.sqrt(MAX_PIN_DISTANCE_MM**2 - distance_mm**2)
                )
                for position_mm in pins
                if (distance_mm := abs(float(face.normal @ position_mm) - face.offset_mm))
                < MAX_PIN_DISTANCE_MM
            ]
            near_mm2 += face.outline.intersection(shapely.union_all(discs)).area
            total_mm2 += face.area_mm2
    return near_mm2 / total_mm2 if total_mm2 else 1.0


def slice_parts(drilled_result: Decomposition, count: int) -> SlicedFigures:
    """Slice the first parts of a drilled result without and with pins and marks, and compare the slices."""
    pairs = []
    illegible: list[str] = []
    marks = 0
    for number, part in enumerate(drilled_result.parts[:count]):
        with tempfile.TemporaryDirectory() as folder:
            bare_slice = slice_part(part, part.solid, Path(folder))
            drilled_slice = slice_part(part, part.printed_solid, Path(folder))
        pairs.append((bare_slice, drilled_slice))
        part_marks = [mark for mark in drilled_result.connectors.marks if mark.part == number]
        marks += len(part_marks)
        illegible += [f"{part.id}: {mark.text}" for mark in part_marks if not drilled_slice.is_legible(mark)]
    return SlicedFigures(
        parts=len(pairs),
        bare_s=sum(bare_slice.sliced_s for bare_slice, _ in pairs),
        drilled_s=sum(drilled_slice.sliced_s for _, drilled_slice in pairs),
        priced_added_s=sum(p.connectors_s for p in drilled_result.parts[:count]),
        support_filament_mm=sum(bare_slice.support_filament_mm for bare_slice, _ in pairs),
        support_filament_added_mm=sum(
            drilled_slice.support_filament_mm - bare_slice.support_filament_mm
            for bare_slice, drilled_slice in pairs
        ),
        marks=marks,
        illegible=tuple(illegible),
    )


def read_finished_cases(path: Path | None) -> dict[tuple[str, int], dict[str, Any]]:
    """Read the finished cases from the file of an earlier run, by model and number of printers."""
    if path is None or not path.exists():
        return {}
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return {(line["model"], line["printers"]): line for line in rows}


def main() -> None:
    """Parse the command line, measure, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("models", nargs="+")
    parser.add_argument("--printers", default="8")
    parser.add_argument("--longest-side", type=float, default=330.0)
    parser.add_argument("--slices", type=int, default=0)
    parser.add_argument("--engine", type=Engine, default=Engine.BEST)
    parser.add_argument("--budget", type=float, default=1800.0)
    parser.add_argument("--resume", type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows_by_case, rows = read_finished_cases(options.resume), []
    deadline_s = monotonic() + options.budget
    for name in options.models:
        for printers in map(int, options.printers.split(",")):
            key = (Path(name).name, printers)
            if key not in rows_by_case:
                if monotonic() > deadline_s:
                    continue
                row = measure(name, printers, options.longest_side, options.slices, options.engine)
                rows_by_case[key] = {"printers": printers, **asdict(row)}
                if options.resume is not None:
                    with options.resume.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(rows_by_case[key]) + "\n")
            rows.append(rows_by_case[key])
            if not options.json:
                print("  ".join(f"{field} {value}" for field, value in rows[-1].items()), flush=True)
    if options.json:
        print(json.dumps({"schema": 3, "models": rows}))


if __name__ == "__main__":
    main()
