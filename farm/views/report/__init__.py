"""Report of a job as one HTML page."""

from __future__ import annotations

from farm.views.report.figures import list_figures
from farm.views.report.page import render_page

__all__ = ["list_figures", "render_page"]
