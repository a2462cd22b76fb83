"""Temperatures of a printer at one time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Temperatures:
    """Hottest readings of a minute, in whole degrees Celsius, and the last targets; None: no answer."""

    at_s: float
    nozzle_c: int | None
    bed_c: int | None
    nozzle_target_c: int | None
    bed_target_c: int | None
