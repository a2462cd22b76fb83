"""Coupon: a block with numbered holes of several fits, to find the fit of pins on a printer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats
from decompose.connectors.pins import END_MM, choose_depths_mm
from decompose.connectors.records import Mark, Tool
from decompose.connectors.strokes import GRID_HIGH, draw_strokes
from decompose.connectors.tools import make_groove, make_hole
from decompose.errors import DecomposeError
from decompose.geometry import Solid

FITS_MM = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
GAUGE_FIT_MM = 0.8  # width of the two gauges beyond the pin, which enters them easily
LETTERS_MM, GROOVE_MM = 6.0, 0.5
GAP_MM = 3.0  # gap between holes, numbers and edges
UP = np.array([0.0, 0.0, 1.0])
INWARDS, DOWNWARDS = np.array([0.0, 1.0, 0.0]), -UP


@dataclass(frozen=True, slots=True, eq=False)
class Coupon:
    """Coupon in its printing pose.

    Attributes
    ----------
    solid
        Block with all holes and numbers.
    holes
        Holes on top, then in front, by rising fit; then the gauges for the long and the short pin.
    marks
        Numbers, in the same order: fits in tenths of a millimetre; lengths in millimetres.
    fits_mm, lengths_mm
        Fits of the holes on each side, and lengths of pins that end flush in the gauges.
    """

    solid: Solid
    holes: tuple[Tool, ...]
    marks: tuple[Mark, ...]
    fits_mm: tuple[float, ...]
    lengths_mm: tuple[float, float]


def make_coupon(pin_mm: float) -> Coupon:
    """Make the coupon for pins of a diameter.

    The holes on top open upwards; those in front are horizontal and have a roof.
    """
    pitch_mm = pin_mm + 2.0 * GAP_MM + 1.5
    depths_mm = choose_depths_mm(pin_mm)
    long_mm, short_mm = (2.0 * (depth_mm - END_MM) for depth_mm in depths_mm)
    height_mm = max(long_mm + GAP_MM, 2.0 * pin_mm + LETTERS_MM + 3.0 * GAP_MM)
    depth_mm = depths_mm[0] + 2.0 * pin_mm + LETTERS_MM + 3.0 * GAP_MM
    count = len(FITS_MM) + 2
    block = Solid.box((0.0, 0.0, 0.0), (pitch_mm * count, depth_mm, height_mm))
    letters_y_mm, holes_y_mm = GAP_MM + LETTERS_MM / 2.0, depth_mm - GAP_MM - pin_mm

    def drill_top(n: int, fit_mm: float, length_mm: float) -> Tool:
        mouth_mm = np.array([pitch_mm * (n + 0.5), holes_y_mm, height_mm])
        return _drill(mouth_mm, DOWNWARDS, pin_mm + fit_mm, length_mm)

    def write_top(n: int, text: str) -> Mark:
        middle = np.array([pitch_mm * (n + 0.5), letters_y_mm, height_mm])
        return _write(text, middle, np.array([0.0, 1.0, 0.0]), DOWNWARDS)

    holes = [drill_top(n, fit_mm, depths_mm[0]) for n, fit_mm in enumerate(FITS_MM)]
    marks = [write_top(n, text) for n, text in enumerate(_name_fits())]
    for n, text in enumerate(_name_fits()):
        x_mm = pitch_mm * (n + 0.5)
        mouth_mm = np.array([x_mm, 0.0, GAP_MM + pin_mm])
        holes.append(_drill(mouth_mm, INWARDS, pin_mm + FITS_MM[n], depths_mm[0]))
        middle = np.array([x_mm, 0.0, height_mm - GAP_MM - LETTERS_MM / 2.0])
        marks.append(_write(text, middle, UP, INWARDS))
    for n, length_mm in enumerate((long_mm, short_mm), len(FITS_MM)):
        holes.append(drill_top(n, GAUGE_FIT_MM, length_mm))
        marks.append(write_top(n, f"{length_mm:.0f}"))
    grooves = [groove for mark in marks for groove in mark.grooves]
    tools = Solid.union([Solid.hull(tool.points_mm) for tool in (*holes, *grooves)])
    return Coupon(block.subtract(tools), tuple(holes), tuple(marks), FITS_MM, (long_mm, short_mm))


def _name_fits() -> Iterator[str]:
    return (f"{10.0 * fit_mm:.0f}" for fit_mm in FITS_MM)


def _drill(mouth_mm: Floats, direction: Floats, width_mm: float, depth_mm: float) -> Tool:
    hole = make_hole(0, mouth_mm, direction, UP, (width_mm, depth_mm), np.zeros(3))
    if hole is None:
        raise DecomposeError(f"a hole {width_mm:g} mm wide needs support: take another diameter")
    return hole


def _write(text: str, middle: Floats, upward: Floats, direction: Floats) -> Mark:
    right = np.cross(upward, -direction)
    lines = draw_strokes(text) * (LETTERS_MM / GRID_HIGH) @ np.stack([right, upward]) + middle
    grooves = tuple(make_groove(0, line, direction, GROOVE_MM - 0.002 * n) for n, line in enumerate(lines))
    return Mark(0, 0, text, LETTERS_MM, lines, grooves)
