"""Pages of the whole fleet: timeline, printers, history."""

from __future__ import annotations

from farm.web.pages.fleet.printer_routes import printer_pages
from farm.web.pages.fleet.routes import fleet_routes

__all__ = ["fleet_routes", "printer_pages"]
