"""Depths of the holes for pins, and diameters of keys."""

from __future__ import annotations

from decompose.options import THIN_FILAMENT_MM

SHALLOW_DEPTH_RATIO = 1.05  # depth of the shallow hole of a pair, as a multiple of the diameter of the pin
MIN_DEPTH_MM = 2.5  # minimum depth of a hole
EXTRA_DEPTH_MM = 3.0  # additional depth of the deep hole: about the gap of a joint with a rotated body
END_GAP_MM = 0.5  # gap at each end of a pin


def choose_depths_mm(pin_mm: float) -> tuple[float, float]:
    """Choose the depths in mm of the deep and the shallow hole for a pin, rounded to 0.5 mm.

    The print time of a hole grows with its depth. Pins only align the faces; the glue holds them.
    """
    shallow_mm = max(MIN_DEPTH_MM, round(2.0 * SHALLOW_DEPTH_RATIO * pin_mm) / 2.0)
    return shallow_mm + EXTRA_DEPTH_MM, shallow_mm


def choose_key_diameters_mm(pin_mm: float) -> list[float]:
    """Choose the diameters of keys: the diameter of pins, then that of thin filament, for narrow places."""
    return sorted({pin_mm, min(pin_mm, THIN_FILAMENT_MM)}, reverse=True)
