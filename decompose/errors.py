"""Errors of decomposition, with a common base."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum


class DecomposeError(Exception):
    """Base of all errors of decomposition; the message says what is wrong, where, and what to do."""


class ModelUnreadable(DecomposeError):
    """The file is missing, or is not a complete model in a known format."""


class BadSize(ModelUnreadable):
    """The requested scale or longest side is impossible for any model."""


class ModelEmpty(DecomposeError):
    """The file has no triangle with a nonzero area."""


class ModelFlat(DecomposeError):
    """The model has no thickness along an axis."""


class ModelNotFinite(DecomposeError):
    """A coordinate is NaN or infinite."""


class ModelNotSolid(DecomposeError):
    """The triangles bound no solid, and a repair would have to add or remove too much."""


class ModelTiny(DecomposeError):
    """The model is so small that its unit is probably not the millimetre; a scale is needed."""


class ModelHuge(DecomposeError):
    """The model is so large, or so far from its origin, that its coordinates cannot be in mm."""


class ModelTooDetailed(DecomposeError):
    """The model has more triangles than fit in memory."""


class NoFit(DecomposeError):
    """The parts do not fit the printers.

    Attributes
    ----------
    needed_printer_count
        Minimum number of printers, of the same kinds, that would be enough, or a lower bound on this number;
        None if the number is not known, or if no number would be enough.
    is_too_large
        Whether a smaller model would fit (`advised_size` finds the maximum size).
    """

    def __init__(
        self, message: str, needed_printer_count: int | None = None, *, is_too_large: bool = False
    ) -> None:
        super().__init__(message)
        self.needed_printer_count = needed_printer_count
        self.is_too_large = is_too_large

    @classmethod
    def from_shortage(
        cls,
        extents_mm: Iterable[float],
        part_count: int,
        printer_count: int,
        printers_to_free: str = "more printers",
    ) -> NoFit:
        """Build the error for more parts than printers.

        Parameters
        ----------
        extents_mm
            Size of the model.
        part_count, printer_count
            Number of parts, and number of printers.
        printers_to_free
            Words for the printers to free, used in the message.
        """
        return cls(
            f"a model of {format_size(extents_mm)} mm needs {part_count} parts, each on its own printer, but "
            f"there are {printer_count} printers: free {printers_to_free}, or give a smaller --longest-side",
            part_count,
            is_too_large=True,
        )


def format_size(sides_mm: Iterable[float]) -> str:
    """Format the sides of a box in whole mm, for a message."""
    return " x ".join(f"{side:.0f}" for side in sides_mm)


class Rule(StrEnum):
    """Geometry rules that `results.check` checks on every result."""

    CLOSED = "closed"  # each part is a closed manifold of positive volume
    ONE_PIECE = "one-piece"
    FITS = "fits"  # each part fits its printer, in its pose
    OWN_PRINTER = "own-printer"  # no printer gets more parts than it may print
    NO_OVERLAP = "no-overlap"
    SURFACE = "surface"  # the parts cover the original surface exactly once
    WALL = "wall"  # hollows are at least the minimum wall thickness away from the original surface
    INTERIOR = "inside"  # parts and hollows together are exactly the model
    # Rules of pins and marks; a part that breaks one of these is printed without pins and marks.
    ONLY_HOLES_REMOVED = "drilled"  # only the holes and marks are removed, and a part stays one piece
    # A minimum wall remains between pins and marks, and between them and the surface and other faces.
    PIN_WALLS = "skin"
    # Each pin can be inserted, and no glued group of parts fits in a wrong rotation or a wrong place.
    PINS_UNAMBIGUOUS = "pinned"
    PIN_DIRECTIONS = "order"  # each pin is parallel to the direction in which its two parts are joined
    SUPPORT_FREE = "support-free"  # the ceilings of holes and grooves need no support
    STL = "stl"  # the file, when read back, is watertight and has the part's volume


class GeometryError(DecomposeError):
    """A result breaks a geometry rule, so it is not printed.

    Attributes
    ----------
    rule
        Short name of the rule, a value of `Rule`.
    part
        Part that breaks the rule; None if the rule concerns the decomposition as a whole.
    """

    def __init__(self, rule: str, part: str | None, problem: str) -> None:
        super().__init__(f"{part or 'decomposition'}: {problem} (rule {rule}); nothing was written")
        self.rule = rule
        self.part = part
