"""Lists of the commands in a person's own G-code that are executed, left out, or refused.

Executed commands are an allow-list: every other command is refused within a print. The start and the end of
a file are not executed: only commands that change the meaning of the whole file are refused there.
"""

from __future__ import annotations

import re

_SCRIPT_ADVICE = "remove it from your slicer's start, end or layer script"

EXECUTED_COMMANDS = frozenset(
    (
        *("G0", "G1", "G2", "G3", "G4", "G10", "G11", "G90", "G91", "G92"),
        *("M82", "M83", "M104", "M109", "M140", "M190", "M106", "M107", "M220", "M221"),
    )
)
"""Commands that are executed; the lines for the printer are written by `slicing.own_gcode.writer`."""

# Word that switches volumetric extrusion off, which is the default.
_VOLUMETRIC_OFF_WORD = re.compile(r"\s*D\s?0*\.?0*\s*")

COMMANDS_WITHOUT_EFFECT = frozenset(
    (
        *("G17", "G21", "T0", "M17", "M73", "M75", "M76", "M77", "M105", "M110", "M113", "M114", "M115"),
        *("M117", "M118", "M119", "M155", "M240", "M300", "M355", "M400", "M486", "M531", "M532"),
    )
)
"""Commands that change nothing in a print: texts, beeps, queries."""

OMITTED_PROPERTIES = {
    "M204": "acceleration",
    "M205": "jerk",
    "M566": "jerk",
    "M572": "pressure advance",
    "M900": "linear advance",
    "M413": "power-loss recovery",
}
"""Commands left out with a notice, and the property of each: the printer's own values are used."""

_PAUSE_REASON = f"waits for somebody to press the knob: {_SCRIPT_ADVICE}"
_CARD_REASON = f"belongs to the SD card: {_SCRIPT_ADVICE}"
_EEPROM_REASON = f"changes the printer's stored settings: {_SCRIPT_ADVICE}"
_OFFSET_REASON = f"shifts the printer's coordinates: {_SCRIPT_ADVICE}, and place the model in the slicer"
_PID_REASON = f"changes how the heaters are controlled: {_SCRIPT_ADVICE}"

REFUSED_COMMANDS = {
    "G20": "sets the units to inches: set your slicer to millimetres",
    "M0": _PAUSE_REASON,
    "M1": _PAUSE_REASON,
    "M226": _PAUSE_REASON,
    "M600": f"asks for a manual filament change: {_SCRIPT_ADVICE}",
    "M601": _PAUSE_REASON,
    "M25": _PAUSE_REASON,
    "M80": f"switches the power: {_SCRIPT_ADVICE}",
    "M92": f"changes the steps per millimetre: {_SCRIPT_ADVICE}",
    "M112": f"is an emergency stop: {_SCRIPT_ADVICE}",
    "M200": "sets the unit of extrusion to mm3: switch volumetric extrusion off in your slicer",
    "M206": _OFFSET_REASON,
    "M428": _OFFSET_REASON,
    "M851": _OFFSET_REASON,
    "M301": _PID_REASON,
    "M303": _PID_REASON,
    "M304": _PID_REASON,
    "M302": f"lets the printer extrude cold: {_SCRIPT_ADVICE}",
    "M500": _EEPROM_REASON,
    "M501": _EEPROM_REASON,
    "M502": _EEPROM_REASON,
    "M504": _EEPROM_REASON,
    "M997": f"replaces the firmware: {_SCRIPT_ADVICE}",
    "M999": f"restarts a printer that stopped with an error: {_SCRIPT_ADVICE}",
    **{f"M{n}": _CARD_REASON for n in (*range(20, 25), *range(26, 33), 923, 928)},
}
"""Commands refused anywhere in a file, with the reason."""

_REASONS_IN_PRINT = {
    "G28": "homes in the middle of the print: remove it from your slicer's layer script",
    "M84": "switches the motors off in the middle of the print: remove it from your slicer's layer script",
    "M18": "switches the motors off in the middle of the print: remove it from your slicer's layer script",
    "M201": f"changes the printer's limits: {_SCRIPT_ADVICE}",
    "M203": f"changes the printer's limits: {_SCRIPT_ADVICE}",
    "M81": f"switches the power off: {_SCRIPT_ADVICE}",
}


END_COMMANDS = frozenset(("G28", "M84", "M18", "M81", "M2"))
"""Commands that mark the beginning of the end script, if nothing is printed after them."""


def has_no_effect(code: str, rest: str) -> bool:
    """Check whether a command changes nothing in a print; `rest` is the text after its code."""
    return code in COMMANDS_WITHOUT_EFFECT or (
        code == "M200" and _VOLUMETRIC_OFF_WORD.fullmatch(rest) is not None
    )


def find_refusal(code: str) -> str | None:
    """Find the reason why a command is refused anywhere in a file; None if it is not."""
    if code[0] == "T" and code != "T0":
        return "selects another extruder, but the printer has only one: slice for a single extruder"
    return REFUSED_COMMANDS.get(code)


def find_refusal_in_print(code: str) -> str:
    """Find the reason why a command is refused within a print."""
    return _REASONS_IN_PRINT.get(code, "is not supported during a print: remove it")
