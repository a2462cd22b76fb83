"""Printer as a decomposition needs it: its name, its room for a part, and its speed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PrinterRoom:
    """Boxes (x, y, z) in mm that a part may fill on a printer; x and y may be swapped.

    A part takes `time_factor` times its price: a ratio learned from the prints of the printer.
    """

    name: str
    boxes: tuple[tuple[float, float, float], ...]
    time_factor: float = 1.0

    def fits(self, width_mm: float, depth_mm: float, height_mm: float) -> bool:
        """Check whether a part of these extents fits one of the boxes, turned about Z if need be."""
        return any(
            height_mm <= z and ((width_mm <= x and depth_mm <= y) or (depth_mm <= x and width_mm <= y))
            for x, y, z in self.boxes
        )
