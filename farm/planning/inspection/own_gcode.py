"""A person's own G-code: checked at submission, and planned as one plate. The work runs in workers."""

from __future__ import annotations

import io
import re
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import BadGcode
from drivers.gcode import program as wire
from drivers.printers import PROFILES
from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions, OwnGcode, Part, PartGeometry, Plate
from farm.planning.error_translation import translate_errors
from farm.planning.inspection.move_times import FirmwareTime
from farm.planning.parts.part_rooms import bed_boxes
from farm.planning.plan import DecomposeTask, InspectedSubmission, Plan
from farm.planning.plate_times import plate_seconds
from farm.planning.printer_settings import matching_printers, printer_settings
from farm.state.storage.file_store import sha256_of, store_file
from slicing.errors import GcodeRefused
from slicing.own_gcode import LONGEST, ForeignGcode, PrintTarget, accept, shown
from slicing.settings import EngineSettings, find_resources

SUFFIXES = (".gcode", ".g", ".gco")
_PACKED = {
    ".gz": "unpack it with gunzip",
    ".zip": "unpack it first",
    ".bgcode": "let your slicer write plain G-code (PrusaSlicer: switch binary G-code off)",
    ".ufp": "let Cura write G-code instead of a format package",
}
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_REACH_MM = 10.0  # above its build height the bed still goes down: what a last hop may use
_SLACK_MM = 0.05
_SAME_MATERIAL = {"PET": "PETG", "CPE": "PETG", "PA": "NYLON", "FLEX": "TPU"}
_APART_C = 30.0  # brands of one material are not so far apart


def is_gcode(name: str) -> bool:
    """Whether a submission is taken for G-code, by its name.

    Raises
    ------
    FarmError
        Where it is G-code that is packed.
    """
    lower = name.lower()
    packing = next((suffix for suffix in _PACKED if lower.endswith(suffix)), None)
    if packing is not None and (packing in (".bgcode", ".ufp") or _is_plain(lower.removesuffix(packing))):
        raise FarmError(f"{name}: {_PACKED[packing]}, and submit that", ErrorCode.GCODE)
    return _is_plain(lower)


def _is_plain(lower: str) -> bool:
    return lower.endswith(SUFFIXES)


def inspect_gcode(
    path: Path, name: str, options: JobOptions, printers: Sequence[PrinterSection], files: Path
) -> InspectedSubmission:
    """Whether a file can be printed on one of these printers; runs in a worker.

    Raises
    ------
    FarmError
        `settings` for an option that G-code leaves no choice in, `refused` where no printer matches, `gcode`
        with the line and the reason, `no_fit` where it fits no matching printer.
    """
    _check_options(options)
    matching = matching_printers(printers, options)
    accepted = _accept(path, matching[0], _nozzle(matching), name)
    section = _first_that_fits(matching, accepted, name)
    own = _own(accepted, section)
    stored = path.with_name(f"gcode-{uuid.uuid4().hex}.gcode")
    stored.hardlink_to(path)  # where its worker dies now, another one reads the upload again
    return InspectedSubmission(store_file(files, stored), _notices(accepted, section), 1.0, own)


def plan_gcode(task: DecomposeTask, files: Path) -> Plan:
    """A plan of one plate, on the lowest of the printers that can print it; runs in a worker.

    Raises
    ------
    FarmError
        As `inspect_gcode`.
    """
    order = sorted(
        task.printers,
        key=lambda section: (
            PROFILES[section.model].height_mm,
            task.time_factors.get(section.name, 1.0),
            section.name,
        ),
    )
    nozzle_mm = _nozzle(order)
    accepted = _accept(task.model, order[0], nozzle_mm, "the file")
    section = _first_that_fits(order, accepted, "the file")
    if section is not order[0]:  # its material may be another
        accepted = _accept(task.model, section, nozzle_mm, "the file")
    own = _own(accepted, section)
    out = task.folder / "plate.gcode"
    out.write_bytes(accepted.gcode)
    settings = _settings(section)
    filament_mm3 = accepted.filament_mm * settings.filament_mm2
    grams = filament_mm3 / 1000 * settings.density_g_cm3
    factor = task.time_factors.get(section.name, 1.0)
    expected_s = plate_seconds(
        PROFILES[section.model], accepted.print_time_s, accepted.nozzle_c, accepted.bed_c, factor
    )
    part = Part(
        id=f"{task.job}/p01",
        job=task.job,
        plate=f"{task.job}/01",
        file=task.model.name,
        geometry=PartGeometry(
            to_model=_IDENTITY, min_mm=own.min_mm, max_mm=own.max_mm, volume_mm3=filament_mm3
        ),
    )
    plate = Plate(
        id=part.plate,
        job=task.job,
        parts=(part.id,),
        sha256=sha256_of(out),
        gcode=store_file(files, out),
        sliced_s=accepted.print_time_s,
        expected_s=expected_s,
        grams=grams,
        filament_mm=accepted.filament_mm,
        price=section.price(grams),
        layers=accepted.layers,
        min_mm=own.min_mm,
        max_mm=own.max_mm,
        material=section.material,
        nozzle_mm=section.nozzle_mm,
        printer=section.name,
        time_factor=factor,
    )
    return Plan((part,), (plate,), _notices(accepted, section), 1.0, expected_s, expected_s)


def _nozzle(printers: Sequence[PrinterSection]) -> float | None:
    """The one that all of them have."""
    found = {section.nozzle_mm for section in printers}
    return found.pop() if len(found) == 1 else None


def _accept(path: Path, section: PrinterSection, nozzle_mm: float | None, name: str) -> ForeignGcode:
    """What the slicing room makes of the file, and once more whether it can be sent."""
    settings = _settings(section)
    try:
        accepted = accept(
            _Lines(path),
            PrintTarget(
                printer=settings.printer,
                filament_mm2=settings.filament_mm2,
                nozzle_mm=nozzle_mm,
                nozzle_c=settings.nozzle_c,
                bed_c=settings.bed_c,
            ),
            stopwatch=FirmwareTime(PROFILES[section.model]),
        )
        wire.strip(io.BytesIO(accepted.gcode), PROFILES[section.model])
    except (GcodeRefused, BadGcode) as error:
        raise FarmError(f"{name}: {error}", ErrorCode.GCODE) from error
    return accepted


def _settings(section: PrinterSection) -> EngineSettings:
    """For what its material says: temperatures, density and the filament's section."""
    with translate_errors():
        return printer_settings(section, JobOptions().quality, find_resources())


def _notices(accepted: ForeignGcode, section: PrinterSection) -> tuple[str, ...]:
    """What was changed, and whether the file looks like one for another material."""
    notices = list(accepted.notices)
    own, kind = accepted.filament_type, find_resources().material_kind(section.material)
    if own is not None and kind is not None and _material(own) != _material(kind):
        notices.append(
            f"Warning: it was sliced for {shown(own)}, and {section.name} has {section.material} ({kind})."
        )
    usual_c = _settings(section).nozzle_c
    if abs(accepted.nozzle_c - usual_c) > _APART_C:
        notices.append(
            f"Warning: it heats the nozzle to {accepted.nozzle_c:g} C, and {section.material} on "
            f"{section.name} usually has {usual_c:g} C: was it sliced for another material?"
        )
    return tuple(notices)


def _material(kind: str) -> str:
    """A material's kind under one name: slicers and Cura have several for some."""
    first = re.split(r"[\s\d_+-]", kind.strip().upper().removeprefix("TOUGH "), maxsplit=1)[0]
    return _SAME_MATERIAL.get(first, first)


def _own(accepted: ForeignGcode, section: PrinterSection) -> OwnGcode:
    """What the file asks of a printer, from the bed's centre: as the plates of a model."""
    width, depth = PROFILES[section.model].bed_mm
    (x0, y0, z0), (x1, y1, z1) = accepted.min_mm, accepted.max_mm
    return OwnGcode(
        nozzle_mm=accepted.nozzle_mm,
        min_mm=(x0 - width / 2, y0 - depth / 2, z0),
        max_mm=(x1 - width / 2, y1 - depth / 2, z1),
    )


def _first_that_fits(printers: Sequence[PrinterSection], accepted: ForeignGcode, name: str) -> PrinterSection:
    obstacles = []
    for section in printers:
        obstacle = _obstacle(section, accepted)
        if obstacle is None:
            return section
        obstacles.append(obstacle)
    raise FarmError(f"{name}: {obstacles[0]}", ErrorCode.NO_FIT)


def _obstacle(section: PrinterSection, accepted: ForeignGcode) -> str | None:
    """Why a printer cannot print it; None where it can."""
    own = _own(accepted, section)
    if own.nozzle_mm not in (None, section.nozzle_mm):
        return f"sliced for a nozzle of {own.nozzle_mm:g} mm, and {section.name} has {section.nozzle_mm:g} mm"
    (x0, y0, _), (x1, y1, z1) = own.min_mm, own.max_mm
    if not any(
        x0 >= left - _SLACK_MM and y0 >= front - _SLACK_MM and x1 <= right + _SLACK_MM
        and y1 <= back + _SLACK_MM and z1 <= height + _SLACK_MM
        for left, front, right, back, height in bed_boxes(section)
    ):  # fmt: skip
        (left, front, _), (right, back, _) = accepted.min_mm, accepted.max_mm
        return (
            f"prints on X {left:.1f}..{right:.1f}, Y {front:.1f}..{back:.1f}, up to Z {z1:.1f} mm: not all "
            f"on the bed of {section.name}, off its clips and within its height; move it in your slicer"
        )
    profile = PROFILES[section.model]
    most = (*profile.bed_mm, profile.height_mm + _REACH_MM)
    for axis, low, high, end in zip("XYZ", accepted.reach_min_mm, accepted.reach_max_mm, most, strict=True):
        if low < -_SLACK_MM or high > end + _SLACK_MM:
            far = low if low < 0 else high
            return (
                f"moves to {axis} {far:.1f}, and {section.name} reaches 0 to {end:g}: choose an Ultimaker 2+ "
                "in your slicer"
            )
    return None


def _check_options(options: JobOptions) -> None:
    """Refuse what G-code has decided already."""
    usual = JobOptions()
    given = {
        "--longest-side": options.longest_side_mm is not None,
        "--scale": options.scale is not None,
        "--printers": options.printers not in (None, 1),
        "--quality": options.quality != usual.quality,
        "--engine": options.engine != usual.engine,
    }
    flags = [flag for flag, is_given in given.items() if is_given]
    if flags:
        raise FarmError(
            f"{' '.join(flags)}: G-code is printed as it is, on one printer: leave it out, or submit a model",
            ErrorCode.SETTINGS,
        )


@dataclass(frozen=True, slots=True)
class _Lines:
    """A file's lines, anew each time, none longer than what is refused anyway."""

    path: Path

    def __iter__(self) -> Iterator[bytes]:
        with self.path.open("rb") as file:
            while line := file.readline(LONGEST):
                yield line
