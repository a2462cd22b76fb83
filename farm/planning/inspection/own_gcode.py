"""Inspection of a person's own G-code, and its plan of one plate. Runs in workers."""

from __future__ import annotations

import io
import re
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.emulator.firmware.planner import CAPACITY, Limits, Planner
from drivers.errors import BadGcode
from drivers.gcode import read_program
from drivers.printers import PROFILES, Profile
from farm.config import PrinterSection
from farm.errors import ErrorCode, FarmError
from farm.model import JobOptions, OwnGcode, Part, PartGeometry, Plate
from farm.planning.error_translation import translate_errors
from farm.planning.plan import DecomposeTask, InspectedSubmission, Plan
from farm.planning.plate_times import compute_plate_seconds
from farm.planning.printer_settings import list_bed_boxes, list_matching_printers, resolve_printer_settings
from farm.state.storage import compute_sha256, store_file
from slicing.errors import GcodeRefused
from slicing.own_gcode import MAX_LINE_BYTES, AcceptedGcode, PrintTarget, accept_gcode, quote_text
from slicing.settings import EngineSettings, find_resources

GCODE_SUFFIXES = (".gcode", ".g", ".gco")
_UNPACKING_ADVICE = {
    ".gz": "unpack it with gunzip",
    ".zip": "unpack it first",
    ".bgcode": "let your slicer write plain G-code (PrusaSlicer: switch binary G-code off)",
    ".3mf": "let your slicer export plain G-code, not a sliced plate (OrcaSlicer: Export G-code)",
    ".ufp": "let Cura write G-code instead of a format package",
}
_IDENTITY_TRANSFORM = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_EXTRA_TRAVEL_MM = 10.0  # Z travel of the bed beyond the build height, for a final Z hop
_TOLERANCE_MM = 0.05
_MATERIAL_SYNONYMS = {"PET": "PETG", "CPE": "PETG", "PA": "NYLON", "FLEX": "TPU"}
_MAX_DEVIATION_C = 30.0  # the temperatures of different brands of one material differ by less


def is_gcode(name: str) -> bool:
    """Return whether the name of a submission is that of a G-code file.

    Raises
    ------
    FarmError
        If the file is compressed or packed G-code.
    """
    lower_name = name.lower()
    compressed_suffix = next((suffix for suffix in _UNPACKING_ADVICE if lower_name.endswith(suffix)), None)
    if compressed_suffix is not None and (
        compressed_suffix in (".bgcode", ".ufp")
        or _is_plain_gcode(lower_name.removesuffix(compressed_suffix))
    ):
        raise FarmError(f"{name}: {_UNPACKING_ADVICE[compressed_suffix]}, and submit that", ErrorCode.GCODE)
    return _is_plain_gcode(lower_name)


def _is_plain_gcode(lower_name: str) -> bool:
    return lower_name.endswith(GCODE_SUFFIXES)


def inspect_gcode(
    path: Path, name: str, options: JobOptions, printers: Sequence[PrinterSection], files: Path
) -> InspectedSubmission:
    """Check that a G-code file can be printed on at least one of the printers, and store it.

    Raises
    ------
    FarmError
        With code `settings` if an option does not apply to G-code, `refused` if no printer matches, `gcode`
        if the G-code is refused (the message has the line and the reason), `no_fit` if the print does not
        fit any matching printer.
    """
    _check_options(options)
    matching_printers = list_matching_printers(printers, options)
    accepted_gcode = _rewrite_gcode(
        path, matching_printers[0], _find_common_nozzle_mm(matching_printers), name
    )
    section = _find_fitting_printer(matching_printers, accepted_gcode, name)
    requirements = _measure_requirements(accepted_gcode, section)
    target = path.with_name(f"gcode-{uuid.uuid4().hex}.gcode")
    target.hardlink_to(path)  # the upload is kept for another worker if this one dies
    return InspectedSubmission(
        store_file(files, target), _list_notices(accepted_gcode, section), 1.0, requirements
    )


def plan_gcode(task: DecomposeTask, files: Path) -> Plan:
    """Plan one plate, on the printer with the lowest build height of those that can print it.

    Raises
    ------
    FarmError
        See `inspect_gcode`.
    """
    sections = sorted(
        task.printers,
        key=lambda section: (
            PROFILES[section.model].height_mm,
            task.find_time_factors(section.name).overall_factor,
            section.name,
        ),
    )
    nozzle_mm = _find_common_nozzle_mm(sections)
    accepted_gcode = _rewrite_gcode(task.model, sections[0], nozzle_mm, "the file")
    section = _find_fitting_printer(sections, accepted_gcode, "the file")
    if section is not sections[0]:  # it may have a different material
        accepted_gcode = _rewrite_gcode(task.model, section, nozzle_mm, "the file")
    part, plate = _store_gcode(task, accepted_gcode, section, files)
    return Plan((part,), (plate,), _list_notices(accepted_gcode, section), 1.0, plate.expected_s)


def _store_gcode(
    task: DecomposeTask, accepted_gcode: AcceptedGcode, section: PrinterSection, files: Path
) -> tuple[Part, Plate]:
    """Put the rewritten file into the store, and return its part and its plate."""
    requirements = _measure_requirements(accepted_gcode, section)
    out = task.folder / "plate.gcode"
    out.write_bytes(accepted_gcode.gcode)
    settings = _resolve_material(section)
    filament_mm3 = accepted_gcode.filament_mm * settings.filament_mm2
    grams = filament_mm3 / 1000 * settings.density_g_cm3
    profile, time_factor = PROFILES[section.model], task.find_time_factors(section.name).overall_factor
    part = Part(
        id=f"{task.job}/p01",
        job=task.job,
        plate=f"{task.job}/01",
        file=task.model.name,
        geometry=PartGeometry(
            to_model=_IDENTITY_TRANSFORM,
            min_mm=requirements.min_mm,
            max_mm=requirements.max_mm,
            volume_mm3=filament_mm3,
        ),
    )
    plate = Plate(
        id=part.plate,
        job=task.job,
        parts=(part.id,),
        sha256=compute_sha256(out),
        gcode=store_file(files, out),
        sliced_s=accepted_gcode.print_time_s,
        expected_s=compute_plate_seconds(
            profile, accepted_gcode.print_time_s, accepted_gcode.nozzle_c, accepted_gcode.bed_c, time_factor
        ),
        grams=grams,
        filament_mm=accepted_gcode.filament_mm,
        price=section.compute_price(grams),
        layers=accepted_gcode.layers,
        min_mm=requirements.min_mm,
        max_mm=requirements.max_mm,
        material=section.material,
        nozzle_mm=section.nozzle_mm,
        printer=section.name,
        time_factor=time_factor,
    )
    return part, plate


def _find_common_nozzle_mm(printers: Sequence[PrinterSection]) -> float | None:
    """Return the nozzle diameter of all printers; None if they differ."""
    sizes_mm = {section.nozzle_mm for section in printers}
    return sizes_mm.pop() if len(sizes_mm) == 1 else None


def _rewrite_gcode(path: Path, section: PrinterSection, nozzle_mm: float | None, name: str) -> AcceptedGcode:
    """Rewrite a file for a printer, and check that the result can be sent."""
    settings = _resolve_material(section)
    try:
        accepted_gcode = accept_gcode(
            _FileLines(path),
            PrintTarget(
                printer=settings.printer,
                filament_mm2=settings.filament_mm2,
                nozzle_mm=nozzle_mm,
                nozzle_c=settings.nozzle_c,
                bed_c=settings.bed_c,
            ),
            time_estimator=FirmwareTimeEstimator(PROFILES[section.model]),
        )
        read_program(io.BytesIO(accepted_gcode.gcode), PROFILES[section.model])
    except (GcodeRefused, BadGcode) as error:
        raise FarmError(f"{name}: {error}", ErrorCode.GCODE) from error
    return accepted_gcode


def _resolve_material(section: PrinterSection) -> EngineSettings:
    """Resolve the settings of a printer's material: temperatures, density and filament cross-section."""
    with translate_errors():
        return resolve_printer_settings(section, JobOptions().quality, find_resources())


def _list_notices(accepted_gcode: AcceptedGcode, section: PrinterSection) -> tuple[str, ...]:
    """List the changes made to a file, with warnings if it seems to have been sliced for another material."""
    notices = list(accepted_gcode.notices)
    filament_type, kind = accepted_gcode.filament_type, find_resources().read_material_kind(section.material)
    if (
        filament_type is not None
        and kind is not None
        and _normalise_material(filament_type) != _normalise_material(kind)
    ):
        notices.append(
            f"Warning: it was sliced for {quote_text(filament_type)}, and {section.name} has "
            f"{section.material} ({kind})."
        )
    usual_c = _resolve_material(section).nozzle_c
    if abs(accepted_gcode.nozzle_c - usual_c) > _MAX_DEVIATION_C:
        notices.append(
            f"Warning: it heats the nozzle to {accepted_gcode.nozzle_c:g} C, and {section.material} on "
            f"{section.name} is usually printed at {usual_c:g} C: was it sliced for another material?"
        )
    return tuple(notices)


def _normalise_material(kind: str) -> str:
    """Normalise the name of a kind of material: slicers and Cura use several names for some kinds."""
    first = re.split(r"[\s\d_+-]", kind.strip().upper().removeprefix("TOUGH "), maxsplit=1)[0]
    return _MATERIAL_SYNONYMS.get(first, first)


def _measure_requirements(accepted_gcode: AcceptedGcode, section: PrinterSection) -> OwnGcode:
    """Return the nozzle diameter of a file, and the extent of its print relative to the bed's centre."""
    width_mm, depth_mm = PROFILES[section.model].bed_mm
    (x0, y0, z0), (x1, y1, z1) = accepted_gcode.min_mm, accepted_gcode.max_mm
    return OwnGcode(
        nozzle_mm=accepted_gcode.nozzle_mm,
        min_mm=(x0 - width_mm / 2, y0 - depth_mm / 2, z0),
        max_mm=(x1 - width_mm / 2, y1 - depth_mm / 2, z1),
    )


def _find_fitting_printer(
    printers: Sequence[PrinterSection], accepted_gcode: AcceptedGcode, name: str
) -> PrinterSection:
    obstacles = []
    for section in printers:
        obstacle = _describe_obstacle(section, accepted_gcode)
        if obstacle is None:
            return section
        obstacles.append(obstacle)
    raise FarmError(f"{name}: {obstacles[0]}", ErrorCode.NO_FIT)


def _describe_obstacle(section: PrinterSection, accepted_gcode: AcceptedGcode) -> str | None:
    """Describe why a printer cannot print a file; None if it can."""
    requirements = _measure_requirements(accepted_gcode, section)
    if requirements.nozzle_mm not in (None, section.nozzle_mm):
        return (
            f"sliced for a nozzle of {requirements.nozzle_mm:g} mm, "
            f"and {section.name} has {section.nozzle_mm:g} mm"
        )
    (x0, y0, _), (x1, y1, z1) = requirements.min_mm, requirements.max_mm
    if not any(
        x0 >= left - _TOLERANCE_MM and y0 >= front - _TOLERANCE_MM and x1 <= right + _TOLERANCE_MM
        and y1 <= back + _TOLERANCE_MM and z1 <= height + _TOLERANCE_MM
        for left, front, right, back, height in list_bed_boxes(section)
    ):  # fmt: skip
        (left, front, _), (right, back, _) = accepted_gcode.min_mm, accepted_gcode.max_mm
        return (
            f"prints on X {left:.1f}..{right:.1f}, Y {front:.1f}..{back:.1f}, up to Z {z1:.1f} mm: partly "
            f"off the bed of {section.name}, on its clips or above its height; move it in your slicer"
        )
    profile = PROFILES[section.model]
    size_mm = (*profile.bed_mm, profile.height_mm + _EXTRA_TRAVEL_MM)
    for axis, low, high, end in zip(
        "XYZ", accepted_gcode.reach_min_mm, accepted_gcode.reach_max_mm, size_mm, strict=True
    ):
        if low < -_TOLERANCE_MM or high > end + _TOLERANCE_MM:
            outermost = low if low < 0 else high
            return (
                f"moves to {axis} {outermost:.1f}, and {section.name} reaches 0 to {end:g}: "
                f"choose the {profile.title} in your slicer"
            )
    return None


def _check_options(options: JobOptions) -> None:
    """Refuse options that apply only to models."""
    defaults = JobOptions()
    is_given_by_flag = {
        "--longest-side": options.longest_side_mm is not None,
        "--scale": options.scale is not None,
        "--printers": options.printers not in (None, 1) and options.copies == 1,
        "--quality": options.quality != defaults.quality,
        "--pins": options.pin_mm is not None,
        "--marks": options.marks,
        "--engine": options.engine != defaults.engine,
    }
    flags = [flag for flag, is_given in is_given_by_flag.items() if is_given]
    if flags:
        raise FarmError(
            f"{' '.join(flags)}: G-code is printed as it is, on one printer: omit these options, or submit a "
            "model",
            ErrorCode.SETTINGS,
        )


@dataclass(frozen=True, slots=True)
class _FileLines:
    """Lines of a file, read again at each iteration; a line that is too long is cut at the limit."""

    path: Path

    def __iter__(self) -> Iterator[bytes]:
        with self.path.open("rb") as file:
            while line := file.readline(MAX_LINE_BYTES):
                yield line


class FirmwareTimeEstimator:
    """Estimator of the time that the firmware's motion planner needs for moves if none is received late."""

    def __init__(self, profile: Profile) -> None:
        self._planner = Planner(
            Limits.from_profile(profile), (*profile.start_position_mm, 0.0), lambda _e_mm, _z_mm: None
        )
        self._now_s = 0.0

    def move(self, x: float, y: float, z: float, e: float, speed_mm_s: float) -> None:
        """Add a move to a position in mm."""
        planner = self._planner
        if len(planner) >= CAPACITY:
            self._now_s = planner.compute_next_free_s()
            planner.advance(self._now_s)
        planner.add((x, y, z, e), speed_mm_s, self._now_s)

    def wait(self, seconds: float) -> None:
        """Add a pause after all moves."""
        self._now_s = self.measure_time_s(finish=True) + seconds

    def measure_time_s(self, finish: bool = False) -> float:
        """Return the elapsed time; with `finish`, it includes the moves that have not ended."""
        while finish and len(self._planner):
            self._now_s = self._planner.end_s
            self._planner.advance(self._now_s)
        return self._now_s
