"""A waiting plate made otherwise: its part sliced for another kind of printer, or cut for several of them.

The files of the plan stay in the store. A piece goes by the name of its part and a letter: 3/p07a, 3/p07b.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions, Part, Plate
from farm.planning.error_translation import in_farm_words
from farm.planning.plan_records import DecomposedPart, Names, SliceTask, booked_part, booked_plate, slice_task
from farm.state.storage.file_store import store_file
from slicing.settings import find_resources

if TYPE_CHECKING:
    from slicing.plate import PlateResult


@dataclass(frozen=True, slots=True)
class ReplanTask:
    """A plate with one part that is to be made otherwise, for these printers."""

    plate: Plate
    part: Part
    options: JobOptions
    printers: tuple[PrinterSection, ...]
    files: Path  # the store
    folder: Path
    factors: Mapping[str, float] = field(default_factory=dict)  # learned of the printers; 1 where none is
    others: tuple[Part, ...] = ()  # of its job, for the picture


@dataclass(frozen=True, slots=True)
class Pieces:
    """What a part was cut into, in its job's model frame, with the report; picture and GLB of the job."""

    parts: tuple[DecomposedPart, ...]
    picture: Path
    assembly: Path
    decomposition: Path


@dataclass(frozen=True, slots=True)
class ReplannedPlate:
    """What is printed instead of a plate."""

    parts: tuple[Part, ...]
    plates: tuple[Plate, ...]
    picture: str | None = None
    assembly: str | None = None
    decomposition: str | None = None


def planned_part(task: ReplanTask) -> DecomposedPart:
    """The part as it was planned, for the first of the printers."""
    part = task.part
    stl = task.folder / Path(part.file).name
    stl.write_bytes((task.files / part.file).read_bytes())
    return DecomposedPart(
        id=Path(part.id).name,
        stl=stl,
        to_model=part.to_model,
        min_mm=part.min_mm,
        max_mm=part.max_mm,
        volume_mm3=part.volume_mm3,
        estimated_s=task.plate.estimated_s,
        printer=task.printers[0].name,
        brim_width_mm=part.brim_width_mm,
        layer_0_expansion_mm=part.layer_0_expansion_mm,
        stands=part.stands,
    )


def reslice_tasks(task: ReplanTask, parts: Sequence[DecomposedPart], cache: Path) -> list[SliceTask]:
    """What is to be sliced, a task for each part. Raises FarmError as `planning.slice_tasks`."""
    with in_farm_words():
        resources = find_resources()
    sections = {section.name: section for section in task.printers}
    return [
        slice_task(part, sections[part.printer], task.options.quality, resources, task.folder, cache)
        for part in parts
    ]


def resliced_plate(
    task: ReplanTask, part: DecomposedPart, work: SliceTask, sliced: PlateResult
) -> ReplannedPlate:
    """The same part on a new plate; what the first slice could print, this one has to print too.

    Raises
    ------
    FarmError
        `slice` where walls are too thin for this printer that were not for the first.
    """
    if len(sliced.unprinted) > len(task.plate.warnings):
        raise FarmError(f"{task.part.id}: {sliced.unprinted[0]}", ErrorCode.SLICE)
    section = task.printers[0]
    names = Names(task.plate.job, task.part.id, next_name(task.plate.id))
    factor = task.factors.get(section.name, 1.0)
    plate = booked_plate(names, section, work.settings, sliced, factor, task.files, part.stands)
    return ReplannedPlate((task.part.model_copy(update={"plate": plate.id}),), (plate,))


def recut_plates(
    task: ReplanTask, pieces: Pieces, tasks: Sequence[SliceTask], slices: Sequence[PlateResult]
) -> ReplannedPlate:
    """The pieces, each on a plate of its own."""
    sections = {section.name: section for section in task.printers}
    parts, plates = [], []
    for piece, work, sliced in zip(pieces.parts, tasks, slices, strict=True):
        letter = piece.id[-1]
        plate_id = f"{task.plate.id.partition('-')[0]}{letter}"
        names = Names(task.plate.job, f"{task.part.id}{letter}", plate_id)
        section = sections[piece.printer]
        factor = task.factors.get(section.name, 1.0)
        parts.append(booked_part(names, piece, task.files, cut_from=task.part.id))
        plates.append(booked_plate(names, section, work.settings, sliced, factor, task.files, piece.stands))
    of_all = (pieces.picture, pieces.assembly, pieces.decomposition)
    stored = (store_file(task.files, path) for path in of_all)
    return ReplannedPlate(tuple(parts), tuple(plates), *stored)


def next_name(plate: str) -> str:
    """What the next plate with the same part is called: 3/07, 3/07-2, 3/07-3."""
    found = re.fullmatch(r"(.*)-(\d+)", plate)
    return f"{found[1]}-{int(found[2]) + 1}" if found else f"{plate}-2"
