"""Replanning of a waiting plate: its part is sliced for another kind of printer, or cut for several printers.

The files of the first plan stay in the store. A piece is named by its part and a letter, such as 3/p07a.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.model import NOMINAL_TIME_FACTORS, JobOptions, Part, Plate, TimeFactors
from farm.planning.part_records import DecomposedPart, SlicedPart
from farm.planning.plan_storage import (
    MAX_WALL_WARNINGS,
    MAY_FALL_WARNING,
    PlateNames,
    store_part,
    store_plate,
)
from farm.state.storage import store_file


@dataclass(frozen=True, slots=True)
class ReplanTask:
    """Task to replan a plate with one part for some printers.

    Attributes
    ----------
    files
        The file store.
    folder
        Scratch folder.
    time_factors
        Time factors of the printers, by name; printers without an entry have nominal factors.
    other_parts
        The other parts of the same copy of the model, for the picture.
    reports
        Reports on the decomposition and on earlier cuts of its job, in the file store.
    """

    plate: Plate
    part: Part
    options: JobOptions
    printers: tuple[PrinterSection, ...]
    files: Path
    folder: Path
    time_factors: Mapping[str, TimeFactors] = field(default_factory=dict)
    other_parts: tuple[Part, ...] = ()
    reports: tuple[str, ...] = ()

    def find_time_factors(self, printer: str) -> TimeFactors:
        """Return the time factors of a printer."""
        return self.time_factors.get(printer, NOMINAL_TIME_FACTORS)


@dataclass(frozen=True, slots=True)
class Pieces:
    """Pieces of a part, in the frame of the job's model, with their report and instructions.

    Attributes
    ----------
    picture, assembly
        Picture and GLB of the whole job.
    """

    parts: tuple[DecomposedPart, ...]
    picture: Path
    assembly: Path
    decomposition_report: Path
    instructions: Path


@dataclass(frozen=True, slots=True)
class ReplannedPlate:
    """Parts and plates that replace a plate, and the names of the new files in the store (see `Pieces`)."""

    parts: tuple[Part, ...]
    plates: tuple[Plate, ...]
    picture: str | None = None
    assembly: str | None = None
    decomposition: str | None = None
    instructions: str | None = None


def copy_part(task: ReplanTask) -> DecomposedPart:
    """Copy a planned part from the store, to be sliced for the first printer."""
    part = task.part
    stl = task.folder / Path(part.file).name
    stl.write_bytes((task.files / part.file).read_bytes())
    return DecomposedPart(
        id=Path(part.id).name,
        stl=stl,
        geometry=part.geometry,
        price_s=task.plate.sliced_s,  # exact, because it was sliced
        printer=task.printers[0].name,
        print_options=part.print_options,
    )


def store_resliced_part(task: ReplanTask, sliced_part: SlicedPart) -> ReplannedPlate:
    """Record a resliced part on a new plate.

    Raises
    ------
    FarmError
        With code `slice` if more walls are too thin to print than on the old plate. Both counts are limited
        to `MAX_WALL_WARNINGS`, because a plate keeps no more warnings.
    """
    thin_walls = sliced_part.result.unprinted_walls
    known_warnings = [warning for warning in task.plate.warnings if warning != MAY_FALL_WARNING]
    if len(thin_walls[:MAX_WALL_WARNINGS]) > len(known_warnings):
        raise FarmError(f"{task.part.id}: {thin_walls[0]}", ErrorCode.SLICE)
    names = PlateNames(task.plate.job, task.part.id, make_next_plate_id(task.plate.id))
    plate = store_plate(names, sliced_part, task.find_time_factors(sliced_part.printer.name), task.files)
    return ReplannedPlate((task.part.model_copy(update={"plate": plate.id}),), (plate,))


def store_recut_part(task: ReplanTask, pieces: Pieces, sliced_parts: Sequence[SlicedPart]) -> ReplannedPlate:
    """Record the pieces of a part, each on its own plate."""
    parts, plates = [], []
    for piece in sliced_parts:
        letter = piece.part.id[-1]
        plate_id = f"{task.plate.id.partition('-')[0]}{letter}"
        names = PlateNames(task.plate.job, f"{task.part.id}{letter}", plate_id)
        parts.append(store_part(names, piece.part, task.files, cut_from=task.part))
        plates.append(store_plate(names, piece, task.find_time_factors(piece.printer.name), task.files))
    files = (pieces.picture, pieces.assembly, pieces.decomposition_report, pieces.instructions)
    file_names = (store_file(task.files, path) for path in files)
    return ReplannedPlate(tuple(parts), tuple(plates), *file_names)


def make_next_plate_id(plate: str) -> str:
    """Return the id of the next plate with the same part: 3/07, 3/07-2, 3/07-3."""
    match = re.fullmatch(r"(.*)-(\d+)", plate)
    return f"{match[1]}-{int(match[2]) + 1}" if match else f"{plate}-2"
