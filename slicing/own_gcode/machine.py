"""Machine that a file was sliced for, and whether the file still fits the farm's printer."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from slicing.errors import GcodeRefused
from slicing.gcode_lines import quote_text
from slicing.own_gcode.target import PrintTarget

_NAME_KEYS = ("target_machine.name", "printer_model", "printer_name", "machine_name", "printer_settings_id")
"""Keys of the machine's name in files of Cura, PrusaSlicer and its forks, and KISSlicer. The value of the
last one is the name of a person's settings, used if no model is named."""
_PLACEHOLDER_NAMES = ("", '""', "unknown", "default", "- default fff printer -")
_USUAL_RATIOS = (0.5, 1.7)
"""Usual ratio of the lines' cross-section to that of a line as wide as the nozzle: 0.75 to 1.4 in slices of
CuraEngine 4.13, and thus 2.0 and more in slices for filament of 1.75 mm."""

FOREIGN_START_COMMANDS = {
    "G29": "probes the bed",
    "G34": "levels its two Z screws",
    "G80": "probes the bed",
    "M420": "uses a probed bed",
    "M569": "sets up its motor drivers",
    "M906": "sets the current of its motors",
    "M862.1": "checks its nozzle",
    "M862.2": "checks its model",
    "M862.3": "checks its model",
}
"""Commands of start scripts for hardware that the farm's printers do not have."""


@dataclass(frozen=True, slots=True)
class Machine:
    """Machine that a file was sliced for, according to its comments.

    Attributes
    ----------
    name
        Name that the slicer gives it; None if there is none.
    filament_mm
        The filament's diameter; None if the file does not say.
    filament_type
        Material, such as PLA; None if the file does not say.
    bed_corner
        First corner of its bed, as written; None if the file does not say.
    foreign_command
        Line number and code of a command in its start that the farm's printers do not have; None if there is
        none.
    """

    name: str | None
    filament_mm: float | None
    filament_type: str | None
    bed_corner: str | None
    foreign_command: tuple[int, str] | None


def find_machine(
    metadata: Mapping[str, bytes], filament_mm: float | None, foreign_command: tuple[int, str] | None
) -> Machine:
    """Read the machine from a file's metadata.

    Parameters
    ----------
    metadata
        Values as written, by their keys in lower case.
    filament_mm
        The filament's diameter; None if the file does not say.
    foreign_command
        Line number and code of a command that the farm's printers do not have; None if there is none.
    """
    names = (_read_text(metadata, key) for key in _NAME_KEYS)
    name = next((name for name in names if name is not None and name.lower() not in _PLACEHOLDER_NAMES), None)
    return Machine(
        name=name,
        filament_mm=filament_mm,
        filament_type=_read_text(metadata, "filament_type") or _read_text(metadata, "filament type #1"),
        bed_corner=_read_text(metadata, "bed_shape") or _read_text(metadata, "printable_area"),
        foreign_command=foreign_command,
    )


def check_machine(
    machine: Machine, nozzle_mm: float | None, section_ratio: float, target: PrintTarget
) -> tuple[str, ...]:
    """Refuse a file that does not fit the printer; return warnings about a file that probably fits.

    The size of the print is checked elsewhere.

    Parameters
    ----------
    machine
        The machine that the file was sliced for.
    nozzle_mm
        The nozzle that the file was sliced for; None if it does not say.
    section_ratio
        Ratio of the cross-section of its lines to that of a line as wide as the nozzle.
    target
        The printer on which it would be printed.

    Raises
    ------
    GcodeRefused
        If it does not fit, or nothing shows that it does.
    """
    name, reason, title = machine.name, None, target.printer.title
    if name is not None and re.search(target.printer.slicer_names, name.lower()):
        name = None
    is_usual = _USUAL_RATIOS[0] < section_ratio < _USUAL_RATIOS[1]
    if name is None and (is_usual or nozzle_mm is not None):
        return ()
    if name is None:
        return (
            f"Warning: its lines have {section_ratio:.1f} times the cross-section of a line as wide as the "
            "nozzle: was it sliced for another nozzle?",
        )
    if machine.foreign_command is not None:
        number, code = machine.foreign_command
        reason = f"line {number}: {code} {FOREIGN_START_COMMANDS[code]}"
    elif machine.bed_corner not in (None, "0x0"):
        reason = f"its bed begins at {quote_text(machine.bed_corner or '')}"
    elif machine.filament_mm is None and not is_usual:
        filament = f"filament of {target.filament_mm:.4g} mm"
        reason = f"its lines have {section_ratio:.1f} times the usual cross-section, with {filament}"
    if reason is not None:
        raise GcodeRefused(f"it was sliced for {quote_text(name)} ({reason}): slice it for the {title}")
    return (
        f"Warning: it was sliced for {quote_text(name)}. Its size, its filament and its start fit the "
        f"{title}; speeds and temperatures are that machine's.",
    )


def _read_text(metadata: Mapping[str, bytes], key: str) -> str | None:
    value = metadata.get(key)
    return value.decode("utf-8", "replace").strip().strip('"') or None if value is not None else None
