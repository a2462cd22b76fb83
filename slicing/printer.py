"""Facts of a printer model besides Cura's definition of it: limits, start and end code, head.

Cura leaves homing, heating, priming and switching off to the menu of these printers, so a host that streams
G-code sends its own code. In the flavour ``RepRap (Marlin/Sprinter)`` the extruder counts millimetres of
filament, as the firmware expects from a host (its own UltiGCode counts mm3).

A print ends with the filament retracted by `PrintCode.park_retraction_mm`. The host that streams the next
file knows whether it is parked and pushes it back, so the start code only primes.
"""

from __future__ import annotations

from dataclasses import dataclass

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MachineLimits:
    """Temperatures that the firmware accepts, in C.

    Attributes
    ----------
    max_nozzle_c, max_bed_c
        Highest targets that may be set.
    min_extrusion_c
        Nozzle temperature below which the firmware ignores the filament of a move, but moves the head.
    """

    max_nozzle_c: float
    max_bed_c: float
    min_extrusion_c: float


@dataclass(frozen=True, slots=True)
class PrintCode:
    """Start and end code of a streamed print, and the state in which they leave the printer.

    Attributes
    ----------
    flavor
        Value of Cura's ``machine_gcode_flavor``.
    start
        Lines with the fields ``{nozzle_c}``, ``{bed_c}`` (both C) and ``{prime_mm}`` (mm of filament).
    end
        Lines with the field ``{park_mm}``: the relative feed that parks the filament, in mm.
    prime_mm3
        Volume that the start code primes.
    park_retraction_mm
        Distance by which the filament is retracted after the end code.
    start_position_mm
        Position (x, y, z) of the head after the start code.
    """

    flavor: str
    start: tuple[str, ...]
    end: tuple[str, ...]
    prime_mm3: float
    park_retraction_mm: float
    start_position_mm: Point

    def build_start_code(self, nozzle_c: float, bed_c: float, filament_mm2: float) -> str:
        """Fill in the start code.

        Parameters
        ----------
        nozzle_c, bed_c
            Temperatures of the first layer, in C. 0 means a bed without a heater: lines with ``{bed_c}`` are
            left out.
        filament_mm2
            Cross-section of the filament.
        """
        lines = (line for line in self.start if bed_c or "{bed_c" not in line)
        fields = {"nozzle_c": nozzle_c, "bed_c": bed_c, "prime_mm": self.prime_mm3 / filament_mm2}
        return "\n".join(line.format(**fields) for line in lines)

    def build_end_code(self, retracted_mm: float) -> str:
        """Fill in the end code for filament that the slicer has already retracted by `retracted_mm`."""
        return "\n".join(line.format(park_mm=retracted_mm - self.park_retraction_mm) for line in self.end)


@dataclass(frozen=True, slots=True)
class HeadShape:
    """Head with its fans, in mm from the nozzle's tip.

    Attributes
    ----------
    left_mm, right_mm, front_mm, back_mm
        Edges seen from above; those on the left and at the front are negative.
    underside_mm
        Height of its underside above the tip.
    """

    left_mm: float
    right_mm: float
    front_mm: float
    back_mm: float
    underside_mm: float


@dataclass(frozen=True, slots=True)
class PrinterModel:
    """Printer model to slice for.

    Attributes
    ----------
    name
        Id of Cura's definition, like ``ultimaker2_plus``.
    title
        Name in messages, like ``Ultimaker 2+``.
    slicer_names
        Pattern of the names that slicers have for it, in lower case.
    limits, code, head
        Temperature limits, start and end code, and shape of the head.
    retraction_mm, retraction_mm_s
        Distance and speed of the firmware's own retraction (G10).
    """

    name: str
    title: str
    slicer_names: str
    limits: MachineLimits
    code: PrintCode
    head: HeadShape
    retraction_mm: float
    retraction_mm_s: float
