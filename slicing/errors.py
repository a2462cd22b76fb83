"""Errors of the slicing package, with a common base."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from enum import StrEnum


class SlicingError(Exception):
    """Base of all errors of slicing; the message says what, where, and what to do."""


class EngineMissing(SlicingError):
    """There is no CuraEngine, or it cannot be started."""


class ResourcesMissing(EngineMissing):
    """Cura's settings files are not there, or one of them cannot be read."""


class EngineFailed(SlicingError):
    """CuraEngine ended with an error."""


class EngineCrashed(EngineFailed):
    """CuraEngine ended by a signal."""


class EngineOutOfMemory(EngineFailed):
    """CuraEngine needed more memory than its limit, or than the machine has."""


class EngineTimeout(SlicingError):
    """CuraEngine took longer than its limit, and was stopped."""


class BadSetting(SlicingError):
    """A printer model, quality, material or setting that does not exist or does not fit."""


class DefinitionError(SlicingError):
    """A formula in Cura's files that cannot be evaluated."""


class GcodeRefused(SlicingError):
    """A person's own G-code that cannot be printed as it is."""


class Rule(StrEnum):
    """Rules that a slice must meet to be printed."""

    NOTHING_PRINTED = "nothing printed"
    BROKEN_MESH = "broken mesh"
    LAYERS = "layers"
    HEIGHT = "height"
    OUTSIDE_BED = "outside the bed"
    FLAVOUR = "flavour"
    HOMING = "homing"
    COLD = "cold"
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
        super().__init__(rule, detail)  # both in `args`, so that it passes between processes
        self.rule = rule
        self.detail = detail

    def __str__(self) -> str:
        return f"the slice was rejected ({self.rule}): {self.detail}"


def suggest_names(name: str, names: Iterable[str]) -> str:
    """Suggest known names similar to a name, as ``"; did you mean a, b?"``; empty if none is similar."""
    close = difflib.get_close_matches(name, list(names), n=3, cutoff=0.5)
    return f"; did you mean {', '.join(close)}?" if close else ""
