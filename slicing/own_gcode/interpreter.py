"""Interpreter of a person's own G-code, by the rules of the printer's firmware."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from slicing.errors import GcodeRefused
from slicing.gcode_lines import Words, parse_plain_move, parse_words, split_line
from slicing.own_gcode import command_rules
from slicing.own_gcode.clearance import Clearance
from slicing.own_gcode.completeness import LayerGaps, read_layer_number
from slicing.own_gcode.head import MAX_CROSS_SECTION_RATIO, Head
from slicing.own_gcode.objections import Objections
from slicing.own_gcode.survey import Survey, is_layer_mark
from slicing.own_gcode.target import PrintTarget
from slicing.own_gcode.writer import Writer

Point = tuple[float, float]

MAX_DWELL_S = 60.0
"""Maximum pause in one place: the nozzle is hot, and a cancellation has to wait for the end of the pause."""
MAX_PAUSES_S = 3600.0
"""Maximum sum of all pauses."""
MAX_ARC_MM = 700.0
"""Maximum length of an arc: once around the whole bed."""
ARC_TOLERANCE_MM = 0.2
"""Maximum difference between an arc's radius at its start and at its end."""
MAX_CHORD_MM = 1.0
"""Maximum length of the straight moves of an arc: the firmware's ``MM_PER_ARC_SEGMENT``."""
CHORD_DEVIATION_MM = 0.01
_INITIAL_SPEED_MM_S = 25.0  # speed of the firmware before the first F
_FAN_OFF_LINE = b"M107"
_FEATURE = re.compile(rb"TYPE:[A-Z-]{1,20}\Z")  # Cura's comments that name the printed feature


class Interpreter:
    """Interpreter of lines, with the printer's modes and temperatures; it prints from `survey.first_line` on.

    Parameters
    ----------
    nozzle_mm
        Nozzle that the file was sliced for.

    Attributes
    ----------
    head
        Position of the head, and the extent of its print.
    gaps
        Search for missing lines, between layers and within them.
    nozzle_c, bed_c
        Temperatures as last set before the print, in C.
    omitted_properties
        Commands that were left out, each with the property that it would change.
    """

    def __init__(
        self, survey: Survey, writer: Writer, clearance: Clearance, target: PrintTarget, nozzle_mm: float
    ) -> None:
        self.nozzle_c = target.nozzle_c if survey.is_ultigcode else 0.0
        self.bed_c = target.bed_c if survey.is_ultigcode else 0.0
        self.omitted_properties: dict[str, str] = {}
        self._objections = Objections()
        self.gaps = LayerGaps(MAX_CROSS_SECTION_RATIO * nozzle_mm**2 / target.filament_mm2)
        self.head = Head(
            target.printer.code,
            writer,
            clearance,
            self._objections,
            self.gaps,
            marks_layers=survey.marks_layers,
        )
        self._survey = survey
        self._writer = writer
        self._printer = target.printer
        self._mm_per_e = 1 / target.filament_mm2 if survey.is_ultigcode else 1.0
        self._e = 0.0  # in the file's unit
        self._is_relative = self._is_relative_e = False
        self._speed_mm_s = _INITIAL_SPEED_MM_S
        self._speed_factor = self._flow_factor = 1.0
        self._is_retracted = False  # by G10
        self._total_dwell_s = self._dwell_s = 0.0  # of all pauses, and of those since the last printed line
        self._fan_line: bytes = _FAN_OFF_LINE

    def run_line(self, raw_line: bytes, number: int) -> None:
        """Run one line.

        Parameters
        ----------
        raw_line
            The line as it is in the file.
        number
            Its number, from 1.

        Raises
        ------
        GcodeRefused
            If the line cannot be read, or must not be printed.
        """
        self._objections.line = number
        if number != self._survey.first_line and (move := parse_plain_move(raw_line)) is not None:
            self._move(move)
            return
        code, rest, comment = split_line(raw_line, number)
        if number == self._survey.first_line:
            self._begin_print()
        if self._is_printing and is_layer_mark(comment):
            self._writer.begin_layer()
            if (layer := read_layer_number(comment)) is not None:
                self.gaps.begin_layer(layer)
        elif self._is_printing and _FEATURE.match(comment):
            self._writer.add_line(b";" + comment)
        if not code or command_rules.has_no_effect(code, rest):
            return
        if (reason := command_rules.find_refusal(code)) is not None:
            raise GcodeRefused(f"line {number}: {code} {reason}")
        if code in command_rules.OMITTED_PROPERTIES:
            self.omitted_properties[code] = command_rules.OMITTED_PROPERTIES[code]
        elif code in command_rules.EXECUTED_COMMANDS:
            self._run_command(code, parse_words(rest, number))
        elif code == "G28" and not self._is_printing:
            self.head.forget_position()
        elif self._is_printing:
            reason = f"{code} {command_rules.find_refusal_in_print(code)}"
            self._objections.add_except_at_end(reason, ends_print=code in command_rules.END_COMMANDS)

    def finish(self) -> None:
        """Check the end of the file, after its last line has been run.

        Raises
        ------
        GcodeRefused
            If it prints nothing, or does not end with an end script.
        """
        if not self.head.extent.path_mm:
            raise GcodeRefused(
                self._objections.first_reason or "it prints nothing: no move after its start extrudes"
            )
        self._objections.check_end(self._survey.has_closing_mark)

    @property
    def _is_printing(self) -> bool:
        return self._objections.is_printing

    def _begin_print(self) -> None:
        self._objections.is_printing = True
        if self.nozzle_c < self._printer.limits.min_extrusion_c:
            self._objections.refuse(
                "the print begins here, and no M104 or M109 before it has set the nozzle's temperature: "
                "add it to your slicer's start script"
            )
        self.head.begin_print(self._printer.retraction_mm_s)
        if self._fan_line != _FAN_OFF_LINE:
            self._writer.add_line(self._fan_line)
        if not self._survey.marks_layers:
            self._writer.begin_layer()

    def _run_command(self, code: str, words: Words) -> None:
        match code:
            case "G0" | "G1":
                self._move(words)
            case "G2" | "G3":
                self._move_on_arc(code == "G2", words)
            case "G4":
                self._wait(words)
            case "G10" | "G11":
                self._retract(code, words)
            case "G90" | "G91":
                self._is_relative = code == "G91"
            case "G92":
                self._reset_e(words)
            case "M82" | "M83":
                self._is_relative_e = code == "M83"
            case "M104" | "M109" | "M140" | "M190":
                self._heat(code, words)
            case "M106" | "M107":
                self._set_fan(code, words)
            case "M220":
                self._speed_factor = self._parse_factor(code, words, 0.1, 5.0)
            case "M221":
                self._flow_factor = self._parse_factor(code, words, 0.1, 3.0)

    def _move(self, words: Words) -> None:
        self._set_speed(words)
        self._move_to(self._find_target(words), self._find_extruded_mm(words))

    def _move_to(self, target: list[float], extruded_mm: float, speed_mm_s: float | None = None) -> None:
        if self.head.move(target, extruded_mm, speed_mm_s or self._speed_mm_s, self._speed_factor):
            self._dwell_s = 0.0

    def _find_target(self, words: Words) -> list[float]:
        return [
            current if (value := words.get(axis)) is None else value + (current if self._is_relative else 0.0)
            for axis, current in zip("XYZ", self.head.position_mm, strict=True)
        ]

    def _find_extruded_mm(self, words: Words) -> float:
        """Compute the filament that a move extrudes, in mm; the firmware treats E as relative after G91."""
        e = words.get("E")
        if e is None:
            return 0.0
        difference = e if self._is_relative or self._is_relative_e else e - self._e
        self._e += difference
        return difference * self._mm_per_e * self._flow_factor

    def _move_on_arc(self, is_clockwise: bool, words: Words) -> None:
        self._set_speed(words)
        x, y, z = self.head.position_mm
        i, j = words.get("I", 0.0), words.get("J", 0.0)
        if "R" in words or not (i or j):
            self._objections.refuse("an arc needs I and J: switch arc fitting off in your slicer")
        end = self._find_target(words)
        extruded_mm, previous_share = self._find_extruded_mm(words), 0.0
        if math.isnan(x + y + end[0] + end[1]):
            self.head.position_mm = end
            self._objections.add("an arc starts at an unknown position: the file has not set X and Y yet")
            return
        arc = Arc((x, y), (end[0], end[1]), (x + i, y + j), is_clockwise)
        if arc.length_mm > MAX_ARC_MM or abs(arc.end_radius_mm - arc.radius_mm) > ARC_TOLERANCE_MM:
            self._objections.refuse("no printer can make this arc: is the file damaged?")
        for (to_x, to_y), share in arc.sample_points():
            self._move_to([to_x, to_y, z + (end[2] - z) * share], extruded_mm * (share - previous_share))
            previous_share = share

    def _wait(self, words: Words) -> None:
        seconds = words.get("S", words.get("P", 0.0) / 1000)
        if self._is_printing and seconds > 0:
            self._total_dwell_s += seconds
            self._dwell_s += seconds
            if self._dwell_s > MAX_DWELL_S:
                self._objections.add(
                    f"G4 waits {self._dwell_s:g} s in one place; the limit is {MAX_DWELL_S:g} s"
                )
            elif self._total_dwell_s > MAX_PAUSES_S:
                self._objections.add(
                    f"the pauses of G4 add up to {self._total_dwell_s:g} s; the limit is {MAX_PAUSES_S:g} s"
                )
            else:
                self._writer.add_dwell(seconds)

    def _retract(self, code: str, words: Words) -> None:
        if words.keys() - {"S"}:
            self._objections.add(f"{code} with {' '.join(words)} is not a retraction: remove it")
        elif self._is_retracted != (code == "G10"):
            self._is_retracted = not self._is_retracted
            length_mm = self._printer.retraction_mm
            extruded_mm = -length_mm if self._is_retracted else length_mm
            self._move_to(self.head.position_mm, extruded_mm, self._printer.retraction_mm_s)

    def _reset_e(self, words: Words) -> None:
        if words.keys() == {"E"}:
            self._e = words["E"]
        else:
            self._objections.add_mode_change("G92 may reset E only: remove it from your slicer's scripts")

    def _heat(self, code: str, words: Words) -> None:
        if not words.keys() & {"S", "R"}:
            self._objections.refuse(f"{code} gives no temperature: write it after S")
        target_c = float(round(words["S" if "S" in words else "R"]))
        is_nozzle = code in ("M104", "M109")
        limits = self._printer.limits
        max_c = limits.max_nozzle_c if is_nozzle else limits.max_bed_c
        if words.get("T") and target_c == 0 and self._is_printing:
            self._objections.add_except_at_end(f"{code} is for another extruder, but there is only one")
        elif words.get("T"):
            self._objections.add_mode_change(
                f"{code} is for another extruder, but there is only one: slice for a single extruder"
            )
        elif not 0 <= target_c <= max_c:
            heater = "nozzle" if is_nozzle else "bed"
            self._objections.refuse(
                f"{code} sets {target_c:g} C, but the limit of the {heater} is {max_c:g} C"
            )
        elif not self._is_printing:
            self.nozzle_c, self.bed_c = (target_c, self.bed_c) if is_nozzle else (self.nozzle_c, target_c)
        elif is_nozzle and target_c < limits.min_extrusion_c:
            self._objections.add_except_at_end(
                f"{code} lets the nozzle get cold ({target_c:g} C) before the print ends",
                ends_print=target_c == 0,
            )
        elif not is_nozzle and target_c == 0 and self.bed_c:
            self._objections.add_except_at_end(
                f"{code} switches the bed off before the print ends", ends_print=True
            )
        else:
            self._writer.add_line(b"%b S%d" % (code.encode(), target_c))

    def _set_fan(self, code: str, words: Words) -> None:
        if words.get("P"):
            return  # the printer has no such fan
        power = words.get("S", 255.0)
        power = 0.0 if code == "M107" else min(255.0, max(0.0, power))
        self._fan_line = b"M106 S%d" % round(power) if power else _FAN_OFF_LINE
        if self._is_printing:
            self._writer.add_line(self._fan_line)

    def _parse_factor(self, code: str, words: Words, minimum: float, maximum: float) -> float:
        factor = words.get("S", 0.0) / 100
        if not minimum <= factor <= maximum:
            self._objections.refuse(f"{code} needs S{100 * minimum:g} to S{100 * maximum:g}")
        return factor

    def _set_speed(self, words: Words) -> None:
        feed_mm_min = words.get("F", 0.0)
        if feed_mm_min > 0:  # the firmware also ignores F0
            self._speed_mm_s = feed_mm_min / 60


@dataclass(frozen=True, slots=True)
class Arc:
    """Arc from `start` around `centre` to `end`, in mm; a whole circle if start and end are the same."""

    start: Point
    end: Point
    centre: Point
    is_clockwise: bool

    @property
    def radius_mm(self) -> float:
        """Radius at the start."""
        return math.dist(self.start, self.centre)

    @property
    def end_radius_mm(self) -> float:
        """Radius at the end."""
        return math.dist(self.end, self.centre)

    @property
    def sweep_rad(self) -> float:
        """Angle swept, in radians; negative clockwise."""
        sweep_rad = (self._compute_angle_rad(self.end) - self._compute_angle_rad(self.start)) % math.tau
        if self.is_clockwise:
            return sweep_rad - math.tau
        return sweep_rad or math.tau

    @property
    def length_mm(self) -> float:
        """Length along the arc."""
        return abs(self.sweep_rad) * self.radius_mm

    def sample_points(self) -> Iterator[tuple[Point, float]]:
        """Yield the end of each straight move, and the share of the arc up to it; the last one is `end`."""
        radius_mm, sweep_rad, start_rad = self.radius_mm, self.sweep_rad, self._compute_angle_rad(self.start)
        step_mm = max(0.05, min(MAX_CHORD_MM, math.sqrt(8 * radius_mm * CHORD_DEVIATION_MM)))
        count = max(1, math.ceil(self.length_mm / step_mm))
        for i in range(1, count):
            angle_rad = start_rad + sweep_rad * i / count
            yield self._compute_point(angle_rad, radius_mm), i / count
        yield self.end, 1.0

    def _compute_angle_rad(self, point: Point) -> float:
        return math.atan2(point[1] - self.centre[1], point[0] - self.centre[0])

    def _compute_point(self, angle_rad: float, radius_mm: float) -> Point:
        return (
            self.centre[0] + radius_mm * math.cos(angle_rad),
            self.centre[1] + radius_mm * math.sin(angle_rad),
        )
