"""Pages of the whole fleet: timeline, printers, history."""

from __future__ import annotations

from farm.web.pages.fleet.printer_routes import make_printer_page_routes
from farm.web.pages.fleet.routes import make_fleet_routes

__all__ = ["make_fleet_routes", "make_printer_page_routes"]
