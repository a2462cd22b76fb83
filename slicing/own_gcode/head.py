"""Moves of the printer's head in a person's own G-code, printed or refused."""

from __future__ import annotations

import math

from slicing.own_gcode.clearance import Clearance
from slicing.own_gcode.completeness import LayerGaps
from slicing.own_gcode.extent import MAX_PRIMED_MM, Extent
from slicing.own_gcode.objections import Objections
from slicing.own_gcode.writer import Writer
from slicing.printer import PrintCode

RETRACTION_SLACK_MM = 0.5
"""Distance beyond the parked position at which the filament leaves the hot end."""
MAX_EXTRUDED_MM = 200.0
"""Maximum filament in one move: more than any slicer extrudes, less than what the firmware refuses."""
MIN_SPEED_MM_S = 0.1
MAX_START_RETRACTION_MM = 0.3
"""Maximum retraction at which a line may begin: slicers return the filament before a line."""
MAX_CROSS_SECTION_RATIO = 4.0
"""Maximum ratio of a line's cross-section to the square of the nozzle's diameter: more than any slicer's."""
MAX_JUMP_MM = MAX_PRIMED_MM
"""Maximum filament that a move may extrude beyond what was retracted and what its line takes. If lines are
missing from a file with absolute E, one move extrudes the filament of all of them."""
MAX_DROP_MM = 10.0
"""Maximum depth below the top of the print at which a line may be printed: the head is raised by this height
before it parks in a pause, or homes after a cancellation."""
TRAVEL_MM_S, LOWERING_MM_S = 120.0, 20.0

Point = list[float]


class Head:
    """Position of the head and of the filament, and the moves that reach the writer.

    Moves before the first extrusion are left out: the farm's start code replaces them.

    Parameters
    ----------
    code
        The printer's start and end code.
    marks_layers
        Whether comments in the file mark where layers begin.
    writer, clearance, objections, gaps
        Objects that receive the moves, to write the program, to find collisions, to refuse the file, and to
        find missing lines.
    """

    def __init__(
        self,
        code: PrintCode,
        writer: Writer,
        clearance: Clearance,
        objections: Objections,
        gaps: LayerGaps,
        *,
        marks_layers: bool,
    ) -> None:
        self.extent = Extent()
        self.position_mm: Point = [math.nan] * 3  # in the printer's coordinates; NaN if it is not known
        self._code = code
        self._writer = writer
        self._clearance = clearance
        self._objections = objections
        self._gaps = gaps
        self._marks_layers = marks_layers
        self._has_approached = False
        self._retracted_mm = 0.0
        self._retraction_line = 0

    def forget_position(self) -> None:
        """Mark the position as unknown, as after homing."""
        self.position_mm = [math.nan] * 3

    def begin_print(self, retraction_mm_s: float) -> None:
        """Begin the print, with the head over the bed and primed."""
        if self._retracted_mm > self._max_retracted_mm:
            self._objections.refuse(
                f"the print begins here, with the filament retracted by {self._retracted_mm:.1f} mm, out of "
                "the hot end: remove that from your slicer's start script"
            )
        if self._retracted_mm:
            self._writer.add_move((*self._code.start_position_mm, -self._retracted_mm, retraction_mm_s))

    def move(self, target: Point, extruded_mm: float, speed_mm_s: float, factor: float) -> bool:
        """Make one straight move.

        Parameters
        ----------
        target
            End of the move (x, y, z), in the printer's coordinates.
        extruded_mm
            Filament that it extrudes, in mm.
        speed_mm_s, factor
            Feed rate, and the factor by which M220 changes it.

        Returns
        -------
        bool
            Whether it prints a line.
        """
        start, self.position_mm = self.position_mm, target
        retracted_mm = self._retracted_mm
        self._retracted_mm = max(0.0, retracted_mm - extruded_mm)
        if not self._objections.is_printing:
            return False
        self._check_limits(extruded_mm, speed_mm_s * factor)
        if not self._approach_start(start, target, extruded_mm, speed_mm_s):
            return False
        x, y, z = target
        self._check_above_bed(z)
        self._check_clearance(start, target)
        if self._retracted_mm > MAX_START_RETRACTION_MM and extruded_mm > 0 and start[:2] != target[:2]:
            self._objections.add(
                f"would print with the filament retracted by {self._retracted_mm:.1f} mm since line "
                f"{self._retraction_line}: where E starts again from 0, the file needs G92 E0"
            )
        self._writer.add_move((x, y, z, extruded_mm, speed_mm_s * factor))
        fed_mm = extruded_mm - retracted_mm  # without the return of retracted filament
        self._check_jump(start, target, fed_mm)
        if extruded_mm > 0:
            self._gaps.record_extrusion(math.dist(start, target), fed_mm, self._objections.line)
        if extruded_mm > 0 and start == target:
            self.extent.record_prime(fed_mm)
        self.extent.record_move(target, fed_mm)
        is_printing = fed_mm > 0 and target != start
        if is_printing:
            self._print_line(start, target)
        return is_printing

    @property
    def _max_retracted_mm(self) -> float:
        return self._code.park_retraction_mm + RETRACTION_SLACK_MM

    def _check_limits(self, extruded_mm: float, speed_mm_s: float) -> None:
        if extruded_mm > MAX_EXTRUDED_MM:
            self._objections.add(f"one move extrudes {extruded_mm:.0f} mm of filament: is it counted in mm3?")
        if extruded_mm < 0:
            self._retraction_line = self._objections.line
        if self._retracted_mm > self._max_retracted_mm:  # an end script may unload the filament
            self._objections.add_except_at_end(
                f"retracts the filament by {self._retracted_mm:.1f} mm, out of the hot end"
            )
        if speed_mm_s < MIN_SPEED_MM_S:
            self._objections.add(f"moves at {speed_mm_s * 60:g} mm/min, which never ends")

    def _check_jump(self, start: Point, target: Point, fed_mm: float) -> None:
        """Object to a move that extrudes filament for missing lines; a start script may prime any amount."""
        if fed_mm > MAX_JUMP_MM and self.extent.path_mm:
            jump_mm = fed_mm - self._gaps.max_flow * math.dist(start, target)
            if jump_mm > MAX_JUMP_MM:
                self._objections.add(
                    f"one move feeds {jump_mm:.1f} mm of filament more than its line takes: lines are "
                    "missing before it, or E starts again from 0 and the file needs G92 E0"
                )

    def _approach_start(self, start: Point, target: Point, extruded_mm: float, speed_mm_s: float) -> bool:
        """Move from above to the place of the first extrusion; return False until it is reached."""
        if self._has_approached:
            return True
        x, y, z = start
        start_position_mm = self._code.start_position_mm
        if extruded_mm <= 0 or math.isnan(x + y + z):
            is_move = any(
                a != b and not (math.isnan(a) and math.isnan(b)) for a, b in zip(start, target, strict=True)
            )
            if extruded_mm > 0 and is_move:
                self._objections.add("extrudes before the file has set X, Y and Z")
            elif extruded_mm:
                self._writer.add_move((*start_position_mm, extruded_mm, speed_mm_s))
            return False
        self._check_above_bed(z)
        self._writer.add_move((x, y, start_position_mm[2], 0.0, TRAVEL_MM_S))
        self._writer.add_move((x, y, z, 0.0, LOWERING_MM_S))
        self._has_approached = True
        return True

    def _check_above_bed(self, z: float) -> None:
        if z < 0:
            self._objections.add(f"moves to Z {z:g}, into the bed")

    def _check_clearance(self, start: Point, target: Point) -> None:
        """Object to a move through printed lines."""
        if min(start[2], target[2]) >= self.extent.high_mm[2]:
            return
        obstacle_mm = self._clearance.find_obstacle_height_mm(start, target)
        if obstacle_mm is not None:
            self._objections.add(
                f"moves at Z {min(start[2], target[2]):g} into parts printed up to Z {obstacle_mm:.3g}, "
                "with the nozzle or the head beside it"
            )

    def _print_line(self, start: Point, target: Point) -> None:
        self._objections.check_printed_line()
        z_mm, highest_mm = min(start[2], target[2]), self.extent.high_mm[2]
        if z_mm <= 0:
            self._objections.refuse(f"prints at Z {z_mm:g}: it has to be above the bed")
        if highest_mm - z_mm > MAX_DROP_MM:
            self._objections.refuse(
                f"prints at Z {z_mm:g} beside a part that is {highest_mm:g} mm high, which the head would "
                "hit in a pause: print all objects at once (Cura: Print Sequence; "
                "PrusaSlicer: Complete individual objects)"
            )
        if not self._marks_layers and self.extent.is_higher(start, target):
            self._writer.begin_layer(target[2])
        self.extent.record_line(start, target)
        self._clearance.add_line(start, target)
        self._objections.record_printed_line()
        self._writer.commit()
