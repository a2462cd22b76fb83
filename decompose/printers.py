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
    box_sizes_mm
        Width, depth and height of each box of its build volume, without the room that clips and the brim
        take. A part fits if it fits one of these boxes; its width and depth may be swapped.
    time_factor
        Ratio of a part's print time to its price, learned from earlier prints of the printer.
    """

    name: str
    box_sizes_mm: tuple[tuple[float, float, float], ...]
    time_factor: float = 1.0

    def fits(self, width_mm: float, depth_mm: float, height_mm: float) -> bool:
        """Check whether a part of this size fits one of the boxes, rotated about z if necessary.

        Parameters
        ----------
        width_mm, depth_mm, height_mm
            Size of the part.
        """
        return any(
            height_mm <= z and ((width_mm <= x and depth_mm <= y) or (depth_mm <= x and width_mm <= y))
            for x, y, z in self.box_sizes_mm
        )


@dataclass(frozen=True, slots=True)
class BedPlace:
    """Place of a part on the bed of its printer, seen from the front.

    Attributes
    ----------
    bed_mm
        Width and depth of the bed.
    centre_mm
        Centre of the part's bounding box: its distances from the centre of the bed, to the right and to the
        back.
    is_rotated
        Whether the part is rotated by 90 degrees about z, counterclockwise, from the pose of its file.
    """

    bed_mm: tuple[float, float]
    centre_mm: tuple[float, float]
    is_rotated: bool
