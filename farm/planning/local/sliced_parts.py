"""Slicing of parts, and moves of the cuts to even out their sliced times (`farm decompose --slice`)."""

from __future__ import annotations

import json
import os
import shutil
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from decompose.errors import DecomposeError
from decompose.export import write_decomposition
from decompose.files.names import REPORT
from decompose.geometry import Model
from decompose.print_time import CostModel
from decompose.rebalance import MAX_ROUNDS, SlicedCuts, rebalance_planes
from decompose.results import Decomposition
from drivers.printers import UsableVolume
from farm.planning.error_translation import translate_errors
from farm.planning.part_records import DecomposedPart, SliceTask
from farm.planning.parts.slice_part import slice_part
from slicing.plate import PlateResult
from slicing.settings import Resources, SettingsRequest, find_engine, resolve_settings


@dataclass(frozen=True, slots=True)
class SlicedParts:
    """Decomposition whose files are in a folder, with the slice of each of its parts."""

    decomposition: Decomposition
    slices: tuple[PlateResult, ...]

    @property
    def times_s(self) -> tuple[float, ...]:
        """Sliced time of each part."""
        return tuple(result.sliced_s for result in self.slices)

    @property
    def makespan_s(self) -> float:
        """Longest sliced time of a part."""
        return max(self.times_s)

    @property
    def cuts(self) -> SlicedCuts:
        """Cuts and sliced times, without the solids of the parts."""
        return SlicedCuts(self.decomposition.without_parts(), self.times_s, self.makespan_s)


@dataclass(frozen=True, slots=True)
class PartSlicer:
    """Slicer of parts for identical printers.

    Attributes
    ----------
    request
        Printer, quality and brim.
    usable_volumes
        Boxes above the bed that a part may fill.
    cache
        Folder of earlier slices; None for no cache.
    """

    request: SettingsRequest
    resources: Resources
    usable_volumes: tuple[UsableVolume, ...]
    cache: Path | None

    def slice_parts(self, decomposition: Decomposition, folder: Path) -> SlicedParts:
        """Write a decomposition into a folder, and slice its parts in parallel.

        Raises
        ------
        FarmError
            With code `engine` if CuraEngine is missing or fails, `slice` if a check rejects a slice,
            `settings` if the quality is unknown.
        """
        with translate_errors():
            stored_decomposition = write_decomposition(decomposition, folder)
            settings, engine = resolve_settings(self.request, self.resources), find_engine()
        parts = [DecomposedPart.from_part(part, folder) for part in stored_decomposition.parts]
        tasks = [
            SliceTask(
                part_name=part.id,
                stl=part.stl,
                request=self.request,
                resources=self.resources,
                settings=settings,
                usable_volumes=self.usable_volumes,
                engine=engine,
                out=folder / f"{part.id}.gcode",
                cache=self.cache,
                print_options=part.print_options,
            )
            for part in parts
        ]
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            return SlicedParts(stored_decomposition, tuple(threads.map(slice_part, tasks)))


def rebalance_by_slices(
    model: Model,
    decomposition: Decomposition,
    slicer: PartSlicer,
    cost: CostModel,
    executor: Executor,
    folder: Path,
) -> SlicedParts:
    """Slice all parts, and move the cuts while this may shorten the longest sliced time.

    Parameters
    ----------
    model, cost, executor
        Model, cost model and executor of the decomposition.
    folder
        Folder for the files of each round.

    Raises
    ------
    FarmError
        If a part cannot be sliced (`PartSlicer.slice_parts`).
    """
    rounds = [slicer.slice_parts(decomposition, folder / "0")]
    for number in range(1, MAX_ROUNDS + 1):
        try:
            moved_decomposition = rebalance_planes(model, [r.cuts for r in rounds], cost, executor)
        except DecomposeError:  # the parts are valid without moved cuts
            break
        if moved_decomposition is None or moved_decomposition.faults:
            break
        rounds.append(slicer.slice_parts(moved_decomposition, folder / str(number)))
    return min(rounds, key=lambda sliced_parts: sliced_parts.makespan_s)


def write_sliced_parts(sliced_parts: SlicedParts, out: Path) -> dict[str, Any]:
    """Write parts, G-code, report and picture into a folder; return the report with the slices' figures.

    Parameters
    ----------
    sliced_parts
        Parts whose G-code lies in another folder.
    out
        Folder to write into.
    """
    stored_decomposition = write_decomposition(sliced_parts.decomposition, out)
    report = stored_decomposition.as_dict()
    for part, result in zip(report["parts"], sliced_parts.slices, strict=True):
        part["gcode"] = f"{part['id']}.gcode"
        part["sliced_s"] = result.sliced_s
        part["grams"], part["filament_mm"] = result.grams, result.filament_mm
        shutil.copyfile(result.gcode, out / part["gcode"])
    report["sliced_makespan_s"] = sliced_parts.makespan_s
    (out / REPORT).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    return report
