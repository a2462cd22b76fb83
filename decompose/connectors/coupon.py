"""Coupon: a block with numbered holes and grooves of several fits, to find the fit of pins on a printer.

A fit is the clearance of a pin in its hole: the width of the hole minus the diameter of the pin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from decompose.arrays import Floats
from decompose.connectors.keys import (
    choose_key_lengths_mm,
    compute_bottom_length_mm,
    compute_groove_depth_mm,
)
from decompose.connectors.pins import END_GAP_MM, choose_depths_mm
from decompose.connectors.records import Mark, Tool
from decompose.connectors.strokes import GRID_HEIGHT, draw_strokes
from decompose.connectors.tools import make_groove, make_hole
from decompose.errors import DecomposeError
from decompose.geometry import Solid

FITS_MM = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
GAUGE_FIT_MM = 0.8  # clearance of the gauges, into which a pin slides easily
LETTER_HEIGHT_MM, GROOVE_DEPTH_MM = 6.0, 0.5
GAP_MM = 3.0  # gap between holes, numbers and edges
PLATE_GAP_MM = 6.0  # gap between the block and the plate
UP_DIRECTION = np.array([0.0, 0.0, 1.0])
INWARD_DIRECTION, DOWN_DIRECTION = np.array([0.0, 1.0, 0.0]), -UP_DIRECTION


@dataclass(frozen=True, slots=True, eq=False)
class Coupon:
    """Coupon in its printing pose: a block, and a plate that is pressed against its back after printing.

    Attributes
    ----------
    solid
        Block and plate with all holes, grooves and numbers.
    holes
        Holes in the top, then in the front, by increasing fit; then gauges for lengths, the longest first.
    grooves
        Grooves of a short key in the back of the block, by increasing fit, then those in the plate.
    marks
        Numbers of the holes, then of the grooves in the block: fits in tenths of a millimetre, and lengths in
        millimetres.
    fits_mm, lengths_mm
        Fits of the holes and grooves, and lengths of pins and keys that end flush in the gauges.
    """

    solid: Solid
    holes: tuple[Tool, ...]
    grooves: tuple[Tool, ...]
    marks: tuple[Mark, ...]
    fits_mm: tuple[float, ...]
    lengths_mm: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class _Layout:
    """Dimensions in mm of the coupon for pins of one diameter."""

    pin_mm: float

    @property
    def pitch_mm(self) -> float:
        """Distance between two columns."""
        return self.pin_mm + 2.0 * GAP_MM + 1.5

    @property
    def lengths_mm(self) -> tuple[float, ...]:
        """Lengths of all pins and keys of this diameter, the longest first."""
        pins_mm = {2.0 * (depth_mm - END_GAP_MM) for depth_mm in choose_depths_mm(self.pin_mm)}
        return tuple(sorted(pins_mm | {*choose_key_lengths_mm(self.pin_mm)}, reverse=True))

    @property
    def short_key_mm(self) -> float:
        """Length of a short key."""
        return choose_key_lengths_mm(self.pin_mm)[1]

    @property
    def mouth_mm(self) -> float:
        """Length of the mouth of the longest groove, slightly overestimated."""
        return self.short_key_mm + 2.0 * compute_groove_depth_mm(self.pin_mm, FITS_MM[-1])

    @property
    def height_mm(self) -> float:
        """Height of the block and of the plate."""
        below_letters_mm = max(2.0 * self.pin_mm, self.mouth_mm)
        return max(self.lengths_mm[0] + GAP_MM, below_letters_mm + LETTER_HEIGHT_MM + 3.0 * GAP_MM)

    @property
    def depth_mm(self) -> float:
        """Depth of the block, with the holes in its front and its top, and the grooves in its back."""
        groove_mm = compute_groove_depth_mm(self.pin_mm, FITS_MM[-1])
        hole_depth_mm = choose_depths_mm(self.pin_mm)[0]
        return hole_depth_mm + 2.0 * self.pin_mm + LETTER_HEIGHT_MM + 3.0 * GAP_MM + groove_mm

    def compute_column_x_mm(self, n: int) -> float:
        """Compute the x coordinate of the middle of a column."""
        return self.pitch_mm * (n + 0.5)


def make_coupon(pin_mm: float) -> Coupon:
    """Make the coupon for pins of one diameter.

    The holes in the top open upwards; those in the front are horizontal and have a roof. The grooves in the
    back are upright, and meet those in the plate.

    Parameters
    ----------
    pin_mm
        Diameter of the pins.

    Raises
    ------
    DecomposeError
        A hole of this diameter would need support.
    """
    layout = _Layout(pin_mm)
    width_mm = layout.pitch_mm * (len(FITS_MM) + len(layout.lengths_mm))
    block = Solid.box((0.0, 0.0, 0.0), (width_mm, layout.depth_mm, layout.height_mm))
    plate_y_mm = layout.depth_mm + PLATE_GAP_MM
    thickness_mm = compute_groove_depth_mm(pin_mm, FITS_MM[-1]) + GAP_MM
    plate = Solid.box(
        (0.0, plate_y_mm, 0.0), (layout.pitch_mm * len(FITS_MM), plate_y_mm + thickness_mm, layout.height_mm)
    )
    holes, marks = _make_holes(layout)
    grooves = [
        _make_key_groove(layout, n, y_mm, inward_normal)
        for y_mm, inward_normal in ((layout.depth_mm, -INWARD_DIRECTION), (plate_y_mm, INWARD_DIRECTION))
        for n in range(len(FITS_MM))
    ]
    letters_z_mm = layout.height_mm - GAP_MM - LETTER_HEIGHT_MM / 2.0
    for n, text in enumerate(_name_fits()):
        middle_mm = np.array([layout.compute_column_x_mm(n), layout.depth_mm, letters_z_mm])
        marks.append(_make_mark(text, middle_mm, UP_DIRECTION, -INWARD_DIRECTION))
    strokes = [groove for mark in marks for groove in mark.grooves]
    tools = Solid.union([Solid.hull(tool.points_mm) for tool in (*holes, *grooves, *strokes)])
    solid = Solid.union([block, plate]).subtract(tools)
    return Coupon(solid, tuple(holes), tuple(grooves), tuple(marks), FITS_MM, layout.lengths_mm)


def _make_holes(layout: _Layout) -> tuple[list[Tool], list[Mark]]:
    """Make the holes and their numbers: in the top, in the front, and the gauges in the top."""
    pin_mm, hole_depth_mm = layout.pin_mm, choose_depths_mm(layout.pin_mm)[0]
    hole_sizes = [
        (text, pin_mm + fit_mm, hole_depth_mm) for text, fit_mm in zip(_name_fits(), FITS_MM, strict=True)
    ]
    gauges = [(f"{length_mm:g}", pin_mm + GAUGE_FIT_MM, length_mm) for length_mm in layout.lengths_mm]
    holes_y_mm = layout.depth_mm - GAP_MM - pin_mm - compute_groove_depth_mm(pin_mm, FITS_MM[-1])
    top_holes: list[tuple[Tool, Mark]] = []
    for n, (text, width_mm, length_mm) in enumerate([*hole_sizes, *gauges]):
        mouth_mm = np.array([layout.compute_column_x_mm(n), holes_y_mm, layout.height_mm])
        middle_mm = np.array(
            [layout.compute_column_x_mm(n), GAP_MM + LETTER_HEIGHT_MM / 2.0, layout.height_mm]
        )
        hole = _make_printable_hole(mouth_mm, DOWN_DIRECTION, width_mm, length_mm)
        top_holes.append((hole, _make_mark(text, middle_mm, INWARD_DIRECTION, DOWN_DIRECTION)))
    front_holes: list[tuple[Tool, Mark]] = []
    for n, (text, width_mm, length_mm) in enumerate(hole_sizes):
        mouth_mm = np.array([layout.compute_column_x_mm(n), 0.0, GAP_MM + pin_mm])
        middle_mm = np.array(
            [layout.compute_column_x_mm(n), 0.0, layout.height_mm - GAP_MM - LETTER_HEIGHT_MM / 2.0]
        )
        front_holes.append(
            (
                _make_printable_hole(mouth_mm, INWARD_DIRECTION, width_mm, length_mm),
                _make_mark(text, middle_mm, UP_DIRECTION, INWARD_DIRECTION),
            )
        )
    ordered_holes = [*top_holes[: len(hole_sizes)], *front_holes, *top_holes[len(hole_sizes) :]]
    return [hole for hole, _ in ordered_holes], [mark for _, mark in ordered_holes]


def _make_key_groove(layout: _Layout, n: int, y_mm: float, inward_normal: Floats) -> Tool:
    """Make the upright groove of a short key in a column, in the back of the block or in the plate."""
    depth_mm = compute_groove_depth_mm(layout.pin_mm, FITS_MM[n])
    half_mm = compute_bottom_length_mm(layout.pin_mm, depth_mm, layout.short_key_mm) / 2.0
    middle_mm = np.array([layout.compute_column_x_mm(n), y_mm, GAP_MM + layout.mouth_mm / 2.0])
    return make_groove(0, middle_mm + np.outer([-half_mm, half_mm], UP_DIRECTION), inward_normal, depth_mm)


def _name_fits() -> Iterator[str]:
    """Yield each fit in tenths of a millimetre, as the text of its mark."""
    return (f"{10.0 * fit_mm:.0f}" for fit_mm in FITS_MM)


def _make_printable_hole(mouth_mm: Floats, direction: Floats, width_mm: float, depth_mm: float) -> Tool:
    """Make a hole that prints without support, from the middle of its mouth (3,) in a direction (3,)."""
    hole = make_hole(0, mouth_mm, direction, UP_DIRECTION, (width_mm, depth_mm), np.zeros(3))
    if hole is None:
        raise DecomposeError(f"a hole {width_mm:g} mm wide needs support: choose another diameter")
    return hole


def _make_mark(text: str, middle_mm: Floats, up_direction: Floats, inward_normal: Floats) -> Mark:
    """Make a mark centred at a point (3,) of a face; the top of its text points in `up_direction` (3,)."""
    right = np.cross(up_direction, -inward_normal)
    lines = (
        draw_strokes(text) * (LETTER_HEIGHT_MM / GRID_HEIGHT) @ np.stack([right, up_direction]) + middle_mm
    )
    grooves = tuple(
        make_groove(0, line, inward_normal, GROOVE_DEPTH_MM - 0.002 * n) for n, line in enumerate(lines)
    )
    return Mark(0, 0, text, LETTER_HEIGHT_MM, lines, grooves)
