"""Errors of the slicing package, with a common base."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from enum import StrEnum


class SlicingError(Exception):
    """Base of all errors of slicing; the message says what is wrong, where, and what to do."""


class EngineMissing(SlicingError):
    """There is no CuraEngine, or it cannot be started."""


class ResourcesMissing(EngineMissing):
    """Cura's settings files are missing, or one of them cannot be read."""


class EngineFailed(SlicingError):
    """CuraEngine ended with an error."""


class EngineCrashed(EngineFailed):
    """CuraEngine was terminated by a signal."""


class EngineOutOfMemory(EngineFailed):
    """CuraEngine needed more memory than its limit, or than the machine has."""


class EngineTimeout(SlicingError):
    """CuraEngine took longer than its limit, and was stopped."""


class BadSetting(SlicingError):
    """A printer model, quality, material or setting does not exist, or is not valid here."""


class DefinitionError(SlicingError):
    """A formula in Cura's files cannot be evaluated."""


class GcodeRefused(SlicingError):
    """A person's own G-code cannot be printed as it is."""


class Rule(StrEnum):
    """Rules that a slice must meet to be printed."""

    NOTHING_PRINTED = "nothing printed"
    BROKEN_MESH = "broken mesh"
    LAYERS = "layers"
    HEIGHT = "height"
    OUTSIDE_BED = "outside the bed"
    FLAVOUR = "flavour"
    HOMING = "homing"
    COLD_EXTRUSION = "cold extrusion"
    HEATERS_ON = "heaters on"
    OUTLINE = "outline"
    PARKING = "parking"


class SliceRejected(SlicingError):
    """CuraEngine ended without an error, but its output must not be printed.

    Parameters
    ----------
    rule
        The rule that was broken.
    detail
        Short description of the fault.
    """

    def __init__(self, rule: Rule, detail: str) -> None:
        super().__init__(rule, detail)  # both in `args`, because pickling rebuilds the error from them
        self.rule = rule
        self.detail = detail

    def __str__(self) -> str:
        return f"the slice was rejected ({self.rule}): {self.detail}"


class OutsideBed(SliceRejected):
    """The print extends beyond the bed, because its support or brim is wider than expected.

    Parameters
    ----------
    detail
        Short description of the fault.
    low_mm, high_mm
        Bounds (x, y) of all extrusion, from the bed's centre.
    height_mm
        Minimum build height that the part needs.
    """

    def __init__(
        self, detail: str, low_mm: tuple[float, float], high_mm: tuple[float, float], height_mm: float
    ) -> None:
        super().__init__(Rule.OUTSIDE_BED, detail)
        self.args = (detail, low_mm, high_mm, height_mm)  # pickling rebuilds the error from them
        self.low_mm = low_mm
        self.high_mm = high_mm
        self.height_mm = height_mm

    def find_shift(
        self, bed: Iterable[tuple[float, float, float, float, float]]
    ) -> tuple[float, float] | None:
        """Find the shortest shift (x, y) in mm that brings all extrusion onto the bed.

        Parameters
        ----------
        bed
            Boxes (min x, min y, max x, max y, height) in mm from the bed's centre; one has to hold the print.

        Returns
        -------
        tuple of float or None
            None if no box is large enough.
        """
        shifts = []
        for min_x, min_y, max_x, max_y, max_height_mm in bed:
            slack_x_mm = max_x - min_x - (self.high_mm[0] - self.low_mm[0])
            slack_y_mm = max_y - min_y - (self.high_mm[1] - self.low_mm[1])
            if min(slack_x_mm, slack_y_mm, max_height_mm - self.height_mm) >= 0.0:
                x = min(max(0.0, min_x - self.low_mm[0]), max_x - self.high_mm[0])
                y = min(max(0.0, min_y - self.low_mm[1]), max_y - self.high_mm[1])
                shifts.append((x, y))
        return min(shifts, key=lambda shift: math.hypot(*shift), default=None)


def suggest_names(name: str, names: Iterable[str]) -> str:
    """Suggest known names similar to a name, as ``"; did you mean a, b?"``; empty if none is similar."""
    similar_names = difflib.get_close_matches(name, list(names), n=3, cutoff=0.5)
    return f"; did you mean {', '.join(similar_names)}?" if similar_names else ""
