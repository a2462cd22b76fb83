"""Cut list of pins, and a full-size drawing: a ruler to check the scale, and a gauge for each length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from decompose.connectors import Pin, list_pin_sizes

RULER_MM = 100
LEFT_MARGIN_MM, ROW_HEIGHT_MM, RULER_HEIGHT_MM = 5.0, 11.0, 17.0
WIDTH_MM = RULER_MM + 2.0 * LEFT_MARGIN_MM
SAW_CUT_MM = 1.0  # width of a saw cut


@dataclass(frozen=True, slots=True)
class PinSheet:
    """Pins to cut, and the drawing of their gauge.

    Attributes
    ----------
    rows
        Diameter in mm, length in mm, and number of pins, the largest first.
    stocks
        Diameter in mm, number of pins, and length in mm of the filament that they need, including the cuts.
    drawing
        SVG in mm.
    """

    rows: tuple[tuple[str, str, int], ...]
    stocks: tuple[tuple[str, int, str], ...]
    drawing: str


def make_pin_sheet(pins: Sequence[Pin]) -> PinSheet | None:
    """Make the sheet of pins; None if there are no pins."""
    if not pins:
        return None
    sizes = list_pin_sizes(pins)
    diameters_mm = dict.fromkeys(diameter_mm for diameter_mm, _, _ in sizes)
    return PinSheet(
        rows=tuple(
            (f"{diameter_mm:g}", format_length(length_mm), count) for diameter_mm, length_mm, count in sizes
        ),
        stocks=tuple(_describe_stock(sizes, diameter_mm) for diameter_mm in diameters_mm),
        drawing=draw_gauge([(length_mm, diameter_mm) for diameter_mm, length_mm, _ in sizes]),
    )


def _describe_stock(sizes: Sequence[tuple[float, float, int]], diameter_mm: float) -> tuple[str, int, str]:
    """Describe the filament that the pins of a diameter need, as in `PinSheet.stocks`."""
    lengths_mm = [
        (length_mm, count) for pin_diameter_mm, length_mm, count in sizes if pin_diameter_mm == diameter_mm
    ]
    stock_mm = sum(count * (length_mm + SAW_CUT_MM) for length_mm, count in lengths_mm)
    return f"{diameter_mm:g}", sum(count for _, count in lengths_mm), f"{stock_mm:,.0f}"


def format_length(length_mm: float) -> str:
    """Format the length of a pin as in the cut list."""
    return f"{round(length_mm, 1):g}"


def format_pin_size(pin: Pin) -> str:
    """Format the length of a pin, or the length and the diameter of a key."""
    length = format_length(pin.length_mm)
    return length if pin.key_direction is None else f"{length} × {pin.diameter_mm:g}"


def draw_gauge(sizes_mm: Sequence[tuple[float, float]]) -> str:
    """Draw a ruler of 10 cm, and a pin of each length between two lines.

    Parameters
    ----------
    sizes_mm
        Distinct pairs of a length and a diameter.

    Returns
    -------
    str
        SVG in mm.
    """
    height_mm = RULER_HEIGHT_MM + ROW_HEIGHT_MM * len(sizes_mm)
    elements = [_draw_line(LEFT_MARGIN_MM, 2.0, LEFT_MARGIN_MM + RULER_MM, 2.0)]
    for mm in range(RULER_MM + 1):
        long_mm = 6.0 if mm % 10 == 0 else 4.5 if mm % 5 == 0 else 3.0
        elements.append(_draw_line(LEFT_MARGIN_MM + mm, 2.0, LEFT_MARGIN_MM + mm, 2.0 + long_mm))
        if mm % 10 == 0:
            elements.append(_draw_text(LEFT_MARGIN_MM + mm, 11.5, f"{mm}", anchor="middle"))
    for row, (length_mm, diameter_mm) in enumerate(sizes_mm):
        top_mm = RULER_HEIGHT_MM + ROW_HEIGHT_MM * row
        end_mm = LEFT_MARGIN_MM + length_mm
        elements += [
            _draw_line(x, top_mm - 2.0, x, top_mm + diameter_mm + 2.0) for x in (LEFT_MARGIN_MM, end_mm)
        ]
        elements.append(
            f'<rect x="{LEFT_MARGIN_MM:g}" y="{top_mm:g}" width="{length_mm:g}" height="{diameter_mm:g}" '
            'fill="#9db8f2" stroke="#000" stroke-width="0.1"/>'
        )
        elements.append(
            _draw_text(end_mm + 3.0, top_mm + diameter_mm / 2.0 + 1.2, f"{length_mm:g} × {diameter_mm:g} mm")
        )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH_MM:g}mm" height="{height_mm:g}mm" '
        f'viewBox="0 0 {WIDTH_MM:g} {height_mm:g}" role="img" aria-label="Ruler of {RULER_MM} mm and pins">'
        + "".join(elements)
        + "</svg>"
    )


def _draw_line(x1: float, y1: float, x2: float, y2: float) -> str:
    """Draw a line in mm as SVG."""
    return f'<path d="M{x1:g} {y1:g}L{x2:g} {y2:g}" stroke="#000" stroke-width="0.15"/>'


def _draw_text(x: float, y: float, text: str, anchor: str = "start") -> str:
    """Draw a text at a point in mm as SVG."""
    return f'<text x="{x:g}" y="{y:g}" font-size="3.2" text-anchor="{anchor}">{text}</text>'
