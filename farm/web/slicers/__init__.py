"""Dialects of other print servers, so that slicers send to the farm: OctoPrint's.

Each is served at the root, for whichever printer fits, and under `/to/PRINTER`, for that one.
"""

from __future__ import annotations

from farm.web.slicers.octoprint_routes import octoprint_routes
from farm.web.slicers.paths import PREFIXES, SLICER_ROLES, is_slicer_path, is_slicer_upload
from farm.web.slicers.text_errors import make_text

__all__ = [
    "PREFIXES",
    "SLICER_ROLES",
    "is_slicer_path",
    "is_slicer_upload",
    "make_text",
    "octoprint_routes",
]
