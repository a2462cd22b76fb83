"""Rules that CuraEngine's log and G-code must meet to be printed.

For most bad input, CuraEngine ends with exit code 0 and writes a file that heats, homes and prints nothing,
or only a part of the model. Every file is therefore checked before it is printed.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slicing.checks.toolpath import NO_LAYER, Toolpath
from slicing.errors import OutsideBed, Rule, SliceRejected

END_RETRACTION_TOLERANCE_MM = 0.1
MAX_MISSING_TOP_MM = 1.0
"""Maximum height that may be missing if the outline is not compared."""
BED_TOLERANCE_MM = 0.2
"""Tolerance at the edges of a bed: a brim is whole lines wide, and support may exceed the part by half a
line."""
_BROKEN_MESH_WARNINGS = ("disconnected faces", "Face count")


@dataclass(frozen=True, slots=True)
class GcodeFacts:
    """Facts of a G-code file; coordinates are the printer's, in mm."""

    flavour: str
    sliced_s: float  # time of the layers, without heating, homing, start and end
    filament_mm: float  # without priming
    planned_layer_count: int  # number of layers that the engine planned
    layers: int  # number of layers with extrusion
    top_layer: int  # index of the last layer with extrusion
    min_mm: tuple[float, float, float]  # of all extrusion in layers, including brim and support
    max_mm: tuple[float, float, float]
    uses_firmware_retraction: bool
    moved_before_homing: bool
    extruded_cold: bool
    heaters_off: bool
    park_retraction_mm: float  # length of the end retraction of the filament


def gather_facts(toolpath: Toolpath, min_extrusion_c: float) -> GcodeFacts:
    """Collect the facts of a G-code file of the Marlin flavour.

    Distances and the bounding box refer to the centre lines of the moves.

    Parameters
    ----------
    toolpath
        The file's moves and commands.
    min_extrusion_c
        Nozzle temperature, in C, below which the firmware does not extrude.
    """
    extruded_mm, has_moved = toolpath.extruded_mm, toolpath.is_head_move
    is_printing = (extruded_mm > 0) & has_moved & (toolpath.layer != NO_LAYER)
    layers = toolpath.layer[is_printing]
    last = int(np.flatnonzero(is_printing)[-1]) if is_printing.any() else -1
    end_points = np.concatenate((toolpath.start[is_printing, :3], toolpath.end[is_printing, :3]))
    low_mm = end_points.min(axis=0, initial=math.inf)
    high_mm = end_points.max(axis=0, initial=-math.inf)
    first_move_after_homing = next(
        (command.next_move for command in toolpath.commands if command.code == "G28"), len(has_moved)
    )
    is_cold, heaters_off = _check_heat(toolpath, extruded_mm > 0, min_extrusion_c)
    return GcodeFacts(
        flavour=_read_last_comment(toolpath, "FLAVOR:"),
        sliced_s=float(_read_last_comment(toolpath, "TIME_ELAPSED:") or 0.0),
        filament_mm=float(extruded_mm[is_printing].sum()),
        planned_layer_count=int(_read_last_comment(toolpath, "LAYER_COUNT:") or 0),
        layers=len(np.unique(layers)),
        top_layer=int(layers[-1]) if len(layers) else -1,
        min_mm=(float(low_mm[0]), float(low_mm[1]), float(low_mm[2])),
        max_mm=(float(high_mm[0]), float(high_mm[1]), float(high_mm[2])),
        uses_firmware_retraction=any(command.code in ("G10", "G11") for command in toolpath.commands),
        moved_before_homing=bool(has_moved[:first_move_after_homing].any()),
        extruded_cold=is_cold,
        heaters_off=heaters_off,
        park_retraction_mm=float(-extruded_mm[last + 1 :].sum()),
    )


def _read_last_comment(toolpath: Toolpath, name: str) -> str:
    """Read the text after the last comment that begins with a name; empty if there is none."""
    return next(
        (
            comment.text[len(name) :]
            for comment in reversed(toolpath.comments)
            if comment.text.startswith(name)
        ),
        "",
    )


def _check_heat(
    toolpath: Toolpath, is_extruding: npt.NDArray[np.bool_], min_extrusion_c: float
) -> tuple[bool, bool]:
    """Check whether filament is extruded by a cold nozzle, and whether all heaters are off at the end."""
    target_c = {"M104": 0.0, "M140": 0.0}
    reached_c = 0.0
    first_move, is_cold = 0, False
    for command in toolpath.commands:
        if command.code not in ("M104", "M109", "M140", "M190"):
            continue
        if min(reached_c, target_c["M104"]) < min_extrusion_c:
            is_cold |= bool(is_extruding[first_move : command.next_move].any())
        first_move = command.next_move
        new_target_c = command.words.get("S", 0.0)
        target_c["M104" if command.code in ("M104", "M109") else "M140"] = new_target_c
        if command.code == "M109":
            reached_c = new_target_c
    if min(reached_c, target_c["M104"]) < min_extrusion_c:
        is_cold |= bool(is_extruding[first_move:].any())
    return is_cold, not any(target_c.values())


Bed = tuple[tuple[float, float, float, float, float], ...]
"""Rectangles (min_x, min_y, max_x, max_y, height) in bed-centred mm; one of them must hold all extrusion."""


def check_log(log: str) -> None:
    """Raise SliceRejected if the engine warns that it sliced only a part of the mesh."""
    warning = next((line for line in log.splitlines() if any(w in line for w in _BROKEN_MESH_WARNINGS)), None)
    if warning is not None:
        raise SliceRejected(Rule.BROKEN_MESH, f"CuraEngine says {warning.strip()!r}; repair the mesh")


def check_facts(
    facts: GcodeFacts,
    *,
    height_mm: float,
    removed_mm: float,
    is_top_checked: bool,
    layer_height_mm: float,
    min_extrusion_c: float,
) -> None:
    """Raise SliceRejected, with the broken rule, unless the file may be printed.

    Parameters
    ----------
    facts
        Facts of the file.
    height_mm
        Height of the model that was sliced.
    removed_mm
        Height of the empty layers that the engine removed at the bottom.
    is_top_checked
        Whether the outline is compared up to the top; otherwise `MAX_MISSING_TOP_MM` of the height may be
        missing.
    layer_height_mm
        Height of the thickest layer; a flat top may be off by half of it.
    min_extrusion_c
        Nozzle temperature, in C, below which the firmware does not extrude.
    """
    _check_layers(facts)
    missing_mm = height_mm - removed_mm - facts.max_mm[2]
    if (
        missing_mm < -(layer_height_mm / 2 + 0.005)
        or removed_mm > MAX_MISSING_TOP_MM
        or (missing_mm > MAX_MISSING_TOP_MM and not is_top_checked)
    ):
        raise SliceRejected(
            Rule.HEIGHT,
            f"the print is {facts.max_mm[2]:.2f} mm high, the model {height_mm:.2f} mm; repair the mesh, or "
            "turn the part if it stands on a tip",
        )
    _check_commands(facts, min_extrusion_c)


def _check_layers(facts: GcodeFacts) -> None:
    """Check that something is printed, in every layer up to the top one."""
    if facts.filament_mm <= 0 or facts.layers == 0:
        raise SliceRejected(
            Rule.NOTHING_PRINTED,
            "CuraEngine found nothing to print; the part is too thin or its mesh is open: thicken it, scale "
            "it up, or repair it",
        )
    # The outline check finds layers that are missing at the top.
    if not facts.layers == facts.top_layer + 1 <= facts.planned_layer_count:
        raise SliceRejected(
            Rule.LAYERS,
            f"only {facts.layers} of the first {facts.top_layer + 1} layers have something to print, and the "
            f"file's header says {facts.planned_layer_count}; repair the mesh, or turn the part if it "
            "stands on a tip",
        )


def _check_commands(facts: GcodeFacts, min_extrusion_c: float) -> None:
    """Check the flavour, and the order of homing, heating and extruding."""
    rules = (
        (
            Rule.FLAVOUR,
            facts.flavour == "Marlin" and not facts.uses_firmware_retraction,
            "the G-code is not in Marlin's flavour; leave machine_gcode_flavor and machine_firmware_retract "
            "as they are",
        ),
        (
            Rule.HOMING,
            not facts.moved_before_homing,
            "a move comes before G28; leave the start code as it is",
        ),
        (
            Rule.COLD_EXTRUSION,
            not facts.extruded_cold,
            f"the G-code extrudes before it waits for the nozzle to reach {min_extrusion_c:g} C; set a "
            "higher material_print_temperature",
        ),
        (
            Rule.HEATERS_ON,
            facts.heaters_off,
            "a heater is left on at the end, or the end is missing; slice again, or free space on the disk",
        ),
    )
    for rule, is_met, detail in rules:
        if not is_met:
            raise SliceRejected(rule, detail)


def check_end_retraction(facts: GcodeFacts, park_retraction_mm: float) -> None:
    """Raise SliceRejected unless the filament is retracted at the end as the next print expects.

    Parameters
    ----------
    facts
        Facts of the file.
    park_retraction_mm
        Required length of the end retraction.
    """
    if abs(facts.park_retraction_mm - park_retraction_mm) > END_RETRACTION_TOLERANCE_MM:
        raise SliceRejected(
            Rule.PARKING,
            f"the filament is retracted {facts.park_retraction_mm:.2f} mm at the end instead of "
            f"{park_retraction_mm:g} mm; leave the end code and retraction_amount as they are",
        )


def check_bed(facts: GcodeFacts, centre_mm: tuple[float, float], bed: Bed, max_excess_mm: float) -> None:
    """Raise OutsideBed unless a rectangle of the bed holds all extrusion, including brim and support.

    Parameters
    ----------
    facts
        Facts of the file.
    centre_mm
        The bed's centre in the printer's coordinates.
    bed
        Rectangles of the bed.
    max_excess_mm
        Height by which the last layer, which is printed whole, may exceed the build height.
    """
    low_mm = (facts.min_mm[0] - centre_mm[0], facts.min_mm[1] - centre_mm[1])
    high_mm = (facts.max_mm[0] - centre_mm[0], facts.max_mm[1] - centre_mm[1])
    height_mm = facts.max_mm[2]
    tolerance_mm = BED_TOLERANCE_MM
    for min_x, min_y, max_x, max_y, max_height_mm in bed:
        is_inside = low_mm[0] >= min_x - tolerance_mm and low_mm[1] >= min_y - tolerance_mm
        is_inside &= high_mm[0] <= max_x + tolerance_mm and high_mm[1] <= max_y + tolerance_mm
        if is_inside and height_mm <= max_height_mm + max_excess_mm:
            return
    raise OutsideBed(
        f"the G-code prints on X {low_mm[0]:.1f}..{high_mm[0]:.1f}, Y {low_mm[1]:.1f}..{high_mm[1]:.1f}, "
        f"up to Z {height_mm:.1f} mm, from the bed's centre, outside the printer's build volume; scale it "
        "down, or choose a narrower brim",
        low_mm,
        high_mm,
        height_mm - max_excess_mm,
    )


_HEADER_END = "End of gcode header."
_HEADER_TIME = re.compile(r"(?m)^;TIME:.*$")
_HEADER_FILAMENT = re.compile(r"(?m)^;Filament used: .*$")
_HEADER_HEIGHT = re.compile(r"(?m)^;MAXZ:.*$")


def replace_header(
    gcode: bytes,
    log: str,
    sliced_s: float,
    *,
    filament_mm: float | None = None,
    height_mm: float | None = None,
) -> bytes:
    """Replace the placeholder header with the one in the log (bounds, layer height).

    Parameters
    ----------
    gcode
        CuraEngine's output, with a placeholder header.
    log
        CuraEngine's log; the G-code is not changed if the log has no header.
    sliced_s
        Time of the layers, in place of the one in the log.
    filament_mm
        Length of filament, in place of the one in the log; None keeps that one.
    height_mm
        Greatest height, in place of the one in the log; None keeps that one.
    """
    _, separator, rest = log.rpartition("Gcode header after slicing:")
    header, header_end, _ = rest.partition(_HEADER_END)
    placeholder, generator_mark, body = gcode.partition(b";Generated with")
    if not (separator and header_end and generator_mark) or not placeholder.startswith(b";FLAVOR:"):
        return gcode
    header = _HEADER_TIME.sub(f";TIME:{int(sliced_s)}", header)
    if filament_mm is not None:
        header = _HEADER_FILAMENT.sub(f";Filament used: {filament_mm / 1000.0:.6g}m", header)
    if height_mm is not None:
        header = _HEADER_HEIGHT.sub(f";MAXZ:{round(height_mm, 3):g}", header)
    return header.strip().encode() + b"\n\n" + generator_mark + body


_REMOVED_LAYERS = re.compile(r"Removing (\d+) layers because they are empty")


def count_removed_layers(log: str) -> int:
    """Count the empty layers that the engine removed at the bottom."""
    match = _REMOVED_LAYERS.search(log)
    return int(match[1]) if match else 0
