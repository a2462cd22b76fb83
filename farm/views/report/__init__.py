"""Report of a job as one HTML page."""

from __future__ import annotations

from farm.views.report.figures import list_figures
from farm.views.report.gantt import COLOURS, Gantt, lay_out_gantt, list_bars, list_expected_bars
from farm.views.report.page import draw_gantt, render_page

__all__ = [
    "COLOURS",
    "Gantt",
    "draw_gantt",
    "lay_out_gantt",
    "list_bars",
    "list_expected_bars",
    "list_figures",
    "render_page",
]
