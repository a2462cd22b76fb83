"""Survey of a file before its first line is run: its facts, and the line where its print begins."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from slicing.errors import GcodeRefused
from slicing.gcode_lines import parse_plain_move, split_line
from slicing.own_gcode import command_rules
from slicing.own_gcode.completeness import CompletenessReader, StatedFigures
from slicing.own_gcode.machine import FOREIGN_START_COMMANDS, Machine, find_machine

FILAMENT_DEVIATION_MM = (-0.1, 0.2)
"""Accepted deviation of the filament's diameter: filament of 2.85 mm is also sold as 3 mm."""
EXPORT_ADVICE = "export it once more, or copy it again"
_LAYER = re.compile(
    rb"LAYER:\s*-?\d+\Z|LAYER_CHANGE\b|CHANGE_LAYER\b|layer \d+, Z ?=|BEGIN_LAYER_OBJECT\b", re.IGNORECASE
)
"""Marks of a layer's start by Cura, PrusaSlicer and its forks, Simplify3D and KISSlicer."""
_MARLIN_FLAVOURS = ("marlin", "marlin2", "marlin(marlin/sprinter)", "reprap", "repetier", "sprinter")
_METADATA = re.compile(
    rb"(FLAVOR|NOZZLE_DIAMETER|nozzle_diameter|extruderDiameter|filament_diameter|filamentDiameters"
    rb"|use_volumetric_e|gcode_flavor|Nozzle Diameter #1|Filament Diameter #1|fiber_dia_mm|filament_type"
    rb"|Filament Type #1|TARGET_MACHINE\.NAME|printer_model|printer_name|machine_name|printer_settings_id"
    rb"|bed_shape|printable_area)\s*[:=,]\s*([^,;|]*)"
)
_FILAMENT_KEYS = ("filament_diameter", "filamentdiameters", "filament diameter #1", "fiber_dia_mm")


@dataclass(frozen=True, slots=True)
class Survey:
    """Facts of a file.

    Attributes
    ----------
    is_ultigcode
        Whether the file is UltiGCode: E in mm3, and no start code.
    nozzle_mm
        Nozzle that the file was sliced for; None if it does not say.
    first_line
        Number of the line with which the print begins.
    marks_layers
        Whether comments mark where layers begin.
    has_closing_mark
        Whether the slicer's closing mark comes after the last printed line; False for a slicer without one.
    machine
        The machine that it was sliced for.
    warning
        Warning of missing layers in a file with its closing mark; None if no layer is missing.
    figures
        Figures that the slicer states for the layers.
    """

    is_ultigcode: bool
    nozzle_mm: float | None
    first_line: int
    marks_layers: bool
    has_closing_mark: bool
    machine: Machine
    warning: str | None
    figures: StatedFigures


def is_layer_mark(comment: bytes) -> bool:
    """Check whether a comment marks the start of a layer."""
    return _LAYER.match(comment) is not None


def survey_lines(lines: Iterable[bytes], filament_mm: float) -> Survey:
    """Gather the facts of a file in one pass.

    Parameters
    ----------
    lines
        The file's lines.
    filament_mm
        Diameter of the printer's filament.

    Raises
    ------
    GcodeRefused
        If the file is for another kind of printer, the start of its print cannot be found, or its end is
        missing.
    """
    scan = _Scan()
    for number, raw_line in enumerate(lines, 1):
        scan.read_line(raw_line, number)
    is_ultigcode = _is_ultigcode(scan.metadata, filament_mm)
    if not scan.layer_line and (is_ultigcode or not (scan.wait_line and scan.home_line)):
        raise GcodeRefused(
            "the start of its print cannot be found: make your slicer write ;LAYER:0 where a layer begins "
            "(as layer change G-code), or use a start script that homes (G28) and heats the nozzle (M109)"
        )
    incompleteness = scan.completeness.describe_incompleteness(scan.last_line, scan.print_line)
    if incompleteness is not None:
        raise GcodeRefused(
            f"line {scan.number}: the file ends here, before the print does: {incompleteness}; "
            f"{EXPORT_ADVICE}"
        )
    return Survey(
        is_ultigcode=is_ultigcode,
        nozzle_mm=_read_number(scan.metadata, "nozzle_diameter", "extruderdiameter", "nozzle diameter #1"),
        first_line=scan.layer_line or scan.ready_line + 1,
        marks_layers=bool(scan.layer_line),
        has_closing_mark=bool(scan.completeness.has_closing_mark(scan.print_line)),
        warning=scan.completeness.build_warning(),
        figures=scan.completeness.figures,
        machine=find_machine(
            scan.metadata, _read_number(scan.metadata, *_FILAMENT_KEYS), scan.foreign_command
        ),
    )


class _Scan:
    """Facts of a file, gathered line by line; a line number is 0 if there is no such line.

    Attributes
    ----------
    metadata
        Values from comments, as written, by their keys in lower case.
    layer_line
        First line that marks a layer.
    wait_line, home_line, ready_line
        Last lines before the print: the last one that waits for the nozzle, the last one that homes, and the
        last one that does either of these or waits for the bed.
    print_line
        Last line that extrudes while the head moves.
    number, last_line
        Number of the last line, and the line itself.
    foreign_command
        Line number and code of the first command that only another machine has; None if there is none.
    """

    def __init__(self) -> None:
        self.metadata: dict[str, bytes] = {}
        self.layer_line = self.wait_line = self.home_line = self.ready_line = 0
        self.print_line = self.number = 0
        self.last_line = b"\n"
        self.completeness = CompletenessReader()
        self.foreign_command: tuple[int, str] | None = None

    def read_line(self, raw_line: bytes, number: int) -> None:
        """Read one line."""
        self.number, self.last_line = number, raw_line
        if (move := parse_plain_move(raw_line)) is not None:
            if "E" in move and ("X" in move or "Y" in move):
                self.print_line = number
            return
        code, rest, comment = split_line(raw_line, number)
        if comment:
            self._read_comment(comment)
        if not code or command_rules.has_no_effect(code, rest):
            return
        if (reason := command_rules.find_refusal(code)) is not None:
            raise GcodeRefused(f"line {number}: {code} {reason}")
        if code in ("G0", "G1", "G2", "G3"):
            if "E" in rest and ("X" in rest or "Y" in rest):
                self.print_line = number
        elif code == "M221" and rest.split()[:1] != ["S100"]:
            self.completeness.record_flow_change()
        elif not self.print_line:
            self._read_start(code)

    def _read_comment(self, comment: bytes) -> None:
        self.completeness.read_comment(comment, self.number)
        if is_layer_mark(comment):
            self.layer_line = self.layer_line or self.number
            self.completeness.count_layer()
        elif (entry := _METADATA.match(comment)) is not None:
            self.metadata[entry[1].decode().lower()] = entry[2].strip()

    def _read_start(self, code: str) -> None:
        """Read a command before the first line that prints."""
        if self.foreign_command is None and code in FOREIGN_START_COMMANDS:
            self.foreign_command = (self.number, code)
        if code == "M109":
            self.wait_line = self.number
        if code == "G28":
            self.home_line = self.number
        if code in ("M109", "M190", "G28"):
            self.ready_line = self.number


def _is_ultigcode(metadata: dict[str, bytes], filament_mm: float) -> bool:
    """Check whether a file is UltiGCode; refuse an unknown flavour, volumetric E, or other filament."""
    flavour = (metadata.get("flavor") or metadata.get("gcode_flavor") or b"Marlin").decode("ascii", "replace")
    if flavour == "UltiGCode":
        return True
    if flavour.lower() not in _MARLIN_FLAVOURS:
        raise GcodeRefused(
            f"its flavour is {flavour!r}: set the G-code flavour to Marlin in your slicer "
            "(Cura: Preferences > Printers > Machine Settings), or to UltiGCode"
        )
    if metadata.get("use_volumetric_e") == b"1":
        raise GcodeRefused("it counts filament in mm3: switch off `Use volumetric E` in your slicer")
    diameter_mm = _read_number(metadata, *_FILAMENT_KEYS)
    min_difference_mm, max_difference_mm = FILAMENT_DEVIATION_MM
    if (
        diameter_mm is not None
        and not min_difference_mm <= round(diameter_mm - filament_mm, 3) <= max_difference_mm
    ):
        raise GcodeRefused(
            f"it was sliced for filament of {diameter_mm:g} mm: set the filament's diameter to "
            f"{filament_mm:.4g} mm"
        )
    return False


def _read_number(metadata: dict[str, bytes], *names: str) -> float | None:
    """Read the first of these values that is a number other than 0."""
    for name in names:
        try:
            if value := float(metadata[name]):
                return value
        except (KeyError, ValueError):
            continue
    return None
