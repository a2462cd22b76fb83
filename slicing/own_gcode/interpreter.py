"""Goes through a file as the firmware of the Ultimaker 2+ would, and hands the print in it to a writer."""

from __future__ import annotations

import math
import re
from typing import NoReturn

from slicing.checks.output import MIN_EXTRUSION_C
from slicing.errors import GcodeRefused
from slicing.own_gcode import command_rules
from slicing.own_gcode.arcs import Arc
from slicing.own_gcode.clearance import Clearance
from slicing.own_gcode.extent import Extent
from slicing.own_gcode.lines import Words, plain_move, split, words
from slicing.own_gcode.survey import INCOMPLETE, Survey, is_layer
from slicing.own_gcode.writer import Writer
from slicing.start_code import READY_MM

MOST_NOZZLE_C, MOST_BED_C = 260.0, 115.0
"""The firmware stops above 275 and 130."""
RETRACTION_MM, RETRACTION_MM_S = 6.5, 25.0
"""What G10 does: Cura's own figures for these printers, and the 2+ firmware's (a UM2's has 4.5 mm)."""
MOST_RETRACTED_MM = 20.5
"""Further back the filament leaves the hot end; 20 mm is how far a print parks it."""
MOST_PUSHED_MM = 200.0  # in one move: more than any slicer asks for, less than what the firmware drops
LEAST_MM_S = 0.1
MOST_DWELL_S = 60.0  # the nozzle is hot, and a cancelled print has to wait for its end
MOST_STANDING_S = 3600.0  # all dwells together
MOST_SWALLOWED_MM = 0.3
"""Furthest that filament may be drawn back when a line begins: slicers push it forth before."""
MOST_ARC_MM = 700.0  # round the whole bed
ARC_TOLERANCE_MM = 0.2  # of its radius, between start and end
MOST_DROP_MM = 10.0  # how far up the head goes before it parks in a pause, or homes when cancelled
TRAVEL_MM_S, LOWER_MM_S = 120.0, 20.0
_FIRMWARE_MM_S = 25.0  # what it moves with before the first F
_FEATURE = re.compile(rb"TYPE:[A-Z-]{1,20}\Z")  # Cura's comments on what it prints


class Walk:
    """Printer's state, from the first line on; from `survey.begins` on it is printed.

    A command that must not stand in a print refuses the file only once something is printed after it: at the
    end of a file it belongs to the end script, which is not printed.
    """

    def __init__(
        self,
        survey: Survey,
        writer: Writer,
        clearance: Clearance,
        filament_mm2: float,
        nozzle_c: float,
        bed_c: float,
    ) -> None:
        self.extent = Extent()
        self.nozzle_c = nozzle_c if survey.ulticode else 0.0  # as last set before the print
        self.bed_c = bed_c if survey.ulticode else 0.0
        self.objection: str | None = None  # why nothing more may be printed
        self.left_out: dict[str, str] = {}
        self._lost: str | None = None  # an objection that no end script explains
        self._ended = False  # by an end script: nothing is printed after it
        self._clearance = clearance
        self._survey = survey
        self._writer = writer
        self._scale = 1 / filament_mm2 if survey.ulticode else 1.0
        self._number = 0
        self._printing = False
        self._arrived = False
        self._at = [math.nan] * 3
        self._e = 0.0  # in the file's own measure
        self._relative = self._relative_e = False
        self._speed_mm_s = _FIRMWARE_MM_S
        self._speed = self._flow = 1.0
        self._back_mm = 0.0
        self._drawn_back = False  # by G10
        self._drawn_back_in = 0  # line
        self._waited_s = self._waiting_s = 0.0  # in all, and since the last line that was printed
        self._fan: bytes = b"M107"

    def follow(self, raw: bytes, number: int) -> None:
        """Carry one line out."""
        self._number = number
        if number != self._survey.begins and (move := plain_move(raw)) is not None:
            self._move(move)
            return
        code, rest, comment = split(raw, number)
        if number == self._survey.begins:
            self._begin()
        if self._printing and is_layer(comment):
            self._writer.layer()
        elif self._printing and _FEATURE.match(comment):
            self._writer.line(b";" + comment)
        if not code or command_rules.needless(code, rest):
            return
        if (why := command_rules.refusal(code)) is not None:
            raise GcodeRefused(f"line {number}: {code} {why}")
        if code in command_rules.NOT_TAKEN_OVER:
            self.left_out[code] = command_rules.NOT_TAKEN_OVER[code]
        elif code in command_rules.PRINTED:
            self._carry_out(code, words(rest, number))
        elif code == "G28" and not self._printing:
            self._at = [math.nan] * 3
        elif self._printing:
            self._end(f"{code} {command_rules.refusal_in_print(code)}", code in command_rules.END)

    def finish(self) -> None:
        """Check the file's end.

        Raises
        ------
        GcodeRefused
            Where it prints nothing, or what it says last is no end.
        """
        if not self.extent.path_mm:
            raise GcodeRefused(self.objection or "it prints nothing: no move after its start extrudes")
        if self._lost is not None:
            raise GcodeRefused(self._lost)
        if not (self._ended or self._survey.closed):
            self._refuse(
                "the file ends here, but not its print: nothing switches the nozzle off (M104 S0) after the "
                f"last line that is printed; {INCOMPLETE}"
            )

    # --- what the lines do ---

    def _carry_out(self, code: str, given: Words) -> None:
        match code:
            case "G0" | "G1":
                self._move(given)
            case "G2" | "G3":
                self._arc(code == "G2", given)
            case "G4":
                self._dwell(given)
            case "G10" | "G11":
                self._retract(code, given)
            case "G90" | "G91":
                self._relative = code == "G91"
            case "G92":
                self._count(given)
            case "M82" | "M83":
                self._relative_e = code == "M83"
            case "M104" | "M109" | "M140" | "M190":
                self._heat(code, given)
            case "M106" | "M107":
                self._blow(code, given)
            case "M220":
                self._speed = self._factor(code, given, 0.1, 5.0)
            case "M221":
                self._flow = self._factor(code, given, 0.1, 3.0)

    def _move(self, given: Words) -> None:
        self._feed(given)
        self._go(self._target(given), self._pushed_mm(given))

    def _target(self, given: Words) -> list[float]:
        return [
            here if (value := given.get(axis)) is None else value + (here if self._relative else 0.0)
            for axis, here in zip("XYZ", self._at, strict=True)
        ]

    def _pushed_mm(self, given: Words) -> float:
        """Compute the filament that a move feeds, in mm; in G91 E is relative too, in this firmware."""
        e = given.get("E")
        if e is None:
            return 0.0
        pushed = e if self._relative or self._relative_e else e - self._e
        self._e += pushed
        return pushed * self._scale * self._flow

    def _arc(self, clockwise: bool, given: Words) -> None:
        self._feed(given)
        x, y, z = self._at
        i, j = given.get("I", 0.0), given.get("J", 0.0)
        if "R" in given or not (i or j):
            self._refuse("an arc needs I and J: switch arc fitting off in your slicer")
        end = self._target(given)
        pushed_mm, done = self._pushed_mm(given), 0.0
        if math.isnan(x + y + end[0] + end[1]):
            self._at = end
            self._object("an arc starts nobody knows where: its file has not said X and Y before")
            return
        arc = Arc((x, y), (end[0], end[1]), (x + i, y + j), clockwise)
        if arc.length_mm > MOST_ARC_MM or abs(arc.end_radius_mm - arc.radius_mm) > ARC_TOLERANCE_MM:
            self._refuse("no printer can make this arc: is the file damaged?")
        for (to_x, to_y), share in arc.points():
            self._go([to_x, to_y, z + (end[2] - z) * share], pushed_mm * (share - done))
            done = share

    def _dwell(self, given: Words) -> None:
        seconds = given.get("S", given.get("P", 0.0) / 1000)
        if self._printing and seconds > 0:
            self._waited_s += seconds
            self._waiting_s += seconds
            if self._waiting_s > MOST_DWELL_S:
                self._object(f"G4 waits {self._waiting_s:g} s in one place: at most {MOST_DWELL_S:g}")
            elif self._waited_s > MOST_STANDING_S:
                self._object(f"G4 waits {self._waited_s:g} s in all so far: at most {MOST_STANDING_S:g}")
            else:
                self._writer.dwell(seconds)

    def _retract(self, code: str, given: Words) -> None:
        if given.keys() - {"S"}:
            self._object(f"{code} with {' '.join(given)} is no retraction: take it out")
        elif self._drawn_back != (code == "G10"):
            self._drawn_back = not self._drawn_back
            pushed_mm = -RETRACTION_MM if self._drawn_back else RETRACTION_MM
            speed_mm_s, self._speed_mm_s = self._speed_mm_s, RETRACTION_MM_S
            self._go(self._at, pushed_mm)
            self._speed_mm_s = speed_mm_s

    def _count(self, given: Words) -> None:
        if given.keys() == {"E"}:
            self._e = given["E"]
        else:
            self._reject("G92 may count E anew, and nothing else: take it out of your slicer's scripts")

    def _heat(self, code: str, given: Words) -> None:
        if not given.keys() & {"S", "R"}:
            self._refuse(f"{code} names no temperature: write it behind S")
        target_c = float(round(given["S" if "S" in given else "R"]))
        nozzle = code in ("M104", "M109")
        most_c = MOST_NOZZLE_C if nozzle else MOST_BED_C
        if given.get("T") and target_c == 0 and self._printing:
            self._end(f"{code} is for another extruder, and there is one")
        elif given.get("T"):
            self._reject(f"{code} is for another extruder, and there is one: slice for a single extruder")
        elif not 0 <= target_c <= most_c:
            what = "nozzle" if nozzle else "bed"
            self._refuse(f"{code} sets {target_c:g} C, and the {what} may have at most {most_c:g}")
        elif not self._printing:
            self.nozzle_c, self.bed_c = (target_c, self.bed_c) if nozzle else (self.nozzle_c, target_c)
        elif nozzle and target_c < MIN_EXTRUSION_C:
            self._end(
                f"{code} lets the nozzle get cold ({target_c:g} C) and the print goes on", target_c == 0
            )
        elif not nozzle and target_c == 0 and self.bed_c:
            self._end(f"{code} switches the bed off and the print goes on", True)
        else:
            self._writer.line(b"%b S%d" % (code.encode(), target_c))

    def _blow(self, code: str, given: Words) -> None:
        if given.get("P"):
            return  # a fan that this printer has not
        power = given.get("S", 255.0)
        power = 0.0 if code == "M107" else min(255.0, max(0.0, power))
        self._fan = b"M106 S%d" % round(power) if power else b"M107"
        if self._printing:
            self._writer.line(self._fan)

    def _factor(self, code: str, given: Words, least: float, most: float) -> float:
        factor = given.get("S", 0.0) / 100
        if not least <= factor <= most:
            self._refuse(f"{code} needs S{100 * least:g} to S{100 * most:g}")
        return factor

    def _feed(self, given: Words) -> None:
        per_minute = given.get("F", 0.0)
        if per_minute > 0:  # the firmware, too, goes on as before at F0
            self._speed_mm_s = per_minute / 60

    # --- the head ---

    def _begin(self) -> None:
        """Begin the print: the head stands over the bed, primed."""
        self._printing = True
        if self.nozzle_c < MIN_EXTRUSION_C:
            self._refuse(
                "the print begins here, and no M104 or M109 before it has set the nozzle's temperature: "
                "add it to your slicer's start script"
            )
        if self._back_mm > MOST_RETRACTED_MM:
            self._refuse(
                f"the print begins here, with the filament drawn {self._back_mm:.1f} mm back, out of the hot "
                "end: take that out of your slicer's start script"
            )
        if self._back_mm:
            self._writer.move((*READY_MM, -self._back_mm, RETRACTION_MM_S))
        if self._fan != b"M107":
            self._writer.line(self._fan)
        if not self._survey.marks_layers:
            self._writer.layer()

    def _go(self, target: list[float], pushed_mm: float) -> None:
        """Make one straight move."""
        old, self._at = self._at, target
        back_mm = self._back_mm
        self._back_mm = max(0.0, back_mm - pushed_mm)
        if not self._printing:
            return
        if pushed_mm > MOST_PUSHED_MM:
            self._object(f"one move pushes {pushed_mm:.0f} mm of filament: is it counted in mm3?")
        if pushed_mm < 0:
            self._drawn_back_in = self._number
        if self._back_mm > MOST_RETRACTED_MM:  # an end script may unload it
            self._end(f"draws the filament {self._back_mm:.1f} mm back, out of the hot end")
        speed_mm_s = self._speed_mm_s * self._speed
        if speed_mm_s < LEAST_MM_S:
            self._object(f"moves at {speed_mm_s * 60:g} mm a minute, which takes for ever")
        if not self._arrive(old, target, pushed_mm):
            return
        x, y, z = target
        self._keep_above(z)
        self._keep_clear(old, target)
        if self._back_mm > MOST_SWALLOWED_MM and pushed_mm > 0 and old[:2] != target[:2]:
            self._object(
                f"would print, with the filament drawn {self._back_mm:.1f} mm back since line "
                f"{self._drawn_back_in}: where E begins anew, the file has to say G92 E0"
            )
        self._writer.move((x, y, z, pushed_mm, speed_mm_s))
        fed_mm = pushed_mm - back_mm
        self.extent.go(target, fed_mm)
        if fed_mm > 0 and target != old:
            self._print(old, target)

    def _arrive(self, old: list[float], target: list[float], pushed_mm: float) -> bool:
        """Come from above to where the file first pushes filament; moves before that are left out.

        False where it has not come to that.
        """
        if self._arrived:
            return True
        x, y, z = old
        if pushed_mm <= 0 or math.isnan(x + y + z):
            moves = any(
                a != b and not (math.isnan(a) and math.isnan(b)) for a, b in zip(old, target, strict=True)
            )
            if pushed_mm > 0 and moves:
                self._object("extrudes before the file has said where: X, Y and Z")
            elif pushed_mm:
                self._writer.move((*READY_MM, pushed_mm, self._speed_mm_s))
            return False
        self._keep_above(z)
        self._writer.move((x, y, READY_MM[2], 0.0, TRAVEL_MM_S))
        self._writer.move((x, y, z, 0.0, LOWER_MM_S))
        self._arrived = True
        return True

    def _keep_above(self, z: float) -> None:
        if z < 0:
            self._object(f"moves to Z {z:g}, into the bed")

    def _keep_clear(self, old: list[float], target: list[float]) -> None:
        """Object to a way through what is printed."""
        if min(old[2], target[2]) >= self.extent.high[2]:
            return
        obstacle_mm = self._clearance.obstacle_mm(old, target)
        if obstacle_mm is not None:
            self._object(
                f"moves at Z {min(old[2], target[2]):g} into what is printed up to Z {obstacle_mm:.3g}, with "
                "the nozzle or the head beside it"
            )

    def _print(self, old: list[float], target: list[float]) -> None:
        if self.objection is not None:
            raise GcodeRefused(self.objection)
        z, highest = min(old[2], target[2]), self.extent.high[2]
        if z <= 0:
            self._refuse(f"prints at Z {z:g}: it has to be above the bed")
        if highest - z > MOST_DROP_MM:
            self._refuse(
                f"prints at Z {z:g} beside what is {highest:g} mm high, which the head would hit in a pause: "
                "print all objects at once (Cura: Print Sequence; PrusaSlicer: Complete individual objects)"
            )
        if not self._survey.marks_layers and self.extent.rises(old, target):
            self._writer.layer(target[2])
        self.extent.print(old, target)
        self._clearance.add(old, target)
        self._waiting_s = 0.0
        self._ended = False
        self._writer.commit()

    # --- refusing ---

    def _object(self, why: str) -> None:
        """Refuse the file as soon as something is printed after this line; a start script is not printed."""
        if self._printing:
            self.objection = self.objection or f"line {self._number}: {why}"
            if not self._ended:
                self._lost = self._lost or f"line {self._number}: {why}"

    def _end(self, why: str, ended: bool = False) -> None:
        """Refuse the file if something is printed after this line; an end script may well hold it.

        `ended`: it shows that the end script has come.
        """
        if self._printing:
            self.objection = self.objection or f"line {self._number}: {why}"
            self._ended = self._ended or ended

    def _reject(self, why: str) -> None:
        """Refuse what changes all that comes after it: in a start script too, but not in an end script."""
        if not self._printing:
            self._refuse(why)
        self._object(why)

    def _refuse(self, why: str) -> NoReturn:
        raise GcodeRefused(f"line {self._number}: {why}")
