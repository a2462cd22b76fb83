"""Printer and material that a person's own G-code is printed with."""

from __future__ import annotations

import math
from dataclasses import dataclass

from slicing.printer import PrinterModel


@dataclass(frozen=True, slots=True)
class PrintTarget:
    """Printer and material for a file.

    Attributes
    ----------
    printer
        The printer model.
    filament_mm2
        Cross-section of the filament.
    nozzle_mm
        Nozzle in use, for files that do not name theirs; None if several are in use.
    nozzle_c, bed_c
        Temperatures of the material, for UltiGCode, which leaves them to the printer.
    """

    printer: PrinterModel
    filament_mm2: float
    nozzle_mm: float | None
    nozzle_c: float
    bed_c: float

    @property
    def filament_mm(self) -> float:
        """Diameter of the filament."""
        return math.sqrt(4 * self.filament_mm2 / math.pi)
