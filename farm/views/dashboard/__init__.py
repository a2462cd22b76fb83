"""Views for those pages of the dashboard that have no `--json` output: timeline, printer, history. Pure."""

from __future__ import annotations

from farm.views.dashboard.fleet_timeline import TimelineView, describe_fleet_timeline
from farm.views.dashboard.history import (
    HistoryFilter,
    HistoryView,
    describe_history,
    select_prints,
    write_csv,
)
from farm.views.dashboard.printer import PrinterPage, describe_printer_page
from farm.views.dashboard.what_if import Change

__all__ = [
    "Change",
    "HistoryFilter",
    "HistoryView",
    "PrinterPage",
    "TimelineView",
    "describe_fleet_timeline",
    "describe_history",
    "describe_printer_page",
    "select_prints",
    "write_csv",
]
