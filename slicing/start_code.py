"""Start and end code for a printer that is fed over USB.

Everything that Cura leaves to the printer's own menu is here: homing, heating, priming, and the heaters off
at the end. In the flavour ``RepRap (Marlin/Sprinter)`` the extruder counts millimetres of filament, which is
what the firmware of the Ultimaker 2+ expects from a host (its own UltiGCode counts mm3: 6.4 times too much).

A print ends with the filament parked `PARKED_MM` back, as prints from the SD card do. To bring it forth again
is the business of who streams the file and knows whether it is parked; the start code only primes.
"""

from __future__ import annotations

FLAVOR = "RepRap (Marlin/Sprinter)"
PARKED_MM = 20.0
"""How far the firmware and its menu park the filament (``END_OF_PRINT_RETRACTION``)."""
PRIME_MM3 = 50.0
"""What is primed before a print, as the firmware does it (``PRIMING_MM3``)."""

READY_MM = (5.0, 50.0, 20.0)
"""Where the head stands after the start code."""


def start_code(nozzle_c: float, bed_c: float, filament_mm2: float) -> str:
    """Home, heat the bed, then the nozzle, and prime; temperatures in C, the filament's section in mm2.

    A bed at 0 C is one that cannot be heated: nothing is said to it.
    """
    lines = (
        "G21",
        "G90",
        "M82",
        "M107",
        "M220 S100",
        "M221 S100",
        f"M140 S{bed_c:g}" if bed_c else None,
        "G28",
        "G1 F12000 X5 Y10",
        f"M190 S{bed_c:g}" if bed_c else None,
        f"M109 S{nozzle_c:g}",
        "G1 F2400 Z20",
        "G92 E0",
        f"G1 F47 E{PRIME_MM3 / filament_mm2:.1f}",
        "G92 E0",
        "G0 F3000 Y50",
    )
    return "\n".join(line for line in lines if line)


def end_code(retracted_mm: float) -> str:
    """Heaters off, park the filament, home. `retracted_mm`: what the slicer's last retraction has done."""
    return "\n".join(
        (
            "M104 S0",
            "M140 S0",
            "M107",
            "G91",
            f"G1 F1500 E{retracted_mm - PARKED_MM:g}",
            "G90",
            "G28",
            "M84",
        )
    )
