"""A job's plan: model -> parts -> plates. The work runs in workers; what is put together here is data.

The order is decompose, slice every part, where it is worth it level the parts by what that tells and slice
again, then price every plate. A plan is whole or it is nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from decompose.file_names import ASSEMBLY, PICTURE, REPORT
from drivers.printers import PROFILES
from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError, Refused
from farm.model import Job, JobOptions, OwnGcode, Part, Plate
from farm.planning.error_translation import in_farm_words
from farm.planning.plan_records import (
    DecomposedPart,
    Names,
    SliceTask,
    booked_part,
    booked_plate,
    printer_settings,
    slice_task,
)
from farm.planning.plate_times import plate_seconds, prelude_seconds
from farm.state.storage.file_store import store_file
from slicing.settings import find_resources

if TYPE_CHECKING:
    from slicing.plate import PlateResult

WORTH_S, WORTH = 120.0, 0.01
"""By how much the last printer has to end later than all do in the mean: parts are levelled again then."""


class TooFewPrinters(FarmError):
    """The model needs more parts than printers were given."""

    def __init__(self, message: str, needed: int) -> None:
        super().__init__(message, ErrorCode.NO_FIT)
        self.needed = needed

    def __reduce__(self) -> tuple[Any, ...]:
        return TooFewPrinters, (str(self), self.needed)


@dataclass(frozen=True, slots=True)
class Inspected:
    """What can be printed, in the file store: a solid in mm, or a person's own G-code."""

    file: str
    repairs: tuple[str, ...]  # and whatever else was changed, in sentences
    scale: float
    own_gcode: OwnGcode | None = None


@dataclass(frozen=True, slots=True)
class DecomposeTask:
    """A job to be decomposed for these printers."""

    job: int
    model: Path  # as `inspect_model` stored it
    options: JobOptions
    printers: tuple[PrinterSection, ...]
    rounds: int
    folder: Path
    factors: Mapping[str, float] = field(default_factory=dict)  # learned of the printers; 1 where none is
    within_s: float | None = None  # in which it has to be printed (`--done-by`)
    budget_s: float | None = None  # of the search for its parts; None: as the decomposition has it


@dataclass(frozen=True, slots=True)
class Decomposed:
    """What a worker sends back: figures and file names, no geometry."""

    parts: tuple[DecomposedPart, ...]
    serial_s: float
    repairs: tuple[str, ...]
    scale: float
    cutting: bytes | None = None
    """How it was cut, pickled for `decomposing.level_again` alone: the daemon loads nothing for it."""


@dataclass(frozen=True, slots=True)
class Sliced:
    """A decomposition with the slice of each part."""

    task: DecomposeTask
    decomposed: Decomposed
    tasks: tuple[SliceTask, ...]
    slices: tuple[PlateResult, ...]

    def took_s(self) -> tuple[float, ...]:
        """What each part takes from the first command to the last, were all printers as quick."""
        return self._ends_s(dict.fromkeys(self.task.factors, 1.0))

    def sections(self) -> list[PrinterSection]:
        """The printer of each part."""
        by_name = {section.name: section for section in self.task.printers}
        return [by_name[part.printer] for part in self.decomposed.parts]

    def busy_s(self) -> dict[str, float]:
        """How long each printer prints that has a part at all, as its plates will say."""
        busy: dict[str, float] = {}
        for section, ends_s in zip(self.sections(), self._ends_s(self.task.factors), strict=True):
            busy[section.name] = busy.get(section.name, 0.0) + ends_s
        return busy

    def makespan_s(self) -> float:
        """The printer that is busy longest; clearing beds between rounds is not counted."""
        return max(self.busy_s().values())

    def worth_levelling(self) -> bool:
        """Whether the printer that ends last is late enough to move cuts, and slice all again.

        Where a printer has several parts, levelling those would not level the printers.
        """
        busy_s = self.busy_s()
        late_s = self.makespan_s() - sum(busy_s.values()) / len(busy_s)
        worth = late_s >= max(WORTH_S, WORTH * self.makespan_s())
        return self.decomposed.cutting is not None and len(busy_s) == len(self.slices) and worth

    def _ends_s(self, factors: Mapping[str, float]) -> tuple[float, ...]:
        each = zip(self.sections(), self.tasks, self.slices, strict=True)
        return tuple(
            plate_seconds(
                PROFILES[section.model],
                result.print_time_s,
                work.settings.nozzle_c,
                work.settings.bed_c,
                factors.get(section.name, 1.0),
            )
            for section, work, result in each
        )


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything that is committed before the first command is sent."""

    parts: tuple[Part, ...]
    plates: tuple[Plate, ...]
    repairs: tuple[str, ...]
    scale: float
    serial_s: float
    estimated_s: float
    picture: str | None = None
    assembly: str | None = None
    decomposition: str | None = None


def check_settings(printers: Sequence[PrinterSection], options: JobOptions) -> None:
    """Whether a job's quality can be printed on every printer that it may go to; runs in a worker.

    Raises
    ------
    FarmError
        `refused` where no printer of the fleet matches, `settings` where its quality does not exist, `engine`
        where Cura's files are missing; each with what there is instead.
    """
    with in_farm_words():
        resources = find_resources()
    for section in matching_printers(printers, options):
        printer_settings(section, options.quality, resources)


def matching_printers(printers: Sequence[PrinterSection], options: JobOptions) -> list[PrinterSection]:
    """The printers with the material and the colour that a job asks for, at least one.

    Raises
    ------
    Refused
        Where there is none, with what there is.
    """
    enabled = [section for section in printers if section.enabled]
    matching = [
        section
        for section in enabled
        if options.material in (None, section.material) and options.colour in (None, section.colour)
    ]
    if not matching:
        have = sorted({f"{s.material} {s.colour}" if s.colour else s.material for s in enabled})
        asked = " ".join(filter(None, (options.material, options.colour))) or "a printer"
        raise Refused(
            f"no printer of the fleet has {asked}; there is {', '.join(have) or 'no printer at all'}"
        )
    return matching


def slice_tasks(task: DecomposeTask, decomposed: Decomposed, cache: Path) -> list[SliceTask]:
    """What is to be sliced, a task for each part, each for its own printer.

    Raises
    ------
    FarmError
        `engine` where there is no CuraEngine, `settings` where they cannot be resolved.
    """
    with in_farm_words():
        resources = find_resources()
    sections = {section.name: section for section in task.printers}
    return [
        slice_task(part, sections[part.printer], task.options.quality, resources, task.folder, cache)
        for part in decomposed.parts
    ]


def make_plan(sliced: Sliced, files: Path) -> Plan:
    """Put the plan together, and its files into the store."""
    task, decomposed = sliced.task, sliced.decomposed
    parts, plates = [], []
    each = zip(decomposed.parts, sliced.sections(), sliced.tasks, sliced.slices, strict=True)
    for number, (part, section, work, result) in enumerate(each, 1):
        names = Names(task.job, f"{task.job}/{part.id}", f"{task.job}/{number:02d}")
        factor = task.factors.get(section.name, 1.0)
        parts.append(booked_part(names, part, files))
        plates.append(booked_plate(names, section, work.settings, result, factor, files, part.stands))
    prelude_s = prelude_seconds(sliced.sections()[0], sliced.tasks[0].settings)
    return Plan(
        parts=tuple(parts),
        plates=tuple(plates),
        repairs=decomposed.repairs,
        scale=decomposed.scale,
        serial_s=prelude_s + _serial_s(sliced, prelude_s),
        estimated_s=sliced.makespan_s(),
        picture=store_file(files, task.folder / PICTURE),
        assembly=store_file(files, task.folder / ASSEMBLY),
        decomposition=store_file(files, task.folder / REPORT),
    )


def file_names(job: Job, parts: Iterable[Part], plates: Iterable[Plate]) -> dict[str, str]:
    """A planned job's files, of those parts and plates, by the names that a person finds them under."""
    names = {Path(part.id).name + Path(part.file).suffix: part.file for part in parts}
    names |= {f"plate-{Path(plate.id).name}.gcode": plate.gcode for plate in plates}
    of_all = {PICTURE: job.picture, ASSEMBLY: job.assembly, REPORT: job.decomposition}
    names |= {name: stored for name, stored in of_all.items() if stored}
    report = Path(REPORT)
    return names | {
        f"{report.stem}-{Path(part).name}{report.suffix}": stored for part, stored in job.cuts.items()
    }


def _serial_s(sliced: Sliced, prelude_s: float) -> float:
    """The layers of the whole model in one piece: the cost's estimate, corrected by its error on the parts.

    Slicing the whole would take minutes, for a printer that nobody has.
    """
    estimated_s = sum(part.estimated_s - prelude_s for part in sliced.decomposed.parts)
    sliced_s = sum(float(result.print_time_s) for result in sliced.slices)
    return (sliced.decomposed.serial_s - prelude_s) * sliced_s / estimated_s
