"""Storage of a plan: its files are put into the file store, its parts and plates become records."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from decompose.files.names import ASSEMBLY, INSTRUCTIONS, PICTURE, REPORT
from drivers.printers import PROFILES
from farm.model import Job, Part, Plate, TimeFactors
from farm.planning.part_records import DecomposedPart, SlicedPart
from farm.planning.plan import Plan, SlicedJob
from farm.planning.plate_times import compute_overhead_s
from farm.state.storage import store_file

MAX_WALL_WARNINGS = 3
"""Maximum number of a plate's warnings about walls that are too thin to print, the largest walls first."""
MAY_FALL_WARNING = (
    "has a small footprint in every pose that fits: watch it while it prints, or give it a wider brim"
)


@dataclass(frozen=True, slots=True)
class PlateNames:
    """Identifiers that a plate and its only part have in the books."""

    job: int
    part: str
    plate: str


def store_part(names: PlateNames, part: DecomposedPart, files: Path, cut_from: Part | None = None) -> Part:
    """Put a part's file into the store and return the record of the part.

    Parameters
    ----------
    files
        The store.
    cut_from
        The planned part from which this piece was cut; None for a part of the first plan.
    """
    return Part(
        id=names.part,
        job=names.job,
        plate=names.plate,
        file=store_file(files, part.stl),
        geometry=part.geometry,
        print_options=part.print_options,
        cut_from=None if cut_from is None else cut_from.id,
        copy_number=1 if cut_from is None else cut_from.copy_number,
        glue_rank=part.glue_rank if cut_from is None else cut_from.glue_rank,
    )


def store_plate(names: PlateNames, sliced_part: SlicedPart, time_factors: TimeFactors, files: Path) -> Plate:
    """Put a slice's G-code into the store and return the record of its plate.

    Parameters
    ----------
    time_factors
        Time factors of the printer, learned from its prints.
    files
        The store.
    """
    section, result, features = sliced_part.printer, sliced_part.result, sliced_part.features
    warnings = () if sliced_part.part.print_options.stands else (MAY_FALL_WARNING,)
    return Plate(
        id=names.plate,
        job=names.job,
        parts=(names.part,),
        gcode=store_file(files, result.gcode),
        sha256=result.sha256,
        sliced_s=result.sliced_s,
        features=features,
        expected_s=sliced_part.compute_expected_s(time_factors),
        grams=result.grams,
        filament_mm=result.filament_mm,
        price=section.compute_price(result.grams),
        layers=result.layers,
        min_mm=result.min_mm,
        max_mm=result.max_mm,
        material=section.material,
        nozzle_mm=section.nozzle_mm,
        family=PROFILES[section.model].family,
        printer=section.name,
        time_factor=time_factors.compute_factor(features.shares),
        cached=result.is_cached,
        warnings=(*warnings, *map(str, result.unprinted_walls[:MAX_WALL_WARNINGS])),
    )


def store_plan(sliced_job: SlicedJob, files: Path) -> Plan:
    """Put a sliced job's files into the store and return its plan."""
    task, decomposed_job = sliced_job.task, sliced_job.decomposed_job
    parts, plates = [], []
    for number, part in enumerate(sliced_job.parts, 1):
        names = PlateNames(task.job, f"{task.job}/{part.part.id}", f"{task.job}/{number:02d}")
        parts.append(store_part(names, part.part, files))
        plates.append(store_plate(names, part, task.find_time_factors(part.printer.name), files))
    return Plan(
        parts=tuple(parts),
        plates=tuple(plates),
        repairs=decomposed_job.repairs,
        scale=decomposed_job.scale,
        serial_s=_estimate_serial_s(sliced_job),
        picture=store_file(files, task.folder / PICTURE),
        assembly=store_file(files, task.folder / ASSEMBLY),
        decomposition=store_file(files, task.folder / REPORT),
        instructions=store_file(files, task.folder / INSTRUCTIONS),
        assembly_s=decomposed_job.assembly_s,
    )


def list_job_files(job: Job, parts: Iterable[Part], plates: Iterable[Plate]) -> dict[str, str]:
    """Return the stored files of a planned job, its parts and its plates, by their readable names.

    For a pruned job, these are only the pictures.
    """
    if job.pruned_s is not None:
        pictures = {f"{Path(part).name}.png": file for part, file in job.part_pictures.items()}
        return pictures | ({PICTURE: job.picture} if job.picture else {})
    files = {Path(part.id).name + Path(part.file).suffix: part.file for part in parts}
    files |= {f"plate-{Path(plate.id).name}.gcode": plate.gcode for plate in plates}
    shared_files = {
        PICTURE: job.picture,
        ASSEMBLY: job.assembly,
        REPORT: job.decomposition,
        INSTRUCTIONS: job.instructions,
    }
    files |= {name: file for name, file in shared_files.items() if file}
    for path, cuts in ((Path(REPORT), job.cuts), (Path(INSTRUCTIONS), job.cut_instructions)):
        files |= {f"{path.stem}-{Path(part).name}{path.suffix}": file for part, file in cuts.items()}
    return files


def _estimate_serial_s(sliced_job: SlicedJob) -> float:
    """Estimate the time of the whole model in one piece.

    This is the estimate of the cost model, times the ratio of sliced to estimated times of the parts.

    Slicing the whole model would take minutes, and no printer could print the result.
    """
    first = sliced_job.parts[0]
    overhead_s = compute_overhead_s(first.printer, first.task.settings)
    price_s = sum(part.part.price_s - overhead_s for part in sliced_job.parts)
    sliced_s = sum(float(part.result.sliced_s) for part in sliced_job.parts)
    return overhead_s + (sliced_job.decomposed_job.serial_price_s - overhead_s) * sliced_s / price_s
