"""Conversion of a person's own G-code into a program that the farm can print, or its refusal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from slicing.errors import GcodeRefused
from slicing.own_gcode.clearance import Clearance
from slicing.own_gcode.completeness import StatedFigures
from slicing.own_gcode.extent import Extent
from slicing.own_gcode.interpreter import Interpreter
from slicing.own_gcode.machine import check_machine
from slicing.own_gcode.survey import EXPORT_ADVICE, Survey, survey_lines
from slicing.own_gcode.target import PrintTarget
from slicing.own_gcode.writer import TimeEstimator, Writer

PLAUSIBLE_RATIOS = (0.2, 2.5)
"""Bounds of the ratio of the lines' mean cross-section to that of a line as wide as the nozzle and as high as
the layer. Slicers reach 2, and ironing may bring it far below 1; E in mm3 instead of mm gives about 6 (or
0.15), and filament of 1.75 mm instead of 2.85 mm about 2.7."""
MAX_LAYER_SHARE = 0.8
"""Maximum layer height as a share of the nozzle's diameter; higher lines do not stick."""
SLACK_LAYERS = 1.25
"""Depth to which slicers may go below a layer's top, as in a scarf seam, in layers of maximum height."""


@dataclass(frozen=True, slots=True)
class AcceptedGcode:
    """Accepted G-code and its facts.

    Attributes
    ----------
    gcode
        The whole program, with the farm's own start and end.
    nozzle_mm
        Nozzle that the file was sliced for; None if it does not say.
    nozzle_c, bed_c
        Temperatures of the first layer.
    print_time_s
        Time measured by `time_estimator`, without start and end.
    filament_mm
        Length of filament, without priming.
    layers
        Number of layers that the file marks, or of heights at which it prints if it marks none.
    min_mm, max_mm
        Corners of the box around all extrusion and, in X and Y, around the moves as low as the bed's clips,
        in the printer's coordinates.
    reach_min_mm, reach_max_mm
        Corners of the box around all moves.
    filament_type
        Material that the file was sliced for, such as PLA; None if it does not say.
    notices
        Changes and warnings, a sentence each.
    """

    gcode: bytes
    nozzle_mm: float | None
    nozzle_c: float
    bed_c: float
    print_time_s: float
    filament_mm: float
    layers: int
    min_mm: tuple[float, float, float]
    max_mm: tuple[float, float, float]
    reach_min_mm: tuple[float, float, float]
    reach_max_mm: tuple[float, float, float]
    filament_type: str | None
    notices: tuple[str, ...]


def accept_gcode(
    lines: Iterable[bytes], target: PrintTarget, *, time_estimator: TimeEstimator
) -> AcceptedGcode:
    """Read a file of the Marlin flavour or UltiGCode, and rewrite its print.

    The file's own start and end are left out. What it prints between them keeps its path, speeds, fan and
    temperatures; moves become absolute, E counts mm of filament, arcs become straight moves of at most 1 mm,
    and G10 and G11 become moves of the feeder. Nothing else can get into the program.

    Parameters
    ----------
    lines
        The file's lines, read twice: a list, or an object that opens its file for each iteration.
    target
        Printer and material for which it is read.
    time_estimator
        New estimator that measures the time of the print, for the program's timeline.

    Raises
    ------
    GcodeRefused
        If the file cannot be printed; the message has the line, the reason, and the remedy.
    """
    survey = survey_lines(lines, target.filament_mm)
    line_mm = _find_line_width_mm(survey.nozzle_mm or target.nozzle_mm)
    writer = Writer(time_estimator)
    interpreter = _interpret_lines(lines, survey, writer, target, line_mm)
    extent = interpreter.head.extent
    _check_missing_lines(survey.figures, interpreter, target)
    ratio = _compute_section_ratio(extent, writer.layer_count, target, line_mm)
    completeness_warnings = (survey.warning,) if survey.warning is not None else ()
    warnings = completeness_warnings + check_machine(survey.machine, survey.nozzle_mm, ratio, target)
    print_time_s = writer.finish()
    return AcceptedGcode(
        gcode=_add_start_and_end(writer.text, interpreter, target),
        nozzle_mm=survey.nozzle_mm,
        nozzle_c=interpreter.nozzle_c,
        bed_c=interpreter.bed_c,
        print_time_s=print_time_s,
        filament_mm=extent.filament_mm,
        layers=writer.layer_count,
        min_mm=_to_point(extent.low_mm),
        max_mm=_to_point(extent.high_mm),
        reach_min_mm=_to_point(extent.reach_low_mm),
        reach_max_mm=_to_point(extent.reach_high_mm),
        filament_type=survey.machine.filament_type,
        notices=_build_notices(survey.is_ultigcode, interpreter.omitted_properties) + warnings,
    )


def _interpret_lines(
    lines: Iterable[bytes], survey: Survey, writer: Writer, target: PrintTarget, line_mm: float
) -> Interpreter:
    """Interpret all lines of a file, and write its print."""
    clearance = Clearance(SLACK_LAYERS * MAX_LAYER_SHARE * line_mm, target.printer.head)
    interpreter = Interpreter(survey, writer, clearance, target, line_mm)
    for number, raw_line in enumerate(lines, 1):
        interpreter.run_line(raw_line, number)
    interpreter.finish()
    return interpreter


def _check_missing_lines(figures: StatedFigures, interpreter: Interpreter, target: PrintTarget) -> None:
    """Refuse a file that lacks lines, judged by its slicer's figures and the filament that its moves feed."""
    extent = interpreter.head.extent
    problem = interpreter.gaps.describe_loss() or figures.describe_missing_height(
        extent.low_mm[2], extent.reach_high_mm[2]
    )
    if problem is None and figures.filament is not None:
        printed_mm = extent.filament_mm - extent.stray_filament_mm
        problem = figures.filament.describe_missing_filament(
            printed_mm, target.filament_mm2, extent.line_count
        )
    if problem is not None:
        raise GcodeRefused(f"{problem}: lines are missing; {EXPORT_ADVICE}")


def _find_line_width_mm(nozzle_mm: float | None) -> float:
    """Return the nozzle's diameter as the width of a line; refuse a file for an unknown nozzle."""
    if nozzle_mm is None:
        raise GcodeRefused(
            "it does not name the nozzle it was sliced for, and the printers have several: write a comment "
            "like `; nozzle_diameter = 0.4` into it, or choose a material or "
            "colour that only printers with one nozzle have"
        )
    return nozzle_mm


def _add_start_and_end(printed_lines: bytearray, interpreter: Interpreter, target: PrintTarget) -> bytes:
    """Put the farm's start and end code around the lines that are printed."""
    code = target.printer.code
    start = code.build_start_code(interpreter.nozzle_c, interpreter.bed_c, target.filament_mm2)
    return f";FLAVOR:Marlin\n{start}\n".encode() + printed_lines + code.build_end_code(0.0).encode() + b"\n"


def _compute_section_ratio(extent: Extent, layers: int, target: PrintTarget, nozzle_mm: float) -> float:
    """Compute the ratio of the mean cross-section of the lines to `nozzle_mm` times the layer height.

    Raises
    ------
    GcodeRefused
        If E does not count mm of this filament.
    """
    section_mm2 = extent.filament_mm * target.filament_mm2 / extent.path_mm
    # A spiral vase has no flat layers: its turns are marked, or assumed to be as high as the nozzle allows.
    mean_mm = min(extent.high_mm[2] / max(1, layers), MAX_LAYER_SHARE * nozzle_mm)
    layer_height_mm = max(extent.layer_height_mm, mean_mm)
    nominal_mm2 = nozzle_mm * layer_height_mm
    ratio = section_mm2 / nominal_mm2
    if not PLAUSIBLE_RATIOS[0] < ratio < PLAUSIBLE_RATIOS[1]:
        raise GcodeRefused(
            f"its lines have a mean cross-section of {section_mm2:.3f} mm2; layers of {layer_height_mm:.3g} "
            f"mm with a nozzle of {nozzle_mm:g} mm need about {nominal_mm2:.3f}: set the filament's diameter "
            f"to {target.filament_mm:.4g} mm in your slicer, and make it count E in mm, not in mm3"
        )
    return ratio


def _build_notices(is_ultigcode: bool, properties: dict[str, str]) -> tuple[str, ...]:
    lines = ["Its start and end were replaced by the farm's."]
    if is_ultigcode:
        lines.append("Converted from UltiGCode; temperatures are those of the printer's material.")
    if properties:
        omitted_codes = ", ".join(f"{code} ({properties[code]})" for code in sorted(properties))
        lines.append(f"Left out, because the printer has its own: {omitted_codes}.")
    return tuple(lines)


def _to_point(values: list[float]) -> tuple[float, float, float]:
    return (values[0], values[1], values[2])
