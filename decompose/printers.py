"""Printers for which a model is cut: name, build volume and speed; places of parts on their beds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TargetPrinter:
    """Printer for which parts are cut.

    Attributes
    ----------
    name
        Name of the printer.
    boxes
        Boxes of its build volume without clips and brim: width, depth and height in mm that a part may have;
        width and depth may be swapped.
    time_factor
        Ratio of a part's print time to its price, learned from the prints of the printer.
    """

    name: str
    boxes: tuple[tuple[float, float, float], ...]
    time_factor: float = 1.0

    def fits(self, width_mm: float, depth_mm: float, height_mm: float) -> bool:
        """Check whether a part of these extents fits one of the boxes, rotated about z if necessary.

        Parameters
        ----------
        width_mm, depth_mm, height_mm
            Extents of the part.
        """
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
    centre_mm
        Centre of the part's bounding box: distance to the right of the bed's centre, and behind it.
    is_rotated
        Whether the part is rotated by 90 degrees about z, counterclockwise, from the pose of its file.
    """

    bed_mm: tuple[float, float]
    centre_mm: tuple[float, float]
    is_rotated: bool
