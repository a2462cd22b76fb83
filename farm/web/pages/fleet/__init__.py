"""Pages of the fleet: its timeline, its printers, its history."""

from __future__ import annotations

from farm.web.pages.fleet.history import make_history_routes
from farm.web.pages.fleet.printer import make_printer_page_routes
from farm.web.pages.fleet.timeline import make_timeline_routes

__all__ = ["make_history_routes", "make_printer_page_routes", "make_timeline_routes"]
