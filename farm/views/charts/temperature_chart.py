"""Chart of a printer's temperatures over the last hours. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import tzinfo

from farm.model import Temperatures
from farm.views.charts.axis import TimeAxis, TimeMark

_WIDTH, _HEIGHT, _LEFT_MARGIN, _TOP_MARGIN, _BOTTOM_MARGIN = 960.0, 220.0, 64.0, 10.0, 24.0  # lengths in px
_MIN_AXIS_END_C, _MARK_INTERVAL_C = 100, 50
_TABLE_ROWS = 24
"""Approximate number of rows in the table for people who cannot see the chart."""

Points = tuple[tuple[float, float], ...]
"""Points (x, y) of one piece of a curve, in px."""


@dataclass(frozen=True, slots=True)
class Curve:
    """Curve of the chart, which has several pieces if the printer did not answer for some time."""

    name: str
    kind: str
    pieces: tuple[Points, ...]


@dataclass(frozen=True, slots=True)
class TemperatureRow:
    """Row of the table: a reading, with its time as ISO 8601."""

    at: str
    nozzle_c: int | None
    bed_c: int | None
    nozzle_target_c: int | None
    bed_target_c: int | None


@dataclass(frozen=True, slots=True)
class TemperatureChart:
    """Layout of the chart, in px, and a table of the same readings.

    Attributes
    ----------
    degree_marks
        Marks of the vertical axis: y in px, and temperature in degrees Celsius.
    start
        Time of the first reading, as ISO 8601.
    """

    curves: tuple[Curve, ...]
    marks: tuple[TimeMark, ...]
    degree_marks: tuple[tuple[float, int], ...]
    rows: tuple[TemperatureRow, ...]
    start: str
    max_temperature_c: int
    width: float = _WIDTH
    height: float = _HEIGHT
    left: float = _LEFT_MARGIN
    top: float = _TOP_MARGIN
    bottom: float = _HEIGHT - _BOTTOM_MARGIN


def lay_out_temperatures(
    readings: Sequence[Temperatures], now_s: float, zone: tzinfo, format_time: Callable[[float], str]
) -> TemperatureChart | None:
    """Lay out the chart from the first known reading until now; return None if no reading has a value.

    Parameters
    ----------
    readings
        Readings, oldest first.
    now_s
        Farm time, seconds since the epoch.
    zone
        Time zone of the axis.
    format_time
        Function that formats a time as ISO 8601.
    """
    known_readings = [
        reading for reading in readings if reading.nozzle_c is not None or reading.bed_c is not None
    ]
    if not known_readings:
        return None
    max_temperature_c = max(max(reading.nozzle_c or 0, reading.bed_c or 0) for reading in known_readings)
    top_c = max(_MIN_AXIS_END_C, -(-(max_temperature_c + 10) // _MARK_INTERVAL_C) * _MARK_INTERVAL_C)
    axis = TimeAxis(
        known_readings[0].at_s,
        max(now_s, known_readings[-1].at_s),
        _LEFT_MARGIN,
        _WIDTH - _LEFT_MARGIN - 20.0,
        zone,
    )

    def compute_y(degrees_c: float) -> float:
        return _TOP_MARGIN + (_HEIGHT - _TOP_MARGIN - _BOTTOM_MARGIN) * (1.0 - max(0.0, degrees_c) / top_c)

    def lay_out_curve(read_value: Callable[[Temperatures], int | None]) -> tuple[Points, ...]:
        values = ((axis.compute_x(reading.at_s), read_value(reading)) for reading in readings)
        return tuple(_split_curve(values, compute_y))

    step = max(1, len(known_readings) // _TABLE_ROWS)
    return TemperatureChart(
        curves=(
            Curve("nozzle", "nozzle", lay_out_curve(lambda reading: reading.nozzle_c)),
            Curve("nozzle, target", "nozzle target", lay_out_curve(lambda reading: reading.nozzle_target_c)),
            Curve("bed", "bed", lay_out_curve(lambda reading: reading.bed_c)),
            Curve("bed, target", "bed target", lay_out_curve(lambda reading: reading.bed_target_c)),
        ),
        marks=tuple(axis.list_marks()),
        degree_marks=tuple(
            (compute_y(degrees_c), degrees_c) for degrees_c in range(0, top_c + 1, _MARK_INTERVAL_C)
        ),
        rows=tuple(_make_row(reading, format_time) for reading in reversed(known_readings[::-step])),
        start=format_time(known_readings[0].at_s),
        max_temperature_c=max_temperature_c,
    )


def _make_row(reading: Temperatures, format_time: Callable[[float], str]) -> TemperatureRow:
    return TemperatureRow(
        format_time(reading.at_s),
        reading.nozzle_c,
        reading.bed_c,
        reading.nozzle_target_c,
        reading.bed_target_c,
    )


def _split_curve(
    values: Iterable[tuple[float, int | None]], compute_y: Callable[[float], float]
) -> list[Points]:
    """Split a curve where values are missing, and leave out points within a horizontal line."""
    pieces: list[list[tuple[float, float]]] = [[]]
    for x, value in values:
        if value is None:
            pieces.append([])
            continue
        piece, level_y = pieces[-1], compute_y(value)
        if len(piece) > 1 and piece[-1][1] == piece[-2][1] == level_y:
            piece.pop()
        piece.append((x, level_y))
    return [tuple(piece) for piece in pieces if piece]
