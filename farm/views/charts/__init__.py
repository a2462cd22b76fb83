"""Layout of charts over time: positions in px, which the templates draw as SVG. Pure."""

from __future__ import annotations

from farm.views.charts.axis import TimeAxis, TimeMark
from farm.views.charts.gantt import (
    BAR_KINDS,
    Bar,
    Gantt,
    lay_out_gantt,
    list_bars,
    list_expected_bars,
    load_palette,
    name_outcome,
)
from farm.views.charts.temperature_chart import TemperatureChart, lay_out_temperatures

__all__ = [
    "BAR_KINDS",
    "Bar",
    "Gantt",
    "TemperatureChart",
    "TimeAxis",
    "TimeMark",
    "lay_out_gantt",
    "lay_out_temperatures",
    "list_bars",
    "list_expected_bars",
    "load_palette",
    "name_outcome",
]
