"""What CuraEngine's log and G-code say, and whether it may be printed.

CuraEngine answers most bad input with exit code 0 and a file that heats and homes and prints nothing, or a
part of the model; so every file is walked through before a printer sees it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from slicing.errors import Rule, SliceRejected

MIN_EXTRUSION_C = 170.0
"""Below it the firmware drops the filament's move and still makes the others (``EXTRUDE_MINTEMP``)."""
PARK_TOLERANCE_MM = 0.1
TOP_MM = 1.0
TIP_MM2 = 1.0
"""What may be missing at the top: `TOP_MM` of any shape, or a tip of any height, thinner than a line, whose
mean section is below `TIP_MM2`."""
BED_TOLERANCE_MM = 0.2
"""A brim is whole lines wide, and support may stand out of the part by half a line."""
_WORD = re.compile(r"([XYZEFS])([-+]?\d*\.?\d+)")
_WARNINGS = ("disconnected faces", "Face count")


@dataclass(frozen=True, slots=True)
class Facts:
    """What a walk through a G-code file found; coordinates are the printer's, in mm."""

    flavour: str
    print_time_s: float  # the layers, without heating, homing, start and end
    filament_mm: float  # without priming
    layer_count: int  # as the engine planned
    layers: int  # those with extrusion
    top_layer: int  # the index of the last one with extrusion
    min_mm: tuple[float, float, float]  # of all extrusion in layers, brim and support included
    max_mm: tuple[float, float, float]
    uses_firmware_retraction: bool
    moved_before_homing: bool
    extruded_cold: bool
    heaters_off: bool
    parked_mm: float  # how far the filament is drawn back at the end


class _Walk:
    """The printer's state while a file is walked through."""

    def __init__(self) -> None:
        self.position = {"X": 0.0, "Y": 0.0, "Z": 0.0, "E": 0.0}
        self.relative = False
        self.homed = False
        self.in_layers = False
        self.nozzle_c = self.bed_c = self.reached_c = 0.0
        self.flavour = ""
        self.time_s = 0.0
        self.layer_count = self.layers = self.layer = 0
        self.top_layer = -1
        self.layer_prints = False
        self.filament_mm = self.parked_mm = 0.0
        self.low = [math.inf] * 3
        self.high = [-math.inf] * 3
        self.firmware_retraction = self.moved_unhomed = self.extruded_cold = False

    def comment(self, line: str) -> None:
        if line.startswith(";TIME_ELAPSED:"):
            self.time_s = float(line[14:])
        elif line.startswith(";LAYER:"):
            self.in_layers, self.layer_prints = True, False
            self.layer = int(line[7:])
        elif line.startswith(";LAYER_COUNT:"):
            self.layer_count = int(line[13:])
        elif line.startswith(";FLAVOR:"):
            self.flavour = line[8:]

    def move(self, words: Sequence[tuple[str, str]]) -> None:
        old = dict(self.position)
        for axis, number in words:
            if axis in self.position:
                self.position[axis] = float(number) + (old[axis] if self.relative else 0.0)
        new = self.position
        moves = any(new[axis] != old[axis] for axis in "XYZ")
        pushed_mm = new["E"] - old["E"]
        self.moved_unhomed |= moves and not self.homed
        self.extruded_cold |= pushed_mm > 0 and min(self.reached_c, self.nozzle_c) < MIN_EXTRUSION_C
        if pushed_mm > 0 and moves and self.in_layers:
            self.filament_mm += pushed_mm
            self.parked_mm = 0.0
            self.layers += not self.layer_prints
            self.layer_prints, self.top_layer = True, self.layer
            for i, axis in enumerate("XYZ"):
                self.low[i] = min(self.low[i], old[axis], new[axis])
                self.high[i] = max(self.high[i], old[axis], new[axis])
        else:
            self.parked_mm -= pushed_mm

    def command(self, code: str, words: Sequence[tuple[str, str]]) -> None:
        value = next((float(number) for letter, number in words if letter == "S"), 0.0)
        match code:
            case "G0" | "G1":
                self.move(words)
            case "G28":
                self.homed = True
            case "G90" | "G91":
                self.relative = code == "G91"
            case "G92":
                self.position |= {a: float(n) for a, n in words if a in self.position}
            case "G10" | "G11":
                self.firmware_retraction = True
            case "M104" | "M109":
                self.nozzle_c = value
                if code == "M109":
                    self.reached_c = value
            case "M140" | "M190":
                self.bed_c = value


def _lines(gcode: str) -> Iterator[str]:
    start = 0
    while start < len(gcode):
        end = gcode.find("\n", start)
        end = len(gcode) if end < 0 else end
        yield gcode[start:end].strip()
        start = end + 1


def walk(gcode: str) -> Facts:
    """Go through a G-code file of the Marlin flavour, as the firmware of the Ultimaker 2+ would.

    Distances and the bounding box are of the moves' centre lines.
    """
    state = _Walk()
    for line in _lines(gcode):
        if line.startswith(";"):
            state.comment(line)
        elif line:
            code, _, rest = line.partition(";")[0].strip().partition(" ")
            state.command(code, _WORD.findall(rest))
    return Facts(
        flavour=state.flavour,
        print_time_s=state.time_s,
        filament_mm=state.filament_mm,
        layer_count=state.layer_count,
        layers=state.layers,
        top_layer=state.top_layer,
        min_mm=(state.low[0], state.low[1], state.low[2]),
        max_mm=(state.high[0], state.high[1], state.high[2]),
        uses_firmware_retraction=state.firmware_retraction,
        moved_before_homing=state.moved_unhomed,
        extruded_cold=state.extruded_cold,
        heaters_off=state.nozzle_c == 0.0 and state.bed_c == 0.0,
        parked_mm=state.parked_mm,
    )


Bed = tuple[tuple[float, float, float, float, float], ...]
"""Rectangles (min_x, min_y, max_x, max_y, height) in bed-centred mm; one of them must hold all extrusion."""


def check_log(log: str) -> None:
    """Raise SliceRejected where the engine warns of a mesh that it sliced only in part."""
    warning = next((line for line in log.splitlines() if any(w in line for w in _WARNINGS)), None)
    if warning is not None:
        raise SliceRejected(Rule.BROKEN_MESH, f"CuraEngine says {warning.strip()!r}; repair the mesh")


def check(
    facts: Facts,
    *,
    height_mm: float,
    missing_mm3: float,
    layer_height_mm: float,
    centre_mm: tuple[float, float],
    bed: Bed,
) -> None:
    """Raise SliceRejected, with the rule, unless the file may be printed.

    Parameters
    ----------
    height_mm
        Of the model that was sliced.
    missing_mm3
        Volume of the model above the highest extrusion.
    layer_height_mm
        The thickest layer: what a flat top may be off by is half of it.
    centre_mm
        The bed's centre in the printer's coordinates.
    """
    if facts.filament_mm <= 0 or facts.layers == 0:
        raise SliceRejected(
            Rule.NOTHING_PRINTED,
            "CuraEngine found nothing to print; the part is too thin or its mesh is open",
        )
    if facts.layers != facts.top_layer + 1:  # those above it are the next rule's business
        raise SliceRejected(
            Rule.LAYERS,
            f"only {facts.layers} of the first {facts.top_layer + 1} layers have something to print; "
            "repair the mesh",
        )
    missing_mm, over_mm = height_mm - facts.max_mm[2], layer_height_mm / 2 + 0.005
    if missing_mm < -over_mm or (missing_mm > TOP_MM and missing_mm3 / missing_mm > TIP_MM2):
        raise SliceRejected(
            Rule.HEIGHT, f"it is {facts.max_mm[2]:.2f} mm high, the model {height_mm:.2f} mm; repair the mesh"
        )
    _check_bed(facts, centre_mm, bed, over_mm)
    rules = (
        (
            Rule.FLAVOUR,
            facts.flavour == "Marlin" and not facts.uses_firmware_retraction,
            "not in Marlin's flavour",
        ),
        (Rule.HOMING, not facts.moved_before_homing, "a move comes before G28"),
        (
            Rule.COLD,
            not facts.extruded_cold,
            f"extrudes before the nozzle was waited for at {MIN_EXTRUSION_C:g} C",
        ),
        (Rule.HEATERS_ON, facts.heaters_off, "a heater is left on at the end"),
    )
    for rule, kept, detail in rules:
        if not kept:
            raise SliceRejected(rule, detail)


def check_parking(facts: Facts, parked_mm: float) -> None:
    """Raise SliceRejected unless the filament ends parked as the next print expects it."""
    if abs(facts.parked_mm - parked_mm) > PARK_TOLERANCE_MM:
        raise SliceRejected(
            Rule.PARKING, f"the filament ends {facts.parked_mm:.2f} mm back instead of {parked_mm:g} mm"
        )


def _check_bed(facts: Facts, centre_mm: tuple[float, float], bed: Bed, over_mm: float) -> None:
    low = [facts.min_mm[i] - centre_mm[i] for i in range(2)]
    high = [facts.max_mm[i] - centre_mm[i] for i in range(2)]
    slack = BED_TOLERANCE_MM
    for min_x, min_y, max_x, max_y, height in bed:
        inside = low[0] >= min_x - slack and low[1] >= min_y - slack
        inside &= high[0] <= max_x + slack and high[1] <= max_y + slack
        if inside and facts.max_mm[2] <= height + over_mm:
            return
    raise SliceRejected(
        Rule.OUTSIDE_BED,
        f"it prints on X {low[0]:.1f}..{high[0]:.1f}, Y {low[1]:.1f}..{high[1]:.1f}, up to Z "
        f"{facts.max_mm[2]:.1f} mm from the bed's centre, which the printer's room does not hold",
    )


_HEADER_END = "End of gcode header."


def with_header(gcode: str, log: str) -> str:
    """The G-code with its true header (time, filament, bounds), which the engine knows only afterwards."""
    _, found, rest = log.rpartition("Gcode header after slicing:")
    header, ended, _ = rest.partition(_HEADER_END)
    placeholder, generated, body = gcode.partition(";Generated with")
    if not (found and ended and generated) or not placeholder.startswith(";FLAVOR:"):
        return gcode
    return header.strip() + "\n\n" + generated + body
