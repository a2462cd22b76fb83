"""Cut list of pins as a drawing true to size: a ruler to check the print, and a gauge for each length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from decompose.connectors import Pin, list_cuts

RULER_MM = 100
LEFT_MM, ROW_MM, RULER_HIGH_MM = 5.0, 11.0, 17.0
WIDTH_MM = RULER_MM + 2.0 * LEFT_MM
SAW_MM = 1.0  # lost at each cut


@dataclass(frozen=True, slots=True)
class PinSheet:
    """Pins to cut, and the drawing of their gauge.

    Attributes
    ----------
    diameter
        Of all pins, in mm, as text.
    rows
        (length in mm, number of pins) as texts, the longest first.
    count
        Number of all pins.
    stock_mm
        Length of the stock that they need, with the cuts.
    drawing
        SVG, in mm.
    """

    diameter: str
    rows: tuple[tuple[str, int], ...]
    count: int
    stock_mm: str
    drawing: str


def make_sheet(pins: Sequence[Pin]) -> PinSheet | None:
    """Make the sheet of pins; None without any."""
    if not pins:
        return None
    cuts = list_cuts(pins)
    diameter_mm = pins[0].diameter_mm
    return PinSheet(
        diameter=f"{diameter_mm:g}",
        rows=tuple((format_length(length_mm), count) for length_mm, count in cuts),
        count=len(pins),
        stock_mm=f"{sum(count * (length_mm + SAW_MM) for length_mm, count in cuts):,.0f}",
        drawing=draw_gauge([length_mm for length_mm, _ in cuts], diameter_mm),
    )


def format_length(length_mm: float) -> str:
    """Format the length of a pin as in the cut list."""
    return f"{round(length_mm, 1):g}"


def draw_gauge(lengths_mm: Sequence[float], diameter_mm: float) -> str:
    """Draw a ruler of 10 cm, and a pin of each length between two lines, as SVG in mm.

    Parameters
    ----------
    lengths_mm
        Distinct lengths.
    diameter_mm
        Of all pins.
    """
    height_mm = RULER_HIGH_MM + ROW_MM * len(lengths_mm)
    marks = [_draw_line(LEFT_MM, 2.0, LEFT_MM + RULER_MM, 2.0)]
    for mm in range(RULER_MM + 1):
        long_mm = 6.0 if mm % 10 == 0 else 4.5 if mm % 5 == 0 else 3.0
        marks.append(_draw_line(LEFT_MM + mm, 2.0, LEFT_MM + mm, 2.0 + long_mm))
        if mm % 10 == 0:
            marks.append(_write(LEFT_MM + mm, 11.5, f"{mm}", anchor="middle"))
    for row, length_mm in enumerate(lengths_mm):
        top_mm = RULER_HIGH_MM + ROW_MM * row
        end_mm = LEFT_MM + length_mm
        marks += [_draw_line(x, top_mm - 2.0, x, top_mm + diameter_mm + 2.0) for x in (LEFT_MM, end_mm)]
        marks.append(
            f'<rect x="{LEFT_MM:g}" y="{top_mm:g}" width="{length_mm:g}" height="{diameter_mm:g}" '
            'fill="#9db8f2" stroke="#000" stroke-width="0.1"/>'
        )
        marks.append(_write(end_mm + 3.0, top_mm + diameter_mm / 2.0 + 1.2, f"{length_mm:g} mm"))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH_MM:g}mm" height="{height_mm:g}mm" '
        f'viewBox="0 0 {WIDTH_MM:g} {height_mm:g}" role="img" aria-label="Ruler of {RULER_MM} mm and pins">'
        + "".join(marks)
        + "</svg>"
    )


def _draw_line(x1: float, y1: float, x2: float, y2: float) -> str:
    return f'<path d="M{x1:g} {y1:g}L{x2:g} {y2:g}" stroke="#000" stroke-width="0.15"/>'


def _write(x: float, y: float, text: str, anchor: str = "start") -> str:
    return f'<text x="{x:g}" y="{y:g}" font-size="3.2" text-anchor="{anchor}">{text}</text>'
