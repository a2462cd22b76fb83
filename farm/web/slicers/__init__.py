"""APIs of the print servers OctoPrint and Moonraker, through which slicers send files to the farm.

Each API is served at the root for any printer that fits, and under `/to/PRINTER` for one printer.
"""

from __future__ import annotations

from fastapi import FastAPI

from farm.control import JobCommands, PrinterCommands
from farm.http import Services
from farm.web.slicers.app_keys import make_app_key_routes
from farm.web.slicers.moonraker import make_moonraker_routes
from farm.web.slicers.octoprint_commands import make_octoprint_command_routes
from farm.web.slicers.octoprint_routes import make_octoprint_routes
from farm.web.slicers.paths import (
    PREFIXES,
    PUBLIC_SLICER_ROUTES,
    SLICER_ROLES,
    is_slicer_path,
    is_slicer_upload,
)
from farm.web.slicers.selection import Selection
from farm.web.slicers.text_errors import make_text_response

__all__ = [
    "PUBLIC_SLICER_ROUTES",
    "SLICER_ROLES",
    "add_slicer_routes",
    "is_slicer_path",
    "is_slicer_upload",
    "make_text_response",
]


def add_slicer_routes(app: FastAPI, services: Services) -> None:
    """Add the routes of the APIs for slicers to an application."""
    jobs = JobCommands(services.controller, PrinterCommands(services.controller))
    selection = Selection()
    for prefix in PREFIXES:
        for router in (
            make_octoprint_routes(services, jobs, selection),
            make_octoprint_command_routes(services, jobs, selection),
            make_moonraker_routes(services, jobs),
            make_app_key_routes(services),
        ):
            app.include_router(router, prefix=prefix)
