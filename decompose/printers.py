"""Printers for a decomposition: name, room for a part, and speed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PrinterRoom:
    """Boxes (x, y, z) in mm that a part may fill on a printer; x and y may be swapped.

    A part takes `time_factor` times its price; the factor is learned from the prints of the printer.
    """

    name: str
    boxes: tuple[tuple[float, float, float], ...]
    time_factor: float = 1.0

    def fits(self, width_mm: float, depth_mm: float, height_mm: float) -> bool:
        """Check whether a part of these extents fits one of the boxes, turned about z if necessary."""
        return any(
            height_mm <= z and ((width_mm <= x and depth_mm <= y) or (depth_mm <= x and width_mm <= y))
            for x, y, z in self.boxes
        )


@dataclass(frozen=True, slots=True)
class BedPlace:
    """Place of a part on the bed of its printer, seen from the front.

    Attributes
    ----------
    bed_mm
        Width and depth of the bed.
    at_mm
        Centre of the part's box, to the right of the bed's centre and behind it.
    turned
        Whether the part is turned by 90 degrees about z, counterclockwise, from the pose of its file.
    """

    bed_mm: tuple[float, float]
    at_mm: tuple[float, float]
    turned: bool
